"""What a hand feels: the forces of all contacts on a gripper's links, as a six-axis sensor at its tcp."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.built import BuiltModel
from armcell.sim.stepping import add_about, hand_contacts

Array = NDArray[np.float64]


def hand_wrench(built: BuiltModel, data: mujoco.MjData, gripper: str) -> Array:
    """Force [N] over torque [Nm] (6,) on a gripper by what touches it, about its tcp, in world axes.

    As of the last step. The hand's own weight is not in it, as in a sensor that was told its tool.
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
    axes = contact.frame[which].reshape(-1, 3, 3)  # rows; the first points from one geom to the other
    felt = signs[:found, None, None] * (wrenches[:found].reshape(-1, 2, 3) @ axes)
    add_about(which, contact.pos, data.xpos[index.tcp_body], felt, total)
    return total
