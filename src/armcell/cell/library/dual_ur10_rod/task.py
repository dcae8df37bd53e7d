"""Two arms grasp a rod by its ends, lift, move and turn it, and place it across the table."""

from __future__ import annotations

import numpy as np

from armcell.core import SE3, ErrorCode, Outcome
from armcell.tasks import checked, moved_object_pose

TARGET = SE3.from_xyz_rpy((0.0, -0.08, 0.946), (0.0, 0.0, 0.2))  # 0.5 mm above the rests
HEIGHT = 0.2  # [m]


def task(cell):
    rod = cell.carry("rod", left_arm="front_end", right_arm="back_end")
    start = cell.scene().object("rod").T_world_object
    up, over = moved_object_pose(start, z=HEIGHT), moved_object_pose(TARGET, z=HEIGHT)
    checked(rod.grasp(route=[up, over, TARGET]))
    checked(rod.move(up, name="lift"))
    checked(rod.move(over, name="move and turn"))
    checked(rod.move(TARGET, name="put down"))
    checked(rod.release())
    checked(cell.move_together(left_arm="home", right_arm="home"))
    off, turned = cell.scene().object("rod").T_world_object.distance_to(TARGET)
    if off > 0.005:
        return Outcome(ErrorCode.CONTROL_FAILED, f"the rod is {1000 * off:.1f} mm from its target pose")
    placed = {"placed_off_mm": 1000 * off, "placed_turn_deg": float(np.rad2deg(turned))}
    return Outcome(ErrorCode.SUCCESS, evidence={**rod.record.as_dict(), **placed})
