"""Stable resting poses of an object and their stability margins."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from armcell.core import Capsule, Cylinder, Sphere
from armcell.grasping.surface import surface_of
from armcell.scene import CollisionObject
from armcell.scene.resting import StablePose, hull_rests, plane_axes

Array = NDArray[np.float64]

KEPT = 64
NARROW = 5e-4  # [m] assumed half width of the contact line or point of a round object


_kept: OrderedDict[tuple, tuple[StablePose, ...]] = OrderedDict()


def stable_poses(item: CollisionObject) -> tuple[StablePose, ...]:
    """Return the stable resting poses of an object, that is, the sides of its convex hull on which it can
    rest, most stable first.

    Round shapes are approximated by polygons and rest on their narrow sides, with almost no margin.
    """
    surface = surface_of(item)
    if surface.key not in _kept:
        points = surface.triangles.reshape(-1, 3) if len(surface.triangles) else surface.points
        _kept[surface.key] = tuple(hull_rests(points, surface.center_of_mass))
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
    return _kept[surface.key]


def resting_now(item: CollisionObject, firm: float = 0.003, within: float = 0.8) -> StablePose | None:
    """Return the stable resting pose of an object that is nearest to the object's present orientation.

    A stable resting pose is preferred to one on which the object rolls.

    Args:
        firm: [m] minimum margin of a stable resting pose.
        within: [rad] maximum angle to a preferred stable resting pose.
    """
    now = item.T_world_object.rotation.matrix[2]
    all_ = stable_poses(item)
    if not all_:
        return None
    nearest = max(all_, key=lambda r: float(r.up @ now))
    steady = [r for r in all_ if r.margin >= firm and r.up @ now > np.cos(within)]
    best = max(steady, key=lambda r: float(r.up @ now), default=nearest)
    # An object lying on its round side keeps its orientation: do not set it upright.
    best = best if best.up @ now > float(nearest.up @ now) - 0.02 else nearest
    return _rolled(item, now, best) or best


def _rolled(item: CollisionObject, now: Array, nearest: StablePose) -> StablePose | None:
    """Return the `StablePose` of an object that rolls: a sphere, or a cylinder or capsule that lies on its
    side.

    The body keeps its present orientation. The result is None for other objects.
    """
    shape, T = item.shapes[0]
    if len(item.shapes) > 1 or not isinstance(shape, Sphere | Cylinder | Capsule):
        return None
    up, half = now, 0.0
    axis = T.rotation.matrix[:, 2]
    if not isinstance(shape, Sphere):
        if abs(nearest.up @ axis) > 0.5:
            return None  # upright
        up = now - (now @ axis) * axis
        up, half = up / np.linalg.norm(up), shape.length / 2
    x = axis if half else plane_axes(up)[0]
    y = np.cross(up, x)
    line = T.translation - shape.radius * up
    foot = np.array(
        [line + sx * (half + NARROW) * x + sy * NARROW * y for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )
    return StablePose(up, foot, 0.0)
