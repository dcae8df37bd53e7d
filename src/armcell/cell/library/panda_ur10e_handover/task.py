"""A Panda picks a bar and hands it over to a UR10e, which places it in a tray; then both arms fold."""

from __future__ import annotations

import numpy as np

from armcell.core import ErrorCode, Outcome
from armcell.tasks import checked

LARGEST_ERROR = 0.005  # [m]


def task(cell):
    goal = cell.scene().object("tray").T_world_object.translation[:2]
    checked(cell["franka_arm"].pick("bar"))
    checked(cell.hand_over("bar", to="ur_arm"))
    checked(cell["ur_arm"].place("bar", on="tray", at=(0.0, 0.0)))
    checked(cell.move_together(franka_arm="home", ur_arm="home"))
    off = float(np.linalg.norm(cell.scene().object("bar").T_world_object.translation[:2] - goal))
    if off > LARGEST_ERROR:
        return Outcome(
            ErrorCode.CONTROL_FAILED, f"the bar is {1000 * off:.1f} mm from the middle of the tray"
        )
    return Outcome(ErrorCode.SUCCESS, evidence={"placed_off_mm": 1000 * off})
