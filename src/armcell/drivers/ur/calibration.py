"""Application of a UR robot's factory calibration to the kinematic model of planners.

A UR controller reports its own Denavit-Hartenberg parameters, K_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)
after the rotation of joint i. A URDF uses other frames: joint i's frame is C_i relative to DH frame i-1,
where C_i aligns its axis with DH's z. The origin of joint i+1 on link i is therefore C_i^-1 K_i C_(i+1);
with the robot's own K_i, the origin is calibrated.

In addition, each link may rotate about its own joint's axis and translate along it (Z_i) without changing any
flange pose, because the neighboring links compensate. This freedom keeps the links near their nominal
positions. It is necessary: if axes are nearly parallel (shoulder, elbow, wrist 1), calibrated values of d may
be a hundred meters with opposite signs. ROS-Industrial's `ur_calibration` does the same by changing the
parameters.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, InputError
from armcell.drivers.ur.wire.primary import Kinematics
from armcell.model import RobotModel

Array = NDArray[np.float64]

HALF_TURN = SE3(SO3.exp((0.0, 0.0, np.pi)), np.zeros(3))  # controller's base in the model's base_link
SAME = 2e-3  # [m, rad] largest error of the model's axes from the nominal ones
LARGEST = 0.05  # [m] largest correction of a joint origin: more indicates another robot


def calibrated_model(model: RobotModel, group: str, nominal: Kinematics, own: Kinematics) -> RobotModel:
    """Return the robot model with the joint origins of a UR arm replaced by those of its factory calibration.

    Args:
        group: planning group of the arm's six joints.
        nominal: DH parameters of the arm's type.
        own: DH parameters of this robot.
    Raises:
        InputError: the group is not an arm of this type, or the calibration belongs to another robot.
    """
    names = model.group(group).joint_names
    before = [model.joints[n] for n in names]
    chained = all(a.child == b.parent for a, b in pairwise(before))
    if len(before) != 6 or not chained:
        raise InputError(
            f"group {group!r} is not six joints one behind the other: its calibration cannot be applied",
            hint="leave out 'calibration: apply'",
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
        origin = C[i].inverse() @ Z[i].inverse() @ K @ Z[i + 1] @ C[i + 1]
        moved = float(np.linalg.norm(origin.translation - before[i + 1].T_parent_joint.translation))
        if moved > LARGEST:
            raise InputError(
                f"{names[i + 1]} would be {moved * 1000:.0f} mm from where a {group!r} of this type has it: "
                "no calibration is that large",
                hint="is it the right robot, and its type ('model') right in the cell file?",
            )
        joints[names[i + 1]] = replace(before[i + 1], T_parent_joint=origin)
    D = C[5].inverse() @ Z[5].inverse() @ _behind_joint(own, 5) @ _behind_joint(nominal, 5).inverse() @ C[5]
    for name, joint in model.joints.items():
        if joint.parent == before[5].child:  # flange, tool, sensor
            joints[name] = replace(joint, T_parent_joint=D @ joint.T_parent_joint)
    return replace(model, joints=joints)


def _behind_joint(dh: Kinematics, i: int) -> SE3:
    """Return the transform K_i of a UR arm's calibration: from the frame of joint i, after its rotation, to
    the next DH frame.
    """
    turned = SE3(SO3.exp((0.0, 0.0, dh.theta[i])), np.array([0.0, 0.0, dh.d[i]]))
    return turned @ SE3(SO3.exp((dh.alpha[i], 0.0, 0.0)), np.array([dh.a[i], 0.0, 0.0]))


def _frames(model: RobotModel, group: str, nominal: Kinematics) -> list[SE3]:
    """Return the transforms C_i (6) for calibrating a UR arm:
    each joint frame relative to DH frame i-1, with all joints at zero.

    Raises:
        InputError: the model's joint axes do not match this type of arm.
    """
    names, found = model.group(group).joint_names, []
    T_base_dh, T_base_joint = HALF_TURN, SE3.identity()
    for i, name in enumerate(names):
        joint = model.joints[name]
        T_base_joint = T_base_joint @ joint.T_parent_joint
        C = T_base_dh.inverse() @ T_base_joint
        axis = C.rotation.matrix @ np.asarray(joint.axis)
        off = max(float(np.linalg.norm(axis - (0.0, 0.0, 1.0))), float(np.linalg.norm(C.translation[:2])))
        if off > SAME:
            raise InputError(
                f"{name} is not where this type of UR has it (its axis is off by {off:.3f}): "
                "calibration cannot be applied",
                hint="name the cell's robot and the arm's 'model' alike, or leave out 'calibration: apply'",
            )
        found.append(C)
        T_base_dh = T_base_dh @ _behind_joint(nominal, i)
    return found


def _fitting(own: SE3, wanted: Array, nominal: SE3, slide: float) -> tuple[float, float]:
    """Compute two corrections of a calibrated UR model: the rotation of a link, and the offset of the next
    joint along its axis. With them, the next joint stays close to its nominal position.

    Args:
        own: K_i of the robot.
        wanted: nominal origin of the next joint (3,) [m], in the frame of K_i's joint.
        nominal: K_i of the arm's type.
        slide: translation [m] of link i along its own axis so far.
    Returns:
        Rotation of link i about its axis [rad]; translation of the next joint along the next axis [m].
    """
    p, z = own.translation, own.rotation.matrix[:, 2]
    z0 = nominal.rotation.matrix[:, 2]
    wanted = wanted + np.array([0.0, 0.0, slide])
    if abs(z0[2]) < 0.5:  # the next axis is perpendicular: its direction gives the rotation
        turn = np.arctan2(z[1], z[0]) - np.arctan2(z0[1], z0[0])
    else:  # nearly parallel: use its intersection with the plane z = wanted[2]
        through = p + z * (wanted[2] - p[2]) / z[2]
        turn = np.arctan2(through[1], through[0]) - np.arctan2(wanted[1], wanted[0])
    turn = float((turn + np.pi) % (2 * np.pi) - np.pi)
    at = SO3.exp((0.0, 0.0, turn)).matrix @ wanted
    offset = nominal.inverse().apply(wanted - np.array([0.0, 0.0, slide]))[
        2
    ]  # nominal, along the joint's axis
    return turn, float((at - p) @ z - offset)
