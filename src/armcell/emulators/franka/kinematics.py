"""Kinematics of a Franka arm: forward kinematics, Jacobian, and robot description (URDF)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, InputError
from armcell.drivers.franka.motion_limits import FrankaLimits
from armcell.model import Joint, Link, RobotModel

Array = NDArray[np.float64]

JOINTS = 7
T_LINK7_FLANGE = SE3.from_xyz_rpy((0.0, 0.0, 0.107))  # Franka's DH parameters: d of the flange


def arm_joints(model: RobotModel, group: str) -> tuple[str, ...]:
    """Return the seven joints that form the kinematics of an emulated Franka arm.

    Raises:
        InputError: the group does not have seven revolute joints in a chain.
    """
    names = tuple(model.group(group).joint_names)
    joints = [model.joints[n] for n in names]
    chained = all(a.child == b.parent for a, b in pairwise(joints))
    if len(joints) != JOINTS or not chained:
        raise InputError(
            f"group {group!r} has the joints {', '.join(names)}; a Franka arm has a chain of seven",
            hint="use a cell with a Panda or an FR3",
        )
    return names


class ArmKinematics:
    """Forward kinematics and Jacobian of an emulated Franka arm, in the frame of its base (O).

    Args:
        joints: the arm's joints, base to flange.
    """

    def __init__(self, joints: Sequence[Joint]):
        spec = mujoco.MjSpec()
        body = spec.worldbody
        for joint in joints:
            T = joint.T_parent_joint
            body = body.add_body(
                name=joint.child, pos=T.translation, quat=T.rotation.quat_wxyz, mass=1.0,
                inertia=[1.0, 1.0, 1.0], explicitinertial=True,
            )  # fmt: skip
            body.add_joint(name=joint.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis)
        body.add_site(name="flange", pos=T_LINK7_FLANGE.translation, quat=T_LINK7_FLANGE.rotation.quat_wxyz)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._tip = self._model.nbody - 1
        self._jacobian = np.zeros((6, JOINTS))

    def at(self, q: ArrayLike) -> None:
        """Compute all frames in the kinematics of an emulated Franka arm at joint positions q (7,) [rad]."""
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)

    def flange(self) -> Array:
        """Return the flange pose T_O_F (4, 4) from the kinematics of a Franka arm,
        at the last computed positions.
        """
        T = np.zeros((4, 4))
        T[:3, :3] = self._data.site_xmat.reshape(3, 3)
        T[:3, 3] = self._data.site_xpos[0]
        T[3, 3] = 1.0
        return T

    def jacobian(self, point: Array) -> Array:
        """Return the Jacobian (6, 7) of a Franka arm's kinematics for a point fixed to the last link.
        The linear rows come first.

        The point is given in the base frame O [m].
        """
        mujoco.mj_jac(
            self._model, self._data, self._jacobian[:3], self._jacobian[3:], np.asarray(point), self._tip
        )
        return self._jacobian


def rotation_log(R: Array) -> Array:
    """Return the rotation vector (3,) [rad] of a rotation (3, 3) of less than half a turn,
    for the kinematics of Franka arms.
    """
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return axis
    return axis * (np.arctan2(sine, 0.5 * (np.trace(R) - 1.0)) / sine)


def rotation_exp(w: Array) -> Array:
    """Return the rotation (3, 3) that belongs to a rotation vector (3,) [rad],
    for the kinematics of Franka arms.
    """
    angle = float(np.linalg.norm(w))
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    if angle < 1e-9:
        return np.eye(3) + K
    return np.eye(3) + np.sin(angle) / angle * K + (1.0 - np.cos(angle)) / angle**2 * (K @ K)


def urdf(model: RobotModel, group: str, limits: FrankaLimits) -> str:
    """Return the URDF with the arm's kinematics, without the hand,
    that the emulated Franka robot sends to clients.

    Clients compute dynamics with it and read velocity limits from it, so every joint has
    `position_based_velocity_limits`.
    """
    joints = [model.joints[n] for n in arm_joints(model, group)]
    prefix = limits.model
    text = [f'<robot name="{prefix}">', _link("link0", model.links[joints[0].parent])]
    for i, joint in enumerate(joints):
        name = quoteattr(f"joint{i + 1}")
        text.append(
            f'<joint name={name} type="revolute">{_origin(joint.T_parent_joint)}'
            f'<parent link="link{i}"/><child link="link{i + 1}"/>'
            f'<axis xyz="{_numbers(joint.axis)}"/>'
            f'<limit lower="{limits.lower[i]}" upper="{limits.upper[i]}" effort="{limits.torque[i]}" '
            f'velocity="{limits.velocity[i]}"/>{_velocity_limits(limits, i)}</joint>'
        )
        text.append(_link(f"link{i + 1}", model.links[joint.child]))
    text.append(
        f'<joint name="joint8" type="fixed">{_origin(T_LINK7_FLANGE)}'
        f'<parent link="link7"/><child link="link8"/></joint>'
        f'<link name="link8"/></robot>'
    )
    return "\n".join(text)


def _velocity_limits(limits: FrankaLimits, i: int) -> str:
    # A Panda's limits do not depend on the position: so large a deceleration leaves them unchanged.
    offset = limits.velocity_offset[i] if len(limits.velocity_offset) else 0.0
    deceleration = limits.deceleration[i] if len(limits.deceleration) else 1e9
    return f'<position_based_velocity_limits velocity_offset="{offset}" deceleration_limit="{deceleration}"/>'


def _link(name: str, link: Link) -> str:
    if link.inertial is None:
        return f"<link name={quoteattr(name)}/>"
    m = link.inertial.inertia
    entries = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), m[np.triu_indices(3)], strict=True)
    inertia = " ".join(f'{key}="{value:.9g}"' for key, value in entries)
    return (
        f"<link name={quoteattr(name)}><inertial>{_origin(link.inertial.T_link_com)}"
        f'<mass value="{link.inertial.mass:.9g}"/><inertia {inertia}/></inertial></link>'
    )


def _origin(T: SE3) -> str:
    return f'<origin xyz="{_numbers(T.translation)}" rpy="{_numbers(T.rotation.rpy)}"/>'


def _numbers(values: ArrayLike) -> str:
    return " ".join(f"{v:.12g}" for v in np.asarray(values))
