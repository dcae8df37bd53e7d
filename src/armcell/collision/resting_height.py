"""Height at which an object of a planning scene rests on the objects below it."""

from __future__ import annotations

import coal

from armcell.collision.exact_checker import object_distance
from armcell.core import SE3
from armcell.scene import PlanningScene

RESTS = 0.002  # [m] gap or overlap with which an object still rests, as in `neighbors` and `RESTING`
BISECTIONS = 12


def resting_shift(scene: PlanningScene, name: str, most: float) -> float:
    """Return how far [m] an object must move up or down to be at its resting height, where it touches the
    objects below it.

    An object at rest touches its support. If its believed pose is above the support or inside it, the pose is
    wrong by at least this distance.

    Args:
        name: object in the world.
        most: largest distance [m].
    Returns:
        A positive distance upward or a negative distance downward; 0 if the object rests within 2 mm, if
        nothing supports it within `most`, or if moving it up by `most` does not end an overlap.
    """
    item, request = scene.object(name), coal.DistanceRequest()
    if most <= 0.0 or item.has_cloud:
        return 0.0
    others = [other for other in scene.objects.values() if other.name != name and not other.has_cloud]

    def gap(shift: float) -> float:
        moved = item.at(SE3.from_xyz(0.0, 0.0, shift) @ item.T_world_object)
        return min((object_distance(moved, other, request) for other in others), default=float("inf"))

    reach = most + RESTS
    if gap(RESTS) <= 0.0:
        low, high = RESTS, reach  # inside the support
        if gap(high) <= 0.0:
            return 0.0
    elif gap(0.0) > RESTS:
        low, high = -reach, 0.0  # above it
        if gap(low) > 0.0:
            return 0.0
    else:
        return 0.0
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if gap(middle) <= 0.0 else (low, middle)
    return high
