"""Motion generators of the emulated Franka arm, which turn commands into checked references.

There is one reference per millisecond. A missing command is replaced by extrapolation with constant
acceleration, as Franka's documentation describes. A command outside the limits raises a `Reflex`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import ruckig
from numba import njit
from numpy.typing import NDArray

from armcell.drivers.franka.settings import ELBOW_FLIP, FrankaLimits
from armcell.drivers.franka.wire.commands import MoveController, MoveRequest, MoveStatus
from armcell.drivers.franka.wire.state import RobotCommand
from armcell.emulators.franka.kinematics import JOINTS, ArmKinematics, rotation_exp, rotation_log
from armcell.emulators.franka.plant import PERIOD

Array = NDArray[np.float64]

QUANTUM = 2.0**-22  # [rad or m] rounding of a float32 position near 2 to 4, which clients start from
START_JUMP = 2e-3  # [rad or m] largest distance of a motion's first command from the reference
ELBOW_START = 1e-2  # [rad]


class Reflex(Exception):
    """Reflex error of the emulated Franka arm. A motion generator raises the error for an invalid command or
    a violated limit, and the error ends the motion.

    Attributes:
        error: name in `wire.errors.ERRORS`.
    """

    def __init__(self, error: str, detail: str = ""):
        super().__init__(f"{error}{f' ({detail})' if detail else ''}")
        self.error = error


@dataclass
class Reference:
    """Reference that a Franka motion generator produces: the desired joint motion, and the desired pose and
    motion of the end effector in the base frame O.

    Attributes:
        T: T_O_EE (4, 4); twist (6,) [m/s, rad/s] and acceleration (6,) of the command.
    """

    q: Array
    dq: Array = field(default_factory=lambda: np.zeros(JOINTS))
    ddq: Array = field(default_factory=lambda: np.zeros(JOINTS))
    T: Array = field(default_factory=lambda: np.eye(4))
    twist: Array = field(default_factory=lambda: np.zeros(6))
    dtwist: Array = field(default_factory=lambda: np.zeros(6))
    elbow: Array = field(default_factory=lambda: np.zeros(2))

    def rest(self, q: Array) -> None:
        """Set the reference of a Franka motion generator to joint positions q (7,) at rest."""
        self.q, self.dq, self.ddq = np.array(q, dtype=float), np.zeros(JOINTS), np.zeros(JOINTS)
        self.twist, self.dtwist = np.zeros(6), np.zeros(6)


@dataclass(frozen=True)
class EndEffectorKinematics:
    """Kinematics of a Franka arm up to its configured end effector frame, for the motion generators."""

    kinematics: ArmKinematics
    T_F_EE: Array

    def pose(self, q: Array) -> Array:
        """Return the end effector pose T_O_EE (4, 4) for a Franka
        motion generator at joint positions q (7,).
        """
        return self.pose_and_jacobian(q)[0]

    def pose_and_jacobian(self, q: Array) -> tuple[Array, Array]:
        return self.kinematics.pose_and_jacobian(q, self.T_F_EE)


class Generator(Protocol):
    """Interface of a motion generator for the emulated Franka arm. `step` advances the reference by 1 ms.

    Attributes:
        cartesian: whether the commands are Cartesian, so that a client reads back a Cartesian reference.
        patient: whether missing commands are normal.
    """

    cartesian: bool
    patient: bool

    def step(self, command: RobotCommand | None) -> None:
        """Advance the reference of a Franka motion generator by one command.
        If the command is missing (None), extrapolate.

        Raises:
            Reflex: the command violates a limit.
        """
        ...


def check_joints(
    limits: FrankaLimits, reference: Reference, q: Array, dq: Array, names: tuple[str, str, str, str],
    noise: float = QUANTUM,
) -> None:  # fmt: skip
    """Check the next joint reference of a Franka motion generator against the limits, and set it.

    Args:
        q, dq: next positions [rad] and velocities [rad/s] (7,).
        names: errors for position, velocity, acceleration and jerk.
        noise: rounding of the commanded positions [rad].
    Raises:
        Reflex: a limit is violated.
    """
    low, high = limits.velocity_range(q)
    ddq, jerk = np.empty(JOINTS), np.empty(JOINTS)
    kind, at = _violation(
        q, dq, reference.dq, reference.ddq, limits.lower, limits.upper, low, high, limits.acceleration,
        limits.jerk, noise, ddq, jerk,
    )  # fmt: skip
    if kind >= 0:
        detail = (
            f"joint {at + 1} at {q[at]:.4f} rad",
            f"joint {at + 1} at {dq[at]:.3f} rad/s, limits {low[at]:.3f} to {high[at]:.3f}",
            f"joint {at + 1}: {ddq[at]:.1f} rad/s^2",
            f"joint {at + 1}: {jerk[at]:.0f} rad/s^3",
        )
        raise Reflex(names[kind], detail[kind])
    reference.q, reference.dq, reference.ddq = q, dq, ddq


@njit(f"UniTuple(i8, 2)({', '.join(['f8[::1]'] * 10)}, f8, f8[::1], f8[::1])", cache=True)
def _violation(q, dq, dq_before, ddq_before, lower, upper, low, high, most, jerkiest, noise, ddq, jerk):
    """Check the next joint reference of a Franka motion generator: compute `ddq` and `jerk` (7,) in place.

    Args:
        lower, upper, low, high, most, jerkiest: limits (7,) of position, velocity, acceleration and jerk.
    Returns:
        Index of the first violated limit in the names of `check_joints`, and its joint; -1 and -1 without.
    """
    for j in range(JOINTS):
        ddq[j] = (dq[j] - dq_before[j]) / PERIOD
        jerk[j] = (ddq[j] - ddq_before[j]) / PERIOD
    for kind in range(4):
        for j in range(JOINTS):
            slack = 2.0 * noise / PERIOD + 1e-3
            if (
                (kind == 0 and (q[j] < lower[j] or q[j] > upper[j]))
                or (kind == 1 and (dq[j] < low[j] - slack or dq[j] > high[j] + slack))
                or (kind == 2 and abs(ddq[j]) > most[j] + 4.0 * noise / PERIOD**2)
                or (kind == 3 and abs(jerk[j]) > jerkiest[j] + 8.0 * noise / PERIOD**3)
            ):
                return kind, j
    return -1, -1


def _first(mask: NDArray[np.bool_]) -> int | None:
    return int(mask.argmax()) if mask.any() else None


JOINT_ERRORS = (
    "joint_motion_generator_position_limits_violation",
    "joint_motion_generator_velocity_limits_violation",
    "joint_motion_generator_velocity_discontinuity",
    "joint_motion_generator_acceleration_discontinuity",
)
CARTESIAN_JOINT_ERRORS = (
    "cartesian_motion_generator_joint_position_limits_violation",
    "cartesian_motion_generator_joint_velocity_limits_violation",
    "cartesian_motion_generator_joint_velocity_discontinuity",
    "cartesian_motion_generator_joint_acceleration_discontinuity",
)


class JointPosition:
    cartesian = False
    patient = False

    def __init__(self, limits: FrankaLimits, reference: Reference):
        self._limits, self._reference, self._started = limits, reference, False

    def step(self, command: RobotCommand | None) -> None:
        r = self._reference
        if command is None:
            r.dq = r.dq + r.ddq * PERIOD
            r.q = r.q + r.dq * PERIOD
            return
        q = np.array(command.q)
        if not self._started:
            self._started = True
            off = np.abs(q - r.q)
            if off.max() > START_JUMP:
                at = int(off.argmax())
                raise Reflex(
                    "joint_position_motion_generator_start_pose_invalid",
                    f"joint {at + 1} is {off[at]:.4f} rad from the first command",
                )
        check_joints(self._limits, r, q, (q - r.q) / PERIOD, JOINT_ERRORS)


class JointVelocity:
    cartesian = False
    patient = False

    def __init__(self, limits: FrankaLimits, reference: Reference):
        self._limits, self._reference = limits, reference

    def step(self, command: RobotCommand | None) -> None:
        r = self._reference
        dq = r.dq + r.ddq * PERIOD if command is None else np.array(command.dq)
        q = r.q + dq * PERIOD
        if command is None:
            r.q, r.dq = q, dq
        else:
            check_joints(self._limits, r, q, dq, JOINT_ERRORS)


class Interpolation:
    """Motion generator of the emulated Franka arm for joint positions that arrive at a low rate.
    The robot interpolates between them.

    This is Franka's asynchronous control.
    """

    cartesian = False
    patient = True

    def __init__(self, limits: FrankaLimits, reference: Reference, max_velocity: tuple[float, ...]):
        self._reference, self._limits = reference, limits
        self._planner = ruckig.Ruckig(JOINTS, PERIOD)
        self._input, self._output = ruckig.InputParameter(JOINTS), ruckig.OutputParameter(JOINTS)
        self._input.max_velocity = [
            min(v, w) if v > 0 else w for v, w in zip(max_velocity, limits.velocity.tolist(), strict=True)
        ]
        self._input.max_acceleration = limits.acceleration.tolist()
        self._input.max_jerk = limits.jerk.tolist()
        self._input.target_position = reference.q.tolist()

    def step(self, command: RobotCommand | None) -> None:
        r = self._reference
        if command is not None and not command.motion_finished:
            q = np.array(command.q)
            at = _first((q < self._limits.lower) | (q > self._limits.upper))
            if at is not None:
                raise Reflex(JOINT_ERRORS[0], f"joint {at + 1} at {q[at]:.4f} rad")
            self._input.target_position = q.tolist()
        self._input.current_position = r.q.tolist()
        self._input.current_velocity = r.dq.tolist()
        self._input.current_acceleration = r.ddq.tolist()
        if self._planner.update(self._input, self._output) < 0:
            raise Reflex("joint_via_motion_generator_planning_joint_limit_violation")
        r.q = np.array(self._output.new_position)
        r.dq = np.array(self._output.new_velocity)
        r.ddq = np.array(self._output.new_acceleration)


class CartesianMotion:
    """Motion generator of the emulated Franka arm for poses or velocities of the end effector.

    The elbow's angle resolves the pose to joint positions.
    """

    cartesian = True
    patient = False

    def __init__(
        self, limits: FrankaLimits, reference: Reference, frames: EndEffectorKinematics, velocity: bool
    ):
        self._limits, self._reference, self._frames, self._velocity = limits, reference, frames, velocity
        reference.T = frames.pose(reference.q)
        reference.twist, reference.dtwist = np.zeros(6), np.zeros(6)
        reference.elbow = elbow_of(reference.q)
        self._started, self._delbow, self._ddelbow = False, 0.0, 0.0

    def step(self, command: RobotCommand | None) -> None:
        r = self._reference
        extrapolated = r.twist + r.dtwist * PERIOD
        if command is None:
            twist, dtwist, T = extrapolated, r.dtwist, _moved(r.T, extrapolated)
        else:
            T, twist = self._commanded(command)
            dtwist = (twist - r.twist) / PERIOD
            self._check(twist, dtwist)
        elbow = self._elbow(command)
        q = self._resolve(T, elbow)
        dq = (q - r.q) / PERIOD
        if command is None:
            r.ddq = (dq - r.dq) / PERIOD
            r.q, r.dq = q, dq
        else:
            # the inverse kinematics amplifies the rounding of the commanded pose
            check_joints(self._limits, r, q, dq, CARTESIAN_JOINT_ERRORS, 4.0 * QUANTUM)
        r.T, r.twist, r.dtwist = T, twist, dtwist

    def _commanded(self, command: RobotCommand) -> tuple[Array, Array]:
        r = self._reference
        if self._velocity:
            twist = np.array(command.O_dP_EE)
            return _moved(r.T, twist), twist
        T = np.array(command.O_T_EE).reshape(4, 4).T
        R = T[:3, :3]
        if np.abs(R.T @ R - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
            raise Reflex("cartesian_position_motion_generator_invalid_frame_flag")
        move = np.concatenate([T[:3, 3] - r.T[:3, 3], rotation_log(R @ r.T[:3, :3].T)])
        if not self._started:
            self._started = True
            if np.abs(move).max() > START_JUMP:
                raise Reflex("cartesian_position_motion_generator_start_pose_invalid")
        return T, move / PERIOD

    def _check(self, twist: Array, dtwist: Array) -> None:
        limits, r = self._limits, self._reference
        jerk = (dtwist - r.dtwist) / PERIOD
        for part, i in ((slice(0, 3), 0), (slice(3, 6), 1)):
            if np.linalg.norm(twist[part]) > limits.cartesian_velocity[i] + 2.0 * QUANTUM / PERIOD:
                raise Reflex("cartesian_motion_generator_velocity_limits_violation")
            rate = float(np.linalg.norm(dtwist[part]))
            if rate > limits.cartesian_acceleration[i] + 8.0 * QUANTUM / PERIOD**2:
                raise Reflex("cartesian_motion_generator_velocity_discontinuity", f"{rate:.1f}")
            change = float(np.linalg.norm(jerk[part]))
            if change > limits.cartesian_jerk[i] + 16.0 * QUANTUM / PERIOD**3:
                raise Reflex("cartesian_motion_generator_acceleration_discontinuity", f"{change:.0f}")

    def _elbow(self, command: RobotCommand | None) -> float | None:
        """Return the elbow angle (joint 3, [rad]) in the command to a Franka motion generator, or None."""
        if command is None or not command.valid_elbow:
            return None
        r, limits = self._reference, self._limits
        angle, sign = command.elbow
        if sign != r.elbow[1]:
            raise Reflex("cartesian_motion_generator_elbow_sign_inconsistent")
        if not limits.lower[2] <= angle <= limits.upper[2]:
            raise Reflex("cartesian_motion_generator_elbow_limit_violation")
        rate = (angle - r.elbow[0]) / PERIOD
        if abs(rate) > limits.elbow_velocity + 2.0 * QUANTUM / PERIOD:
            raise Reflex("cartesian_motion_generator_elbow_limit_violation", f"{rate:.2f} rad/s")
        r.elbow = np.array([angle, sign])
        return angle

    def _resolve(self, T: Array, elbow: float | None) -> Array:
        """Compute the joint positions (7,) [rad] of a Cartesian motion generator for the Franka arm, at which
        the end effector has the pose T.

        The solution takes Newton steps from the current joint reference of the motion generator. If an elbow
        angle is given, joint 3 takes this angle; otherwise the joint motion has the least norm. Raises Reflex
        at a singularity.
        """
        q = self._reference.q
        for _ in range(3):
            at, J = self._frames.pose_and_jacobian(q)
            off = np.concatenate([T[:3, 3] - at[:3, 3], rotation_log(T[:3, :3] @ at[:3, :3].T)])
            if elbow is None:
                gram = J @ J.T
                if np.linalg.det(gram) < 1e-10:
                    raise Reflex("cartesian_motion_generator_joint_velocity_limits_violation", "singularity")
                q = q + J.T @ np.linalg.solve(gram, off)
            else:
                square = np.vstack([J, np.eye(JOINTS)[2]])
                if abs(np.linalg.det(square)) < 1e-5:
                    raise Reflex("cartesian_motion_generator_joint_velocity_limits_violation", "singularity")
                q = q + np.linalg.solve(square, np.append(off, elbow - q[2]))
            if np.abs(off).max() < 1e-10:
                break
        if elbow is None:
            self._reference.elbow = elbow_of(q)
        return q


class MeasuredReference:
    """Motion generator of the emulated Franka arm under torque control.
    Its reference follows the measured motion of the arm.
    """

    cartesian = False
    patient = False

    def step(self, command: RobotCommand | None) -> None:
        pass


@dataclass(eq=False)
class Motion:
    """Motion that the emulated Franka arm executes: the client's request and the motion generator."""

    request: MoveRequest
    answer: Callable[[MoveStatus], None]
    generator: Generator
    started: bool = False
    waited: int = 0
    lost: int = 0
    ending: MoveStatus | None = None  # answer once the arm is at rest

    @property
    def by_torque(self) -> bool:
        """Return whether the client commands a motion of the emulated Franka arm by joint torques instead of
        a motion generator.

        Otherwise the arm follows the reference of a motion generator.
        """
        return self.request.controller is MoveController.EXTERNAL


def elbow_of(q: Array) -> Array:
    """Return the elbow (2,) of a Franka arm for its motion generators:
    the angle of joint 3 [rad] and the flip of joint 4.
    """
    return np.array([q[2], np.sign(q[3] - ELBOW_FLIP)])


def _moved(T: Array, twist: Array) -> Array:
    """Return the pose (4, 4) that a Franka motion generator reaches
    from a given pose with a twist (6,) in one period.
    """
    moved = T.copy()
    moved[:3, 3] += twist[:3] * PERIOD
    moved[:3, :3] = rotation_exp(twist[3:] * PERIOD) @ T[:3, :3]
    return moved
