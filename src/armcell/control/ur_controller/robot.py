"""The emulated robot: modes, registers, inputs and outputs, and motion, a control step at a time."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.control.ur_controller.motion import Motion, MotionFault, ServoJ, Setpoint, SpeedJ, StopJ
from armcell.control.ur_controller.plant import Plant
from armcell.control.ur_controller.urscript import Machine, ProgramError, ScriptError
from armcell.control.ur_wire.kinematics import forward, jacobian, pose_of
from armcell.control.ur_wire.models import UrModel
from armcell.control.ur_wire.modes import MAY_MOVE, RobotMode, RuntimeState, SafetyMode
from armcell.control.ur_wire.primary import Kinematics

log = logging.getLogger(__name__)
Array = NDArray[np.float64]

RAMP = 0.2  # [s] in which the speed scaling goes from 1 to 0 at a pause, and back
STOP_DECELERATION = 25.0  # [rad/s^2] of a stop by the safety system
POWER_ON_TIME, BRAKE_TIME = 0.3, 0.3  # [s]; a real arm takes several seconds
TOOL_INPUT_HOLDS = 16  # digital input bit of the tool: the gripper holds something
TOOL_OUTPUT_CLOSE = 16  # digital output bit of the tool: close the gripper
TOOL_GRIP_FORCE = 0.3  # of the gripper's largest, where one output closes it
FORCE_OFFSET = (4.0, 4.0, 4.0, 0.4, 0.4, 0.4)  # [N, Nm] standard deviation over robots
MIN_UPTIME = 60.0  # [s]: UR's own client library wants a controller that has run for a while


class Robot:
    """State and behaviour of one arm with its controller. Knows no sockets."""

    def __init__(self, model: UrModel, plant: Plant, serial: str, kinematics: Kinematics | None = None):
        self.model, self.plant, self.serial = model, plant, serial
        self.dh = kinematics or model.dh
        self.period = 1.0 / model.frequency
        self.setpoint = Setpoint(model, self.dh, plant.read()[0])
        self.remote = True
        self.mode, self.safety = RobotMode.RUNNING, SafetyMode.NORMAL
        self.runtime, self.program_name = RuntimeState.STOPPED, ""
        self.time, self.program_time = MIN_UPTIME, 0.0
        self.slider, self.scaling = 1.0, 1.0
        self.inputs: dict[str, Any] = {}  # registers of clients
        self.output_int, self.output_double = [0] * 48, [0.0] * 48
        self.output_bits = 0  # boolean registers 0..63
        self.digital_in, self.digital_out = 0, 0
        self.analog_out = [0.0, 0.0]
        self.tool_voltage = 0
        self.payload, self.payload_cog = 0.0, [0.0, 0.0, 0.0]
        self.motion: Motion | None = None
        self.machine: Machine | None = None
        self.messages: list[str] = []
        self._watchdog: tuple[int, float] | None = None  # register, longest silence [s]
        self._fed = self.time
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._on_program_end: list[Callable[[], None]] = []
        self.motion_due = 0.0  # program time at which the last servoj or speedj ends
        self._motion_used, self._unused_for = False, 0
        # What the sensor shows of itself: no force sensor reads zero when nothing touches the tool.
        self._force_offset = np.random.default_rng(crc32(serial.encode())).normal(0.0, FORCE_OFFSET)

    # --- time ---
    def before_step(self) -> None:
        """Program and motion of one control step; afterwards the plant has its command."""
        self.time += self.period
        for due, act in [x for x in self._later if x[0] <= self.time]:
            self._later.remove((due, act))
            act()
        self._feed_watchdog()
        wanted = 0.0 if self.runtime in (RuntimeState.PAUSING, RuntimeState.PAUSED) else self.slider
        step = self.period / RAMP
        self.scaling += float(np.clip(wanted - self.scaling, -step, step))
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
                self.popup(f"runtime error: {error}")
                self.end_program()
            if self.machine is not None and not self.machine.running:
                self.end_program()
        self._move()

    def _move(self) -> None:
        s = self.setpoint
        if self.mode is not RobotMode.RUNNING:
            s.q, s.v = self.plant.read()[0].copy(), np.zeros(6)
            return
        motion, dt = self.motion, self.period * self.scaling
        stopping = self.safety not in MAY_MOVE
        if stopping and not isinstance(motion, StopJ):
            motion = self.motion = StopJ(STOP_DECELERATION)
        if isinstance(motion, StopJ):
            dt = self.period  # a stop is not slowed by the slider
        elif motion is None and np.any(s.v):
            motion = self.motion = StopJ(8.0)
        if motion is None:
            s.v = np.zeros(6)
            return
        self.program_time += dt
        before = s.q
        try:
            s.q, s.v = motion.step(s, dt)
        except (MotionFault, np.linalg.LinAlgError) as error:
            self.motion = None
            self.protective_stop(str(error))
            return
        if np.abs(s.q).max() > self.model.max_position + np.deg2rad(3):
            s.q, s.v = before, np.zeros(6)
            self.protective_stop("joint limit")
        if motion.done:
            self.motion = None
            s.v = np.zeros(6)
        speed = s.v * (1.0 if isinstance(motion, StopJ) else self.scaling)
        self.plant.command(s.q, speed, self.period)
        if self.runtime in (RuntimeState.PLAYING, RuntimeState.PAUSING) or self.machine is None:
            self._unused_for = 0 if self._motion_used else self._unused_for + 1
        lost = isinstance(motion, ServoJ | SpeedJ) and not self._motion_used and self.scaling > 0
        if lost and (self.machine is None or self._unused_for > 2 / max(self.scaling, 0.01) + 2):
            self.motion = StopJ(8.0)  # nobody keeps it going any more

    def after_step(self) -> None:
        """What the plant did is seen."""
        touched = self.plant.contact()
        if touched is not None and self.safety in MAY_MOVE and self.mode is RobotMode.RUNNING:
            self.protective_stop(touched)
        _, holds = self.plant.gripper()
        self.digital_in = (self.digital_in & ~(1 << TOOL_INPUT_HOLDS)) | (int(holds) << TOOL_INPUT_HOLDS)

    def start(self, motion: Motion) -> None:
        """A program asks for a motion."""
        if self.mode is not RobotMode.RUNNING:
            raise ProgramError("the robot is not running (power on, brake release)")
        self.motion, self._motion_used = motion, True

    def keep(self) -> None:
        """A program still waits for its servoj or speedj."""
        self._motion_used = True

    # --- program ---
    @property
    def may_run(self) -> bool:
        """Whether a program may start."""
        return self.mode is RobotMode.RUNNING and self.safety in MAY_MOVE

    def run(self, machine: Machine) -> None:
        """Start a program; the one that runs ends."""
        self.end_program()
        if not self.may_run:
            self.popup(f"program not started: {self.mode.name}, {self.safety.name}")
            return
        self.machine, self.program_name = machine, machine.name
        self.runtime = RuntimeState.PLAYING

    def on_program_end(self, act: Callable[[], None]) -> None:
        self._on_program_end.append(act)

    def end_program(self) -> None:
        acts, self._on_program_end = self._on_program_end, []
        for act in acts:
            act()
        self.machine, self.runtime, self._watchdog = None, RuntimeState.STOPPED, None
        if self.motion is not None and not isinstance(self.motion, StopJ):
            self.motion = StopJ(8.0)

    def pause(self) -> bool:
        if self.runtime is not RuntimeState.PLAYING:
            return False
        self.runtime = RuntimeState.PAUSING
        return True

    def play(self) -> bool:
        """Go on with a paused program."""
        if self.runtime not in (RuntimeState.PAUSED, RuntimeState.PAUSING) or self.safety not in MAY_MOVE:
            return False
        self.runtime = RuntimeState.RESUMING
        return True

    def popup(self, text: str) -> None:
        log.info("%s: %s", self.serial, text)
        self.messages.append(text)

    # --- safety and power ---
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
            self._later.append((self.time + 0.3, self.power_off))  # at rest by then: power goes
        elif self.safety is SafetyMode.ROBOT_EMERGENCY_STOP:
            self.safety = SafetyMode.NORMAL

    def unlock(self) -> None:
        """Unlock a protective stop. The program stays paused."""
        if self.safety is SafetyMode.PROTECTIVE_STOP:
            self.safety, self.motion = SafetyMode.NORMAL, None

    def power_off(self) -> None:
        self.end_program()
        self.mode, self.motion = RobotMode.POWER_OFF, None

    def power_on(self) -> None:
        if self.mode is RobotMode.POWER_OFF and self.safety in MAY_MOVE:
            self.mode = RobotMode.POWER_ON
            self._to(RobotMode.IDLE, POWER_ON_TIME)

    def release_brakes(self) -> None:
        if self.safety in MAY_MOVE:
            self.power_on()
            self._to(RobotMode.RUNNING, BRAKE_TIME + (POWER_ON_TIME if self.mode < RobotMode.IDLE else 0.0))

    def _to(self, mode: RobotMode, seconds: float) -> None:
        def change() -> None:
            if self.mode is not RobotMode.POWER_OFF and self.safety in MAY_MOVE:
                self.mode = mode

        self._later.append((self.time + seconds, change))

    def displace(self, q: ArrayLike) -> None:
        """Somebody moves the arm by hand."""
        self.plant.displace(q)
        self.setpoint.q, self.setpoint.v = np.array(q, dtype=float), np.zeros(6)
        self.motion = None

    # --- inputs and outputs ---
    def set_inputs(self, values: dict[str, Any]) -> None:
        """Values a client sent over RTDE."""
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

    # --- what clients see ---
    def tcp_pose(self, q: Array) -> list[float]:
        return pose_of(forward(self.dh, q, self.setpoint.tcp))

    def tcp_speed(self, q: Array, v: Array) -> Array:
        return jacobian(self.dh, q, forward(self.dh, q, self.setpoint.tcp)[:3, 3]) @ v

    def tcp_force(self) -> Array:
        """Force [N] over torque [Nm] (6,) on the tool by what touches it, in the base frame's axes.

        About the TCP of a CB3 and the flange of an e-Series, with the sensor's offset.
        """
        force, torque, at = self.plant.wrench()
        tcp = [0.0] * 6 if self.model.e_series else self.setpoint.tcp
        point = forward(self.dh, self.plant.read()[0], tcp)[:3, 3]
        return np.concatenate([force, torque + np.cross(at - point, force)]) + self._force_offset

    def zero_force(self) -> None:
        """An e-Series takes what its sensor shows now for zero; a CB3 has no such thing."""
        if self.model.e_series:
            self._force_offset = self._force_offset - self.tcp_force()

    @property
    def remote_or_cb3(self) -> bool:
        """Whether commands from outside are taken: a CB3 knows no local mode."""
        return self.remote or not self.model.e_series

    def status_bits(self) -> int:
        powered = self.mode >= RobotMode.POWER_ON
        return int(powered) | int(self.runtime is RuntimeState.PLAYING) << 1
