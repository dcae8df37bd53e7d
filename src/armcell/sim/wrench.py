"""Contact wrench on a gripper, as a six-axis force-torque sensor at its tcp measures it."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.built_model import BuiltModel
from armcell.sim.step_kernel import add_about, hand_contacts

Array = NDArray[np.float64]


def hand_wrench(built: BuiltModel, data: mujoco.MjData, gripper: str) -> Array:
    """Return the wrench (6,) that a six-axis sensor measures on a gripper: force [N], then torque [Nm] about
    the tcp.

    The wrench has world axes and includes all contacts of the last step. It excludes the hand's own weight,
    like a sensor that compensates the tool's weight.
    """
    count, index, total = data.ncon, built.grippers[gripper], np.zeros(6)
    if count == 0:
        return total
    contact = data.contact
    which, signs, wrenches = np.empty(count, np.int64), np.empty(count), np.empty((count, 6))
    found = hand_contacts(
        built.mj._address, data._address, contact.geom, built.geom_owner, index.hand, which, signs, wrenches
    )
    which = which[:found]
    axes = contact.frame[which].reshape(-1, 3, 3)  # axes as rows; the first points from geom 1 to geom 2
    felt = signs[:found, None, None] * (wrenches[:found].reshape(-1, 2, 3) @ axes)
    add_about(which, contact.pos, data.xpos[index.tcp_body], felt, total)
    return total
