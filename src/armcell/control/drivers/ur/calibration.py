"""A robot's factory calibration put into the kinematic model that is planned with.

A UR tells its own Denavit-Hartenberg parameters, K_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) behind joint
i's turn. A URDF has other frames: joint i's frame is C_i behind the DH frame i-1, where C_i only lays its
axis on DH's z. So joint i+1's origin on link i is C_i^-1 K_i C_(i+1); with the robot's own K_i it is
calibrated.

Each link may besides turn about and slide along its own joint's axis (Z_i), which changes no pose of the
flange: neighbours take it back. That freedom is used to keep the links where they look like the nominal ones.
It is needed: where axes are nearly parallel (shoulder, elbow, wrist 1), calibrated d may be a hundred metres,
there and back. The same is done by ROS-Industrial's `ur_calibration`, which changes the parameters instead.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armcell.control.ur_wire.primary import Kinematics
from armcell.core import SE3, SO3, InputError
from armcell.model import RobotModel

Array = NDArray[np.float64]

HALF_TURN = SE3(SO3.exp((0.0, 0.0, np.pi)), np.zeros(3))  # of the controller's base in the model's base_link
SAME = 2e-3  # [m, rad] by which the model's axes may be off the nominal ones
LARGEST = 0.05  # [m] that a joint may be moved: more is another robot


def calibrated(model: RobotModel, group: str, nominal: Kinematics, own: Kinematics) -> RobotModel:
    """The model with one arm's joints where its robot has them.

    Args:
        group: of the arm's six joints.
        nominal: parameters of the arm's type.
        own: those of this robot.
    Raises:
        InputError: the group is no arm of this type, or the calibration is of another robot.
    """
    names = model.group(group).joint_names
    before = [model.joints[n] for n in names]
    chained = all(a.child == b.parent for a, b in pairwise(before))
    if len(before) != 6 or not chained:
        raise InputError(
            f"group {group!r} is not six joints one behind the other: its calibration cannot be applied",
            cure="leave out 'calibration: apply'",
        )
    C = _frames(model, group, nominal)
    joints = dict(model.joints)
    Z = [SE3.identity()] * 7
    slide = 0.0
    for i in range(6):
        K_nominal, K = _behind_joint(nominal, i), _behind_joint(own, i)
        target = K_nominal @ C[i + 1] if i < 5 else K_nominal
        turn, next_slide = _fitting(K, target.translation, K_nominal, slide)
        if i == 5:
            turn, next_slide = 0.0, 0.0
        Z[i] = SE3(SO3.exp((0.0, 0.0, turn)), np.array([0.0, 0.0, slide]))
        slide = next_slide
    origin = HALF_TURN @ Z[0] @ C[0]
    joints[names[0]] = replace(before[0], T_parent_joint=origin)
    for i in range(5):
        K = _behind_joint(own, i)
        origin = C[i].inv() @ Z[i].inv() @ K @ Z[i + 1] @ C[i + 1]
        moved = float(np.linalg.norm(origin.translation - before[i + 1].T_parent_joint.translation))
        if moved > LARGEST:
            raise InputError(
                f"{names[i + 1]} would be {moved * 1000:.0f} mm from where a {group!r} of this type has it: "
                "no calibration is that large",
                cure="is it the right robot, and its type ('model') right in the cell file?",
            )
        joints[names[i + 1]] = replace(before[i + 1], T_parent_joint=origin)
    D = C[5].inv() @ Z[5].inv() @ _behind_joint(own, 5) @ _behind_joint(nominal, 5).inv() @ C[5]
    for name, joint in model.joints.items():
        if joint.parent == before[5].child:  # flange, tool, sensor
            joints[name] = replace(joint, T_parent_joint=D @ joint.T_parent_joint)
    return replace(model, joints=joints)


def _behind_joint(dh: Kinematics, i: int) -> SE3:
    """K_i: from behind joint i's turn to the next DH frame."""
    turned = SE3(SO3.exp((0.0, 0.0, dh.theta[i])), np.array([0.0, 0.0, dh.d[i]]))
    return turned @ SE3(SO3.exp((dh.alpha[i], 0.0, 0.0)), np.array([dh.a[i], 0.0, 0.0]))


def _frames(model: RobotModel, group: str, nominal: Kinematics) -> list[SE3]:
    """C_i (6): joint i's frame seen from DH frame i-1, both with all joints at zero.

    Raises:
        InputError: the model's axes are not where this type of arm has them.
    """
    names, found = model.group(group).joint_names, []
    T_base_dh, T_base_joint = HALF_TURN, SE3.identity()
    for i, name in enumerate(names):
        joint = model.joints[name]
        T_base_joint = T_base_joint @ joint.T_parent_joint
        C = T_base_dh.inv() @ T_base_joint
        axis = C.rotation.matrix @ np.asarray(joint.axis)
        off = max(float(np.linalg.norm(axis - (0.0, 0.0, 1.0))), float(np.linalg.norm(C.translation[:2])))
        if off > SAME:
            raise InputError(
                f"{name} is not where this type of UR has it (its axis is off by {off:.3f}): "
                "calibration cannot be applied",
                cure="name the cell's robot and the arm's 'model' alike, or leave out 'calibration: apply'",
            )
        found.append(C)
        T_base_dh = T_base_dh @ _behind_joint(nominal, i)
    return found


def _fitting(own: SE3, wanted: Array, nominal: SE3, slide: float) -> tuple[float, float]:
    """(turn, slide): how link i is turned about its axis [rad], and how far along the next axis [m] the next
    joint stands, for that joint to be where the nominal link has it.

    Args:
        own: K_i of the robot.
        wanted: the next joint's origin behind K_i's joint by the nominal arm (3,).
        nominal: K_i of the type.
        slide: how far [m] link i is along its own axis already.
    """
    p, z = own.translation, own.rotation.matrix[:, 2]
    z0 = nominal.rotation.matrix[:, 2]
    wanted = wanted + np.array([0.0, 0.0, slide])
    if abs(z0[2]) < 0.5:  # the next axis is across: its direction tells the turn
        turn = np.arctan2(z[1], z[0]) - np.arctan2(z0[1], z0[0])
    else:  # nearly parallel: where it goes through the height of the wanted point
        through = p + z * (wanted[2] - p[2]) / z[2]
        turn = np.arctan2(through[1], through[0]) - np.arctan2(wanted[1], wanted[0])
    turn = float((turn + np.pi) % (2 * np.pi) - np.pi)
    at = SO3.exp((0.0, 0.0, turn)).matrix @ wanted
    offset = nominal.inv().apply(wanted - np.array([0.0, 0.0, slide]))[2]  # the joint's own place on its axis
    return turn, float((at - p) @ z - offset)
