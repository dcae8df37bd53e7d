"""Kinematics of a Franka arm: forward kinematics, Jacobian, and robot description (URDF)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from xml.sax.saxutils import quoteattr

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, InputError
from armcell.drivers.franka.settings import FrankaLimits
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


@njit(cache=True)
def _multiply(T, step):
    """Multiply a pose (4, 4) in the kinematics of a Franka arm by another pose from the right, in place."""
    for r in range(3):
        a, b, c = T[r, 0], T[r, 1], T[r, 2]
        for k in range(3):
            T[r, k] = a * step[0, k] + b * step[1, k] + c * step[2, k]
        T[r, 3] += a * step[0, 3] + b * step[1, 3] + c * step[2, 3]


@njit("void(f8[:,:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1])", cache=True)
def chain(steps, axes, q, tool, T, J):
    """Compute the kinematics of an emulated Franka arm: pose T (4, 4) of a frame fixed to the last link, and
    Jacobian J (6, 7) of its origin, linear rows first. Both are in the base frame O.

    Args:
        steps, axes: poses (8, 4, 4) of the joints and the flange in their parents, joint axes (7, 3).
        q: joint positions (7,) [rad].
        tool: pose (4, 4) of the frame in the flange frame.
    """
    turn, origins = np.eye(4), np.empty((JOINTS, 3))
    T[:] = np.eye(4)
    for i in range(JOINTS):
        _multiply(T, steps[i])
        x, y, z = axes[i, 0], axes[i, 1], axes[i, 2]
        for r in range(3):
            origins[i, r] = T[r, 3]
            J[3 + r, i] = T[r, 0] * x + T[r, 1] * y + T[r, 2] * z
        s, c = np.sin(q[i]), np.cos(q[i])
        t = 1.0 - c
        turn[0, 0], turn[0, 1], turn[0, 2] = c + t * x * x, t * x * y - s * z, t * x * z + s * y
        turn[1, 0], turn[1, 1], turn[1, 2] = t * x * y + s * z, c + t * y * y, t * y * z - s * x
        turn[2, 0], turn[2, 1], turn[2, 2] = t * x * z - s * y, t * y * z + s * x, c + t * z * z
        _multiply(T, turn)
    _multiply(T, steps[JOINTS])
    _multiply(T, tool)
    for i in range(JOINTS):
        x, y, z = T[0, 3] - origins[i, 0], T[1, 3] - origins[i, 1], T[2, 3] - origins[i, 2]
        J[0, i] = J[4, i] * z - J[5, i] * y
        J[1, i] = J[5, i] * x - J[3, i] * z
        J[2, i] = J[3, i] * y - J[4, i] * x


@njit(cache=True)
def _wrench(J, torque, felt):
    """Compute the wrench on an emulated Franka arm from joint torques with its kinematics: solve J J^T w = J
    tau, and write w to `felt` (6,). The wrench is zero near singularities, where det(J J^T) < 1e-8.
    """
    A, determinant = np.zeros((6, 7)), 1.0
    for r in range(6):
        for k in range(JOINTS):
            A[r, 6] += J[r, k] * torque[k]
            for c in range(6):
                A[r, c] += J[r, k] * J[c, k]
    felt[:] = 0.0
    for i in range(6):  # Gaussian elimination; a positive definite matrix needs no pivoting
        determinant *= A[i, i]
        if not A[i, i] > 0.0:
            return
        for r in range(i + 1, 6):
            for c in range(6, i - 1, -1):
                A[r, c] -= A[r, i] / A[i, i] * A[i, c]
    if determinant < 1e-8:
        return
    for i in range(5, -1, -1):
        for c in range(i + 1, 6):
            A[i, 6] -= A[i, c] * felt[c]
        felt[i] = A[i, 6] / A[i, i]


@njit("f8[::1](f8[:,::1])", cache=True)
def rotation_log(R):
    """Return the rotation vector (3,) [rad] of a rotation (3, 3) of less than half a turn,
    for the kinematics of Franka arms.
    """
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    if sine < 1e-12:
        return axis
    return axis * (np.arctan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)) / sine)


@njit(cache=True)
def measure(steps, axes, q_d, q, F_T_EE, F_T_K, torque, poses, wrenches):
    """Compute the Cartesian state of an emulated Franka arm with its kinematics: poses and wrenches of the
    end effector and the stiffness frame.

    Args:
        steps, axes: see `chain`.
        q_d, q: desired and measured joint positions (7,) [rad].
        F_T_EE, F_T_K: end effector and stiffness frame (4, 4) in the flange frame.
        torque: external joint torques (7,) [Nm].
        poses: (2, 4, 4) transposes of O_T_EE_d and O_T_EE, changed in place.
        wrenches: (2, 6) O_F_K and K_F_K [N, Nm], changed in place.
    Returns:
        Distance [m] and angle [rad] between the desired and the measured end effector.
    """
    wanted, T, J, turn = np.empty((4, 4)), np.empty((4, 4)), np.empty((6, JOINTS)), np.zeros((3, 3))
    chain(steps, axes, q_d, F_T_EE, wanted, J)
    chain(steps, axes, q, F_T_EE, T, J)
    off = 0.0
    for r in range(4):
        for c in range(4):
            poses[0, c, r], poses[1, c, r] = wanted[r, c], T[r, c]
    for r in range(3):
        off += (wanted[r, 3] - T[r, 3]) ** 2
        for c in range(3):
            turn[r, c] = wanted[r, 0] * T[c, 0] + wanted[r, 1] * T[c, 1] + wanted[r, 2] * T[c, 2]
    chain(steps, axes, q, F_T_K, T, J)
    _wrench(J, torque, wrenches[0])
    wrenches[1] = 0.0
    for r in range(3):
        for k in range(3):
            wrenches[1, r] += T[k, r] * wrenches[0, k]
            wrenches[1, 3 + r] += T[k, r] * wrenches[0, 3 + k]
    x, y, z = rotation_log(turn)
    return np.sqrt(off), np.sqrt(x * x + y * y + z * z)


class ArmKinematics:
    """Forward kinematics and Jacobian of an emulated Franka arm, in the frame of its base (O).

    Args:
        joints: the arm's joints, base to flange.
    """

    def __init__(self, joints: Sequence[Joint]):
        poses = [*(joint.T_parent_joint for joint in joints), T_LINK7_FLANGE]
        self.geometry = (
            np.array([T.matrix for T in poses]),
            np.array([np.array(joint.axis) / np.linalg.norm(joint.axis) for joint in joints]),
        )

    def pose_and_jacobian(self, q: Array, tool: Array) -> tuple[Array, Array]:
        """Return the pose (4, 4) of a frame fixed to the flange, and the Jacobian (6, 7) of its origin,
        linear rows first, from the kinematics of a Franka arm.

        Args:
            q: joint positions (7,) [rad].
            tool: pose (4, 4) of the frame in the flange frame.
        """
        T, J = np.empty((4, 4)), np.empty((6, JOINTS))
        chain(*self.geometry, q, tool, T, J)
        return T, J


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
    """Return the URDF with the kinematics of the emulated Franka arm, without the hand, as the robot's
    controller sends it to clients.

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
