"""What a hand feels: the forces of all contacts on a gripper's links, as a six-axis sensor at its tcp."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.built import BuiltModel

Array = NDArray[np.float64]


def hand_wrench(built: BuiltModel, data: mujoco.MjData, gripper: str) -> Array:
    """Force [N] over torque [Nm] (6,) on a gripper by what touches it, about its tcp, in world axes.

    As of the last step. The hand's own weight is not in it, as in a sensor that was told its tool.
    """
    hand = built.grippers[gripper].gripper
    mine = {built.owner_index[n] for n in hand.hand_links}
    out, contact = np.zeros(6), np.zeros(6)
    if data.ncon == 0:
        return out
    origin = data.xpos[built.grippers[gripper].tcp_body]
    for i, (a, b) in enumerate(built.geom_owner[data.contact.geom].tolist()):
        if (a in mine) == (b in mine):
            continue
        mujoco.mj_contactForce(built.mj, data, i, contact)
        axes = data.contact[i].frame.reshape(3, 3).T  # its x axis points from a to b
        sign = 1.0 if b in mine else -1.0
        force = sign * (axes @ contact[:3])
        out[:3] += force
        out[3:] += sign * (axes @ contact[3:]) + np.cross(data.contact[i].pos - origin, force)
    return out
