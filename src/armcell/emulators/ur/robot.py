"""Emulated UR robot: modes, registers, inputs, outputs, and motion in control steps."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import ArmcellError
from armcell.drivers.ur.wire.kinematics import cross, forward, jacobian, pose_of
from armcell.drivers.ur.wire.models import UrModel
from armcell.drivers.ur.wire.modes import MAY_MOVE, RobotMode, RuntimeState, SafetyMode
from armcell.drivers.ur.wire.primary import Kinematics
from armcell.drivers.ur.wire.rtde import REGISTERS
from armcell.emulators.ur.compliance import Compliance
from armcell.emulators.ur.motion import KEPT, Motion, MotionFault, Setpoint, StopJ, TrackL
from armcell.emulators.ur.notices import Notice, Popup, ProgramState, SafetyChange, ScriptFault, TextMessage
from armcell.emulators.ur.plant import Plant
from armcell.emulators.ur.urscript import Machine, ProgramError, ScriptError

log = logging.getLogger(__name__)
Array = NDArray[np.float64]

RAMP = 0.2  # [s] in which a pause reduces the speed scaling from 1 to 0, and a resume restores it
STOP_DECELERATION = 25.0  # [rad/s^2] of safety stops
POWER_ON_TIME, BRAKE_TIME = 0.3, 0.3  # [s]; a real arm takes several seconds
TOOL_INPUT_HOLDS = 16  # digital input bit of the tool: the gripper holds an object
TOOL_OUTPUT_CLOSE = 16  # digital output bit of the tool: close the gripper
TOOL_GRIP_FORCE = 0.3  # fraction of the gripper's largest force when a digital output closes it
FORCE_OFFSET = (4.0, 4.0, 4.0, 0.4, 0.4, 0.4)  # [N, Nm] standard deviation over robots
HISTORY = 1.0  # [s] length of the position and force history for programs
MIN_UPTIME = 60.0  # [s] controller time at start: UR's client library requires a minimum uptime


class Robot:
    """Emulated UR robot: the state and behavior of one arm with its controller, without network access."""

    def __init__(self, model: UrModel, plant: Plant, serial: str, kinematics: Kinematics | None = None):
        self.model, self.plant, self.serial = model, plant, serial
        self.dh = kinematics or model.dh
        self.period = 1.0 / model.frequency
        self.setpoint = Setpoint(model, self.dh, plant.read()[0])
        self.remote = True
        self.mode, self._safety = RobotMode.RUNNING, SafetyMode.NORMAL
        self.runtime, self.program_name = RuntimeState.STOPPED, ""
        self.time, self.program_time = MIN_UPTIME, 0.0
        self.slider, self.scaling = 1.0, 1.0
        self.inputs: dict[str, Any] = {}  # RTDE inputs, by variable name
        self.output_int, self.output_double = [0] * REGISTERS, [0.0] * REGISTERS
        self.output_bits = 0  # boolean registers 0..127
        self.digital_in, self.digital_out = 0, 0
        self.analog_out = [0.0, 0.0]  # 0..1 of the range
        self.analog_volts = 0  # bit i: analog output i is a voltage, not a current
        self.tool_voltage = 0
        self.payload, self.payload_cog, self.payload_inertia = 0.0, [0.0] * 3, [0.0] * 6
        self.gravity = [0.0, 0.0, 9.82]  # [m/s^2] proper acceleration of the base at rest, base frame
        self.target_qdd, self.actual_qdd = np.zeros(6), np.zeros(6)  # [rad/s^2]
        self.motion: Motion | None = None
        self.compliance: Compliance | None = None
        self.waypoint: list[float] | None = None  # pose of the last motion's goal
        self.hand = np.zeros(3)  # [N] force of a person's hand on the tool, base frame
        self.external_ft = False  # use forces from `external_force_torque`, not from the arm
        self.history: deque[tuple[Array, Array]] = deque(maxlen=round(HISTORY / self.period))
        self.detecting = 0.0  # [s] until then the hand may touch: contact detection
        self.machine: Machine | None = None
        self.messages: list[str] = []
        self.listeners: list[Callable[[Notice], None]] = []
        self._watchdog: tuple[int, float] | None = None  # register, longest silence [s]
        self._fed = self.time
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._on_program_end: list[Callable[[], None]] = []
        self._speeds = np.zeros(6)
        self._resets = plant.resets
        self.motion_due = 0.0  # program time at which the last servoj or speedj ends
        self._motion_used, self._unused_for = False, 0
        # Sensor bias: a real force sensor does not read zero without contact.
        self._force_offset = np.random.default_rng(crc32(serial.encode())).normal(0.0, FORCE_OFFSET)

    # --- time ---
    def before_step(self) -> None:
        """Execute one control step of the program and the motion on the emulated UR robot, and send the joint
        targets to the simulated arm.
        """
        self.time += self.period
        if self.plant.resets != self._resets:
            self._follow_reset()
        for due, act in [x for x in self._later if x[0] <= self.time]:
            self._later.remove((due, act))
            act()
        self._feed_watchdog()
        wanted = 0.0 if self.runtime in (RuntimeState.PAUSING, RuntimeState.PAUSED) else self.slider
        step = self.period / RAMP
        self.scaling += min(max(wanted - self.scaling, -step), step)
        if self.runtime is RuntimeState.PAUSING and self.scaling <= 0.0:
            self.runtime = RuntimeState.PAUSED
        elif self.runtime is RuntimeState.RESUMING:
            self.runtime = RuntimeState.PLAYING
        self._motion_used = False
        running = self.runtime in (RuntimeState.PLAYING, RuntimeState.PAUSING)
        if running and self.machine is not None:
            try:
                self.machine.step()
            except (ProgramError, MotionFault, ScriptError) as error:
                self.report_program_error(
                    error if hasattr(error, "line") else ProgramError(str(error), self.machine.line)
                )
                self.end_program()
            if self.machine is not None and not self.machine.running:
                self.end_program()
        before = self.setpoint.v
        self._move()
        self.target_qdd = (self.setpoint.v - before) / self.period

    def _move(self) -> None:
        s = self.setpoint
        if self.mode is not RobotMode.RUNNING:
            s.q, s.v = self.plant.read()[0].copy(), np.zeros(6)
            return
        dt = self._choose_motion()
        if self.motion is None and self.compliance is None:
            s.v = np.zeros(6)
            return
        self.program_time += dt
        before = s.q
        try:
            s.q, s.v = self._targets(dt)
        except (MotionFault, np.linalg.LinAlgError) as error:
            self.motion = None
            self.protective_stop(str(error))
            return
        if np.abs(s.q).max() > self.model.max_position + np.deg2rad(3):
            s.q, s.v = before, np.zeros(6)
            self.protective_stop("joint limit")
        motion = self.motion
        if motion is not None and motion.done:
            self.motion = None
            s.v = np.zeros(6) if self.compliance is None else s.v
        speed = s.v * (1.0 if isinstance(motion, StopJ) else self.scaling)
        self.plant.command(s.q, speed, self.period)
        self._expire_motion(motion)

    def _choose_motion(self) -> float:
        """Choose the motion of the emulated UR robot, which is a stop if the robot must not move. Return the
        time step [s] of the motion: the control period, scaled by the speed slider unless the motion is a
        stop.
        """
        dt, s = self.period * self.scaling, self.setpoint
        if self.safety not in MAY_MOVE:
            self.start_compliance(None)
            if not isinstance(self.motion, StopJ):
                self.motion = StopJ(STOP_DECELERATION)
        elif self.motion is None and self.compliance is None and np.any(s.v):
            self.motion = StopJ(8.0)
        return self.period if isinstance(self.motion, StopJ) else dt  # the slider does not slow a stop

    def _targets(self, dt: float) -> tuple[Array, Array]:
        """Return the joint targets of the emulated UR robot after a step: positions and speeds, each (6,)."""
        s = self.setpoint
        q, v = (s.q, np.zeros(6)) if self.motion is None else self.motion.step(s, dt)
        if self.compliance is None:
            return q, v
        by_hand = self.compliance.freedrive
        return self.compliance.apply(s, q, self.external_wrench(), self.period if by_hand else max(dt, 1e-9))

    def _expire_motion(self, motion: Motion | None) -> None:
        """End a motion of the emulated UR robot that its program must command again and again, such as servoj
        or speedj, after the program has stopped doing so.
        """
        if self.runtime in (RuntimeState.PLAYING, RuntimeState.PAUSING) or self.machine is None:
            self._unused_for = 0 if self._motion_used else self._unused_for + 1
        unused = not self._motion_used and self.scaling > 0
        if isinstance(motion, TrackL) and unused:
            motion.settle()
        patience = 2 / max(self.scaling, 0.01) + 2
        if isinstance(motion, KEPT) and unused and (self.machine is None or self._unused_for > patience):
            self.motion = StopJ(8.0)

    def after_step(self) -> None:
        """Update the state of the emulated UR robot from the simulated arm, after each simulation step."""
        q, speeds, _ = self.plant.read()
        self.actual_qdd, self._speeds = (speeds - self._speeds) / self.period, np.array(speeds)
        detecting = self.time < self.detecting
        self.history.append((q.copy(), self.force() if detecting else np.zeros(3)))
        feels = self.compliance is not None or detecting
        touched = self.plant.contact(hand=not feels)
        if touched is not None and self.safety in MAY_MOVE and self.mode is RobotMode.RUNNING:
            self.protective_stop(touched)
        _, holds = self.plant.gripper()
        self.digital_in = (self.digital_in & ~(1 << TOOL_INPUT_HOLDS)) | (int(holds) << TOOL_INPUT_HOLDS)

    def _follow_reset(self) -> None:
        """End the program and the motion of the emulated UR robot after a reset of the simulated arm, and
        continue at rest from the new joint positions.
        """
        self._resets = self.plant.resets
        self.end_program()
        self.unlock()
        self.motion, self.hand = None, np.zeros(3)
        self.setpoint.q, self.setpoint.v = self.plant.read()[0].copy(), np.zeros(6)
        self.history.clear()
        self.popup("the arm and its world are back at their start")

    def start(self, motion: Motion) -> None:
        """Start a motion that a program on the emulated UR robot requests."""
        if self.mode is not RobotMode.RUNNING:
            raise ProgramError("the robot is not running (power on, brake release)")
        self.motion, self._motion_used = motion, True

    def mark_motion_in_use(self) -> None:
        """Mark the motion of the emulated UR robot as in use, because the program still waits for its end."""
        self._motion_used = True

    def start_compliance(self, compliance: Compliance | None) -> None:
        """Start the compliant mode of the emulated UR robot, in which forces move the tool.
        None ends the mode.

        Raises:
            ProgramError: the robot is not running.
        """
        if compliance is not None and self.mode is not RobotMode.RUNNING:
            raise ProgramError("the robot is not running (power on, brake release)")
        self.compliance, self.setpoint.compliant = compliance, compliance is not None

    # --- program ---
    @property
    def can_run_program(self) -> bool:
        """Return whether the emulated UR robot can start a program: the robot must be running, and its safety
        state must permit motion.
        """
        return self.mode is RobotMode.RUNNING and self.safety in MAY_MOVE

    def run(self, machine: Machine) -> None:
        """End the program that runs on the emulated UR robot, and start another URScript program."""
        self.end_program()
        if not self.can_run_program:
            self.popup(f"program not started: {self.mode.name}, {self.safety.name}")
            return
        self.machine, self.program_name = machine, machine.name
        self.runtime = RuntimeState.PLAYING
        self.announce(ProgramState(True, machine.name))

    def run_secondary(self, machine: Machine) -> None:
        """Run a secondary program on the emulated UR robot to its end,
        while the main program keeps running.
        """
        try:
            machine.step()
        except (ProgramError, MotionFault) as error:
            self.report_program_error(
                error if hasattr(error, "line") else ProgramError(str(error), machine.line)
            )

    def on_program_end(self, act: Callable[[], None]) -> None:
        self._on_program_end.append(act)

    def end_program(self) -> None:
        acts, self._on_program_end = self._on_program_end, []
        for act in acts:
            act()
        ended, self.machine = self.machine, None
        self.runtime, self._watchdog = RuntimeState.STOPPED, None
        self.start_compliance(None)
        if ended is not None:
            self.announce(ProgramState(False, ended.name))
        if self.motion is not None and not isinstance(self.motion, StopJ):
            self.motion = StopJ(8.0)

    def pause(self) -> bool:
        if self.runtime is not RuntimeState.PLAYING:
            return False
        self.runtime = RuntimeState.PAUSING
        return True

    def play(self) -> bool:
        """Resume the paused program of the emulated UR robot.
        Return False if no program is paused or safety forbids it.
        """
        if self.runtime not in (RuntimeState.PAUSED, RuntimeState.PAUSING) or self.safety not in MAY_MOVE:
            return False
        self.runtime = RuntimeState.RESUMING
        return True

    def announce(self, notice: Notice) -> None:
        """Log an event of the emulated UR robot, and pass the event to all listeners of the robot."""
        log.info("%s: %s", self.serial, notice)
        if not isinstance(notice, ProgramState | SafetyChange):
            self.messages.append(str(notice))
        for listener in self.listeners:
            listener(notice)

    def popup(self, text: str, title: str = "Popup", warning: bool = False, error: bool = False) -> None:
        self.announce(Popup(text, title, warning, error))

    def textmsg(self, text: str) -> None:
        self.announce(TextMessage(text))

    def report_program_error(self, error: ArmcellError) -> None:
        """Report why a program on the emulated UR robot ends or does not start."""
        line, column = getattr(error, "line", 0), getattr(error, "column", 0)
        code = getattr(error, "code", "") or str(error)
        self.announce(ScriptFault(f"script error: {error}", max(line, 1), max(column, 1), code))

    # --- safety and power ---
    @property
    def safety(self) -> SafetyMode:
        return self._safety

    @safety.setter
    def safety(self, mode: SafetyMode) -> None:
        changed, self._safety = mode is not self._safety, mode
        if changed:
            self.announce(SafetyChange(mode))

    def protective_stop(self, cause: str) -> None:
        if self.safety in MAY_MOVE:
            self.popup(f"protective stop: {cause}")
            self._stop(SafetyMode.PROTECTIVE_STOP)

    def safeguard_stop(self, on: bool) -> None:
        if on and self.safety in MAY_MOVE:
            self._stop(SafetyMode.SAFEGUARD_STOP)
        elif not on and self.safety is SafetyMode.SAFEGUARD_STOP:
            self.safety = SafetyMode.NORMAL

    def _stop(self, mode: SafetyMode) -> None:
        self.safety = mode
        if self.machine is not None:
            self.runtime = RuntimeState.PAUSED

    def emergency_stop(self, on: bool) -> None:
        if on:
            self.safety = SafetyMode.ROBOT_EMERGENCY_STOP
            self.end_program()
            self._later.append((self.time + 0.3, self.power_off))  # at rest by then
        elif self.safety is SafetyMode.ROBOT_EMERGENCY_STOP:
            self.safety = SafetyMode.NORMAL

    def unlock(self) -> None:
        """Clear the protective stop of the emulated UR robot. The robot program stays paused."""
        if self.safety is SafetyMode.PROTECTIVE_STOP:
            self.safety, self.motion = SafetyMode.NORMAL, None

    def power_off(self) -> None:
        self.end_program()
        self.mode, self.motion = RobotMode.POWER_OFF, None

    def power_on(self) -> None:
        if self.mode is RobotMode.POWER_OFF and self.safety in MAY_MOVE:
            self.mode = RobotMode.POWER_ON
            self._enter_mode(RobotMode.IDLE, POWER_ON_TIME)

    def release_brakes(self) -> None:
        if self.safety in MAY_MOVE:
            self.power_on()
            self._enter_mode(
                RobotMode.RUNNING, BRAKE_TIME + (POWER_ON_TIME if self.mode < RobotMode.IDLE else 0.0)
            )

    def _enter_mode(self, mode: RobotMode, seconds: float) -> None:
        def change() -> None:
            if self.mode is not RobotMode.POWER_OFF and self.safety in MAY_MOVE:
                self.mode = mode

        self._later.append((self.time + seconds, change))

    def displace(self, q: ArrayLike) -> None:
        """Move the emulated UR robot to other joint positions at once,
        as if a person had moved it by hand.
        """
        self.plant.displace(q)
        self.setpoint.q, self.setpoint.v = np.array(q, dtype=float), np.zeros(6)
        self.motion = None

    # --- inputs and outputs ---
    def set_inputs(self, values: dict[str, Any]) -> None:
        """Apply the input values that a client has sent to the emulated UR robot: registers, outputs and
        speed slider.
        """
        self.inputs.update(values)
        if self._watchdog is not None and f"input_int_register_{self._watchdog[0]}" in values:
            self._fed = self.time
        masked = values.get
        if masked("speed_slider_mask"):
            self.slider = float(np.clip(self.inputs.get("speed_slider_fraction", self.slider), 0.0, 1.0))
        for name, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
            mask = masked(f"{name}_digital_output_mask", 0)
            for bit in range(8):
                if mask >> bit & 1:
                    self.set_digital_out(shift + bit, bool(values[f"{name}_digital_output"] >> bit & 1))
        for i in (0, 1):
            if masked("standard_analog_output_mask", 0) >> i & 1:
                self.analog_out[i] = float(self.inputs.get(f"standard_analog_output_{i}", 0.0))
                volts = int(self.inputs.get("standard_analog_output_type", 0)) >> i & 1
                self.set_analog_domain(i, bool(volts))

    def set_analog_domain(self, i: int, volts: bool) -> None:
        self.analog_volts = (self.analog_volts & ~(1 << i)) | (int(volts) << i)

    def analog_output(self, i: int) -> float:
        """Return an analog output of the emulated UR robot,
        0 to 10 V or 4 to 20 mA, depending on its domain.
        """
        ratio = float(np.clip(self.analog_out[i], 0.0, 1.0))
        return 10.0 * ratio if self.analog_volts >> i & 1 else 4.0 + 16.0 * ratio

    def set_digital_out(self, bit: int, on: bool) -> None:
        if bit == TOOL_OUTPUT_CLOSE and on != bool(self.digital_out >> bit & 1):
            self.plant.drive_gripper(0.0 if on else 1.0, TOOL_GRIP_FORCE)
        self.digital_out = (self.digital_out & ~(1 << bit)) | (int(on) << bit)

    def set_watchdog(self, register: int, min_frequency: float) -> None:
        self._watchdog = (register, 1.0 / min_frequency) if min_frequency > 0 else None
        self._fed = self.time

    def _feed_watchdog(self) -> None:
        if self._watchdog is not None and self.time - self._fed > self._watchdog[1]:
            self._watchdog = None
            self.popup("RTDE watchdog: no data; program stopped")
            self.end_program()

    # --- measurements for clients ---
    def tcp_pose(self, q: Array) -> list[float]:
        return pose_of(forward(self.dh, q, self.setpoint.tcp))

    def tcp_speed(self, q: Array, v: Array) -> Array:
        return jacobian(self.dh, q, forward(self.dh, q, self.setpoint.tcp)[:3, 3]) @ v

    def force(self) -> Array:
        """Return the external force (3,) [N] on the tool of the emulated UR robot, in the base frame."""
        return self.plant.wrench()[0] + self.hand

    def external_wrench(self) -> Array:
        """Return the external force [N] and torque [Nm] (6,) on the tool
        of the emulated UR robot, in the base frame.
        """
        return self._wrench_about(self.setpoint.tcp)

    def _wrench_about(self, tcp: list[float]) -> Array:
        force, torque, at = self.plant.wrench()
        if not (force.any() or torque.any() or self.hand.any()):
            return np.zeros(6)
        point = forward(self.dh, self.plant.read()[0], tcp)[:3, 3]
        hand_at = forward(self.dh, self.plant.read()[0], self.setpoint.tcp)[:3, 3]
        torque = torque + cross(at - point, force) + cross(hand_at - point, self.hand)
        return np.concatenate([force + self.hand, torque])

    def tcp_force(self) -> Array:
        """Return the force [N] and torque [Nm] (6,) that the emulated UR robot reports,
        along the axes of the base.

        The torque is about the TCP (CB3) or the flange (e-Series). The values contain the sensor's offset.
        If a program has enabled an external sensor, the values come from that sensor, rotated from flange to
        base axes.
        """
        if self.external_ft:
            outside = np.asarray(self.inputs.get("external_force_torque", (0.0,) * 6), dtype=float)
            R = forward(self.dh, self.plant.read()[0], [0.0] * 6)[:3, :3]
            return np.concatenate([R @ outside[:3], R @ outside[3:]])
        return (
            self._wrench_about([0.0] * 6 if self.model.e_series else self.setpoint.tcp) + self._force_offset
        )

    def zero_force(self) -> None:
        """Zero the force sensor of an emulated e-Series robot at its current reading. A CB3 has no sensor."""
        if self.model.e_series:
            self._force_offset = self._force_offset - self.tcp_force()

    @property
    def accepts_remote_commands(self) -> bool:
        """Return whether the emulated UR robot accepts remote commands.

        An e-Series accepts them in remote control, a CB3 always.
        """
        return self.remote or not self.model.e_series

    def control_line(self) -> int:
        """Return the number of the program line that currently moves the emulated UR robot,
        or 0 if no line moves it.
        """
        return self.machine.line if self.machine is not None and self.motion is not None else 0

    def status_bits(self) -> int:
        powered = self.mode >= RobotMode.POWER_ON
        return int(powered) | int(self.runtime is RuntimeState.PLAYING) << 1
