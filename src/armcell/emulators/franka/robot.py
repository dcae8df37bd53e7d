"""Emulated Franka arm without network: modes, motions, parameters, errors and recovery.

The arm is stepped at 1 kHz.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.drivers.franka import settings
from armcell.drivers.franka.settings import FrankaLimits
from armcell.drivers.franka.wire.commands import (
    MoveController,
    MoveGenerator,
    MoveRequest,
    MoveStatus,
    RecoveryStatus,
    SetterStatus,
    StopStatus,
)
from armcell.drivers.franka.wire.state import ControllerMode, GeneratorMode, RobotCommand, RobotMode
from armcell.emulators.franka.impedance_control import Brake, Impedance, cartesian_impedance, joint_impedance
from armcell.emulators.franka.kinematics import JOINTS, measure
from armcell.emulators.franka.motion_generators import (
    CartesianMotion,
    EndEffectorKinematics,
    Generator,
    Interpolation,
    JointPosition,
    JointVelocity,
    MeasuredReference,
    Motion,
    Reference,
    Reflex,
    elbow_of,
)
from armcell.emulators.franka.parameters import T_F_NE, Load, Thresholds, compare
from armcell.emulators.franka.plant import PERIOD, FrankaPlant

log = logging.getLogger(__name__)
Array = NDArray[np.float64]

MAX_LOST = 20  # missing commands in a row that end a motion
WINDOW = 100  # commands of the success rate
FIRST_COMMAND = 1000  # [ms] in which a motion's first command must arrive
RECOVERY = 200  # [ms] that automatic recovery takes; a real arm needs longer
STOP_DECELERATION = 15.0  # [rad/s^2] of reflexes and stops
LIMIT_MARGIN = 0.005  # [rad] beyond a position limit at which an arm has violated it
MOVING = 1e-3  # [rad/s^2] desired acceleration above which the thresholds for acceleration apply
GUIDING_DAMPING = 2.0  # [Nm s/rad]


class Robot:
    """Emulated Franka robot: state and behavior of one arm, without network access.

    Attributes:
        time: [ms] since the start; the identifier of the state message.
        errors, last_errors: active errors, and the errors that ended the last motion.
        success_rate: fraction of the last 100 commands that arrived in time; 0 without a motion.
        listeners: called with a text for each event.
    """

    def __init__(self, limits: FrankaLimits, plant: FrankaPlant):
        self.limits, self.plant = limits, plant
        self._lowest, self._highest = limits.lower - LIMIT_MARGIN, limits.upper + LIMIT_MARGIN
        self._too_fast = 1.2 * limits.velocity
        self.time = 0
        self.mode = RobotMode.IDLE
        self.errors: set[str] = set()
        self.last_errors: set[str] = set()
        self.listeners: list[Callable[[str], None]] = []
        self.NE_T_EE, self.EE_T_K = np.eye(4), np.eye(4)
        self.thresholds, self.impedance, self.load = Thresholds(), Impedance(), Load()
        self.T_F_NE = T_F_NE if plant.hand is not None else np.eye(4)
        self.guiding_axes = (True,) * 7
        self.motion: Motion | None = None
        self.reference = Reference(plant.read()[0].copy())
        self._brake: Brake | None = None
        self._recovered: tuple[int, Callable[[RecoveryStatus], None]] | None = None  # time and answer
        self._arrived: deque[bool] = deque(maxlen=WINDOW)
        self.torque, self.torque_rate = np.zeros(JOINTS), np.zeros(JOINTS)  # tau_J_d [Nm], [Nm/s]
        self._commanded_torque = np.zeros(JOINTS)
        self.joint_contact, self.joint_collision = np.zeros(JOINTS), np.zeros(JOINTS)
        self.cartesian_contact, self.cartesian_collision = np.zeros(6), np.zeros(6)
        self._update_frames()
        self.measure()

    # --- frames and measurements ---
    def _update_frames(self) -> None:
        self.F_T_EE = self.T_F_NE @ self.NE_T_EE
        self._F_T_K = self.F_T_EE @ self.EE_T_K
        self.frames = EndEffectorKinematics(self.plant.kinematics, self.F_T_EE)

    def measure(self) -> None:
        """Update the measured state of the emulated Franka robot from the physics simulation."""
        self.q, self.dq = self.plant.read()
        self.tau_ext = self.plant.external_torques() - self.load_torque()
        poses, wrenches = np.empty((2, 4, 4)), np.empty((2, 6))
        self._deviation = measure(
            *self.plant.kinematics.geometry, self.reference.q, self.q, self.F_T_EE, self._F_T_K, self.tau_ext,
            poses, wrenches,
        )  # fmt: skip
        self.O_T_EE_d, self.O_T_EE = poses[0].T, poses[1].T
        self.O_F_K, self.K_F_K = wrenches

    def load_torque(self) -> Array:
        """Return the joint torques (7,) [Nm] with which the emulated
        Franka robot carries the configured load.
        """
        if self.load.mass == 0.0:
            return np.zeros(JOINTS)
        return self.plant.load_torque(self.load.mass, self.load.center)

    # --- one millisecond ---
    def step(self, commands: Sequence[RobotCommand]) -> None:
        """Run one control cycle of the emulated Franka robot with the commands since the last cycle."""
        command = next((c for c in reversed(commands) if c.time == self.time), None)
        self.time += 1
        self._end_recovery()
        try:
            self._advance(command)
        except Reflex as reflex:
            self.abort(reflex)
        before = self.torque
        self.torque = self._control()
        self.torque_rate = (self.torque - before) / PERIOD
        applied, most = self.torque + self.load_torque(), self.limits.torque
        if self.mode is not RobotMode.GUIDING:
            applied = applied + self.plant.friction_torques()
        self.plant.apply(np.minimum(np.maximum(applied, -most), most))
        self.plant.step()
        self.measure()
        try:
            self._supervise()
        except Reflex as reflex:
            self.abort(reflex)

    def _advance(self, command: RobotCommand | None) -> None:
        motion = self.motion
        if self._brake is not None:
            if self._brake.step():
                self._brake = None
                if motion is not None and motion.ending is not None:
                    self._finish(motion.ending)
                elif self.mode is RobotMode.REFLEX:
                    self.reference.rest(self.q)  # a reflex presses against nothing
            return
        if motion is None:
            if self.mode in (RobotMode.GUIDING, RobotMode.OTHER):
                self.reference.rest(self.q)
            return
        if not motion.started:
            motion.waited += 1
            if command is None and not motion.generator.patient:
                if motion.waited > FIRST_COMMAND:
                    raise Reflex("communication_constraints_violation", "no first command")
                return
            motion.started = True
        self._count(motion, command)
        if isinstance(motion.generator, MeasuredReference):
            self._follow()
        if motion.by_torque and command is not None:
            self._take_torque(command)
        motion.generator.step(command)
        if command is not None and (command.motion_finished or command.torque_finished):
            self._finish_command(motion)

    def _count(self, motion: Motion, command: RobotCommand | None) -> None:
        self._arrived.append(command is not None or motion.generator.patient)
        motion.lost = 0 if self._arrived[-1] else motion.lost + 1
        if motion.lost >= MAX_LOST:
            raise Reflex("communication_constraints_violation", f"{MAX_LOST} commands missing in a row")

    def _follow(self) -> None:
        self.reference.q, self.reference.dq, self.reference.ddq = self.q, self.dq, np.zeros(JOINTS)

    def _take_torque(self, command: RobotCommand) -> None:
        torque = np.array(command.torque)
        if np.any(np.abs(torque) > self.limits.torque):
            raise Reflex("tau_J_range_violation")
        if np.any(np.abs(torque - self._commanded_torque) > self.limits.torque_rate * PERIOD * 1.001):
            raise Reflex("controller_torque_discontinuity")
        self._commanded_torque = torque

    def _finish_command(self, motion: Motion) -> None:
        """End a motion of the emulated Franka robot, because the client has declared it finished.

        Position and velocity commands must be at rest by then.
        """
        motion.ending = MoveStatus.SUCCESS
        if motion.by_torque:
            self._follow()
        moving = bool(np.any(np.abs(self.reference.dq) > 1e-4))
        streamed = not motion.generator.patient and not motion.by_torque
        if streamed and np.any(np.abs(self.reference.dq) / PERIOD > 1.5 * self.limits.acceleration):
            name = "cartesian_motion_generator_velocity_discontinuity"
            raise Reflex(
                name if motion.generator.cartesian else "joint_motion_generator_velocity_discontinuity",
                "the motion finished while moving",
            )
        if moving:
            self._brake = Brake(self.reference, self.limits.acceleration)
        else:
            self.reference.rest(self.reference.q)
            self._finish(MoveStatus.SUCCESS)

    def _control(self) -> Array:
        """Compute the torques (7,) [Nm] that the emulated Franka robot commands to its joints. Gravity and
        friction are compensated separately.
        """
        if self.motion is not None and self.motion.by_torque and self._brake is None:
            return self._commanded_torque
        if self.mode is RobotMode.GUIDING:
            return -GUIDING_DAMPING * self.dq
        cartesian = self.motion is not None and (
            self.motion.request.controller is MoveController.CARTESIAN_IMPEDANCE
        )
        if cartesian and self._brake is None:
            return cartesian_impedance(self.plant, self.frames, self.reference, self.impedance)
        return joint_impedance(self.plant, self.reference, self.impedance)

    def _supervise(self) -> None:
        """Check the state of the emulated Franka robot against the limits.
        Raise Reflex if one is violated.
        """
        accelerating = any(abs(x) > MOVING for x in self.reference.ddq.tolist())
        kind = "_acceleration" if accelerating else ""
        torque, force, found = self.thresholds.torque, self.thresholds.force, np.empty((2, 13))
        compare(
            self.tau_ext, self.K_F_K, torque["lower" + kind], force["lower" + kind], torque["upper" + kind],
            force["upper" + kind], found,
        )  # fmt: skip
        self.joint_contact, self.cartesian_contact = found[0, :JOINTS], found[0, JOINTS:]
        if self.mode is not RobotMode.MOVE:
            return
        if found[1].any():
            if found[1, JOINTS:].any():
                self.cartesian_collision = found[1, JOINTS:]
                raise Reflex("cartesian_reflex", self.plant.contact())
            self.joint_collision = found[1, :JOINTS]
            raise Reflex("joint_reflex", self.plant.contact())
        own = self.plant.links
        if (
            pair := next((p for p in self.plant.take_unexpected_contacts() if p[1] in own), None)
        ) is not None:
            raise Reflex("self_collision_avoidance_violation", f"{pair[0]} and {pair[1]}")
        if self.outside_limits():
            raise Reflex("joint_position_limits_violation")
        if (np.abs(self.dq) > self._too_fast).any():
            raise Reflex("joint_velocity_violation")
        self._check_deviation()

    def _check_deviation(self) -> None:
        motion = self.motion
        if motion is None or isinstance(motion.generator, MeasuredReference):
            return
        translation, rotation, elbow = motion.request.path_deviation
        off, turned = self._deviation
        if off > translation or turned > rotation or abs(self.reference.q[2] - self.q[2]) > elbow:
            raise Reflex("max_path_pose_deviation_violation", f"{off:.4f} m, {turned:.4f} rad")

    def outside_limits(self) -> bool:
        """Return whether a joint of the emulated Franka robot is beyond its position limits."""
        return bool(((self.q < self._lowest) | (self.q > self._highest)).any())

    # --- motions ---
    def move(self, request: MoveRequest, answer: Callable[[MoveStatus], None]) -> None:
        """Start a motion of the emulated Franka robot. `answer` is called when it starts and when it ends."""
        if self.mode is not RobotMode.IDLE or self.motion is not None:
            answer(MoveStatus.NOT_POSSIBLE)
            return
        interpolates = request.interpolate and request.generator is not MoveGenerator.JOINT_POSITION
        if interpolates or (
            request.generator is MoveGenerator.NONE and request.controller is not MoveController.EXTERNAL
        ):
            answer(MoveStatus.INVALID_ARGUMENT)
            return
        self._brake = None
        self.reference.rest(self.reference.q)
        self.last_errors = set()
        self._clear_contacts()
        self.impedance.fit(self.plant.inertia())
        self._arrived.clear()
        self._commanded_torque = self.torque
        self.motion = Motion(request, answer, self._generator(request))
        self.mode = RobotMode.MOVE
        answer(MoveStatus.STARTED)
        if self.outside_limits():
            self.abort(Reflex("joint_position_limits_violation", "at the start"))

    def _generator(self, request: MoveRequest) -> Generator:
        match request.generator:
            case MoveGenerator.JOINT_POSITION if request.interpolate:
                return Interpolation(self.limits, self.reference, request.max_velocity)
            case MoveGenerator.JOINT_POSITION:
                return JointPosition(self.limits, self.reference)
            case MoveGenerator.JOINT_VELOCITY:
                return JointVelocity(self.limits, self.reference)
            case MoveGenerator.NONE:
                return MeasuredReference()
        velocity = request.generator is MoveGenerator.CARTESIAN_VELOCITY
        return CartesianMotion(self.limits, self.reference, self.frames, velocity)

    def _finish(self, status: MoveStatus) -> None:
        motion, self.motion = self.motion, None
        if self.mode is RobotMode.MOVE:
            self.mode = RobotMode.IDLE
        if motion is not None:
            motion.answer(status)

    def stop(self) -> StopStatus:
        """Stop the motion of the emulated Franka robot in response to a client's Stop command."""
        if self.motion is not None:
            if self.motion.by_torque:
                self._follow()
            self.motion.ending = MoveStatus.PREEMPTED
            self._slow_down()
        return StopStatus.SUCCESS

    def _slow_down(self) -> None:
        self._brake = Brake(self.reference, np.full(JOINTS, STOP_DECELERATION))

    def abort(self, reflex: Reflex, status: MoveStatus = MoveStatus.REFLEX_ABORTED) -> None:
        """End the motion of the emulated Franka robot with an error, and bring the arm to rest."""
        if self.mode in (RobotMode.REFLEX, RobotMode.USER_STOPPED, RobotMode.OTHER):
            return
        self.announce(f"reflex: {reflex}")
        if self.motion is not None and self.motion.by_torque:
            self._follow()
        self.errors.add(reflex.error)
        self.last_errors = {reflex.error}
        self.mode = RobotMode.REFLEX
        self._slow_down()
        self._finish(status)

    def recover(self, answer: Callable[[RecoveryStatus], None]) -> None:
        """Clear errors of the emulated Franka robot at the client's request,
        except those that only a person can clear.

        The recovery takes `RECOVERY` ms.
        """
        if self.mode in (RobotMode.OTHER, RobotMode.USER_STOPPED, RobotMode.AUTOMATIC_ERROR_RECOVERY):
            answer(RecoveryStatus.NOT_POSSIBLE)
        elif self.outside_limits():
            answer(RecoveryStatus.MANUAL_RECOVERY_REQUIRED)
        elif self.mode is RobotMode.REFLEX:
            self.mode = RobotMode.AUTOMATIC_ERROR_RECOVERY
            self._recovered = self.time + RECOVERY, answer
        else:
            answer(RecoveryStatus.SUCCESS)

    def _end_recovery(self) -> None:
        if self._recovered is None:
            return
        due, answer = self._recovered
        if self.mode is not RobotMode.AUTOMATIC_ERROR_RECOVERY:
            self._recovered = None
            answer(RecoveryStatus.EMERGENCY_ABORTED)
        elif self.time >= due:
            self._recovered = None
            self.errors.clear()
            self._clear_contacts()
            self._brake = None
            self.reference.rest(self.q)
            self.mode = RobotMode.IDLE
            answer(RecoveryStatus.SUCCESS)

    def _clear_contacts(self) -> None:
        self.joint_collision, self.cartesian_collision = np.zeros(JOINTS), np.zeros(6)

    # --- the operator ---
    def user_stop(self, pressed: bool) -> None:
        """Put the emulated Franka robot into the mode "user stopped", as a pressed user stop does, or release
        it to the mode "idle".
        """
        if pressed and self.mode is not RobotMode.USER_STOPPED:
            self.announce("user stop pressed")
            self.mode = RobotMode.USER_STOPPED
            self._slow_down()
            self._finish(MoveStatus.EMERGENCY_ABORTED)
        elif not pressed and self.mode is RobotMode.USER_STOPPED:
            self.announce("user stop released")
            self.errors.clear()
            self.reference.rest(self.q)
            self.mode = RobotMode.IDLE

    def brakes(self, locked: bool) -> None:
        """Lock or unlock the brakes of the emulated Franka robot. Locking ends its motion."""
        if locked:
            self._slow_down()
            self._finish(MoveStatus.ABORTED)
            self.mode = RobotMode.OTHER
        elif self.mode is RobotMode.OTHER:
            self.reference.rest(self.q)
            self.mode = RobotMode.IDLE

    def guide(self, on: bool) -> None:
        """Switch the emulated Franka robot to guiding by hand, or back to idle: the enabling button is
        pressed or released.
        """
        if on and self.mode is RobotMode.IDLE:
            self.mode = RobotMode.GUIDING
        elif not on and self.mode is RobotMode.GUIDING:
            self.reference.rest(self.q)
            self.mode = RobotMode.IDLE

    def displace(self, q: ArrayLike) -> None:
        """Move the emulated Franka robot to joint positions (7,) [rad] at once."""
        self.plant.displace(q)
        self.follow_reset()

    def follow_reset(self) -> None:
        """Abort the motion of the emulated Franka robot, clear its errors and hold the present joint
        positions, after the simulated arm was reset or displaced.
        """
        self._finish(MoveStatus.ABORTED)
        self._brake = None
        self.errors.clear()
        self._clear_contacts()
        self.measure()
        self.reference.rest(self.q)
        if self.mode is RobotMode.REFLEX:
            self.mode = RobotMode.IDLE

    def announce(self, text: str) -> None:
        log.info("%s", text)
        for listener in self.listeners:
            listener(text)

    # --- parameters ---
    @property
    def can_set_parameters(self) -> SetterStatus:
        """Return the status with which the emulated Franka robot answers a client that wants to change its
        configuration: not possible during a motion, otherwise success.
        """
        return SetterStatus.NOT_POSSIBLE if self.mode is RobotMode.MOVE else SetterStatus.SUCCESS

    def set_load(self, mass: float, center: ArrayLike, inertia: ArrayLike) -> SetterStatus:
        """Give the emulated Franka robot a load [kg], with its center (3,) [m] and inertia (9,) [kg m^2]."""
        load = Load(mass, np.asarray(center, dtype=float), np.asarray(inertia, dtype=float))
        heavy = mass + (settings.HAND_MASS if self.plant.hand else 0.0) > settings.MAX_LOAD
        if heavy or not load.is_valid:
            return SetterStatus.INVALID_ARGUMENT
        self.load = load
        return SetterStatus.SUCCESS

    def set_frame(self, name: str, values: Sequence[float]) -> SetterStatus:
        """Change the end effector frame or the stiffness frame of the emulated Franka robot (NE_T_EE or
        EE_T_K), given as 16 column-major numbers.
        """
        T = np.array(values).reshape(4, 4).T
        valid = np.allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-4) and np.linalg.det(T[:3, :3]) > 0
        if not valid or not np.allclose(T[3], (0, 0, 0, 1)):
            return SetterStatus.INVALID_ARGUMENT
        setattr(self, name, T)
        self._update_frames()
        return SetterStatus.SUCCESS

    def set_stiffness(self, joint: bool, values: Sequence[float]) -> SetterStatus:
        """Set the joint (7) or Cartesian (6) stiffness of the emulated Franka robot. Values that Franka does
        not allow are rejected.

        Units are [Nm/rad] for joints and rotations, and [N/m] for translations.
        """
        valid = self.impedance.set_stiffness(joint, np.array(values))
        return SetterStatus.SUCCESS if valid else SetterStatus.INVALID_ARGUMENT

    def set_thresholds(self, values: Sequence[float]) -> SetterStatus:
        """Set the 52 torque and force thresholds at which the emulated Franka robot detects contacts and
        collisions (SetCollisionBehavior).
        """
        valid = self.thresholds.set(np.array(values))
        return SetterStatus.SUCCESS if valid else SetterStatus.INVALID_ARGUMENT

    # --- modes of the state message ---
    @property
    def generator_mode(self) -> GeneratorMode:
        return GeneratorMode.IDLE if self.motion is None else GeneratorMode(self.motion.request.generator + 1)

    @property
    def controller_mode(self) -> ControllerMode:
        return ControllerMode.OTHER if self.motion is None else ControllerMode(self.motion.request.controller)

    @property
    def success_rate(self) -> float:
        return sum(self._arrived) / len(self._arrived) if self.motion is not None and self._arrived else 0.0

    @property
    def elbow(self) -> Array:
        return elbow_of(self.q)
