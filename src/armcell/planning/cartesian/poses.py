"""The poses that a line goes through."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armcell.core import SE3, CartesianRequest, InputError
from armcell.planning.placed import Placed
from armcell.scene import PlanningScene

MOST_STEPS = 100_000  # of one line
ROTATION_STEP = 0.05  # [rad] between checked poses
FEWEST = 10  # steps to a waypoint where jumps are told from the mean step; as MoveIt


def poses_between(start: SE3, request: CartesianRequest) -> list[list[SE3]]:
    """For each waypoint the poses from the one before to it, the first left out, the last one itself."""
    legs, at = [], start
    least = FEWEST if request.relative_jump_threshold > 0 else 1
    for waypoint in request.waypoints:
        metres, radians = at.distance_to(waypoint)
        count = max(int(np.ceil(max(metres / request.max_step, radians / ROTATION_STEP))), least)
        if count > MOST_STEPS:
            raise InputError(
                f"max_step of {request.max_step:g} m divides a line of {metres:.3g} m into {count} steps",
                cure=f"at most {MOST_STEPS} are allowed; 0.005 m is usual",
            )
        legs.append(at.interpolated(waypoint, ((k + 1) / count for k in range(count))))
        at = waypoint
    return legs


def waypoints_by_offsets(
    scene: PlanningScene, group: str, offsets: Sequence[SE3], link: str | None = None, frame: str = "link"
) -> tuple[SE3, ...]:
    """Waypoints from the link's present pose on, each given by its offset from the one before.

    Args:
        offsets: motions in the link's own axes (`frame="link"`), or about its origin in the axes of a frame
            of the scene ("world", a link, an object).
    Raises:
        UnknownNameError: no such group, link or frame.
    """
    at = scene.frame_pose(Placed(scene, group, link).name)
    axes = None if frame == "link" else scene.frame_pose(frame).rotation
    found = []
    for offset in offsets:
        if axes is None:
            at = at @ offset
        else:
            turn = axes @ offset.rotation @ axes.inv()
            at = SE3(turn @ at.rotation, at.translation + axes.matrix @ offset.translation)
        found.append(at)
    return tuple(found)
