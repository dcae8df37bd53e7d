"""One real UR arm: its state, its robot program and its faults."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell import _interrupts
from armcell.core import ArmcellError, InputError, JointTrajectory
from armcell.drivers.execution_handle import RUNNING, ExecutionHandle
from armcell.drivers.motion_guard import ArmSample
from armcell.drivers.real import RealArm, RealGripper, RealSettings
from armcell.drivers.safety import Fault
from armcell.drivers.ur import program as commands
from armcell.drivers.ur.calibration import HALF_TURN
from armcell.drivers.ur.dashboard import DashboardClient
from armcell.drivers.ur.gripper import SocketGripper, ToolGripper
from armcell.drivers.ur.identity import Pinger, UrIdentity, check_ready, identify
from armcell.drivers.ur.program import ProgramConnection, ProgramSettings
from armcell.drivers.ur.rtde_client import RobotState, RtdeClient
from armcell.drivers.ur.settings import UrArmSettings
from armcell.drivers.ur.wire.kinematics import forward
from armcell.drivers.ur.wire.modes import MAY_MOVE, RobotMode, RuntimeState, SafetyMode
from armcell.model import Gripper

Array = NDArray[np.float64]

HALTED_WITHIN = 3.0  # [s] time limit for a halt to reach the robot
NEXT_STATE = 0.03  # [s] in which at least two states arrive; 125 Hz controllers send one every 8 ms
FRESH_WITHIN = 0.5  # [s] time limit for a state from after a resume was called
MENDED_BY_RESUME = ("program ended", "stale state")
FARTHEST = 0.3  # [s] largest time from the last state to a streamed setpoint
INPUTS = (("speed_slider_mask", "speed_slider_fraction"),)
_RELEASE = "release the emergency stop button, then power on and release the brakes"
_CURES = {
    SafetyMode.PROTECTIVE_STOP: "look why, free the arm, then unlock it at the pendant",
    SafetyMode.SAFEGUARD_STOP: "close the fence, reset the safeguard",
    SafetyMode.ROBOT_EMERGENCY_STOP: _RELEASE,
    SafetyMode.SYSTEM_EMERGENCY_STOP: _RELEASE,
}


class MotionConnection(Protocol):
    """Interface of the connection over which a real UR arm is moved. `ProgramConnection` and
    `UrRtdeConnection` implement it.
    """

    result: str

    @property
    def connected(self) -> bool: ...
    def start(self) -> int: ...
    def send(self, kind: int, values: Sequence[float] = (), last: int = 0) -> None: ...
    def servo(self, q: ArrayLike, v: ArrayLike, at: float) -> None: ...
    def forward(self, trajectory: JointTrajectory, step: float) -> int: ...
    def close_links(self) -> None: ...
    def close(self) -> None: ...


class UrArm(RealArm):
    """Real UR arm, which connects to the robot, forwards trajectories, streams setpoints and stops."""

    T_link_base = HALF_TURN
    identity: UrIdentity
    inputs: tuple[tuple[str, ...], ...] = INPUTS  # names of the RTDE inputs, by recipe

    def __init__(
        self, name: str, joint_names: Sequence[str], settings: UrArmSettings, limits: RealSettings,
        identity: UrIdentity, on_state: Callable[[], None],
    ):  # fmt: skip
        self.name, self.joint_names = name, tuple(joint_names)
        self.settings, self.identity = settings, identity
        self._limits = limits
        self.step = 1.0 / identity.model.frequency  # [s]
        self._rtde = RtdeClient(settings.host, identity.model.frequency, self.inputs, lambda _: on_state())
        self._broken_at: float | None = None  # [s, monotonic] when the program's link was found broken
        self._link = self._made_link(ProgramSettings(limits.watchdog, limits.stop_deceleration))
        self.armed = False  # the program runs under supervision
        self._session = 0
        self._streamed = 0.0  # monotonic time of the last streamed setpoint
        self._no_force = np.zeros(6)
        self._halting: threading.Thread | None = None
        self._unsent_slider: float | None = None  # requested while the link was lost
        self._pinger: Pinger | None = None

    def _made_link(self, settings: ProgramSettings) -> MotionConnection:
        own = self.settings
        return ProgramConnection(self.name, own.host, own.port, own.own_host, settings)

    # --- connection ---
    def connect(self) -> None:
        """Connect to the state interface (RTDE) of the UR arm, and start the robot program.
        The arm does not move.

        Raises:
            InputError: the connection failed; the message states the cause and the remedy.
        """
        self._rtde.connect()
        self.restart()

    def restart(self) -> None:
        """Start or restart the robot program of the UR arm.
        If the connection that reports its state is lost, reconnect.

        Raises:
            InputError: the program did not start, and the arm stays stopped; the message states the remedy.
        """
        if self._rtde.error is not None:
            self._rtde.close()
            fresh = RtdeClient(self.settings.host, self.step**-1, self.inputs, self._rtde._on_state)
            try:
                fresh.connect()
            except BaseException:
                fresh.close()
                raise
            self._rtde = fresh  # replaced only once it has a state: until then the old one reports the error
        self._session = self._link.start()
        end = time.monotonic() + 1.0
        while self.state.runtime_state == RuntimeState.STOPPED and time.monotonic() < end:
            time.sleep(0.005)  # the state that reports the running program is not here yet
        self.armed = True
        if self._unsent_slider is not None:
            self.set_slider(self._unsent_slider)
        settings = self.settings
        if settings.payload is not None:
            self._link.send(commands.PAYLOAD, (settings.payload, *settings.payload_cog))
        if settings.tcp is not None:
            self._link.send(commands.TCP, settings.tcp)

    def connect_gripper(self, gripper: Gripper) -> RealGripper | None:
        how = self.settings.gripper
        if how is None:
            return None
        if how.kind == "socket":
            return SocketGripper(self.settings.host, how.port, gripper)
        return ToolGripper(self, gripper)

    def start_round_trip_measurement(self) -> Callable[[], float]:
        self._pinger = Pinger(self.settings.host)
        self._pinger.start()
        return self._pinger.round_trip_time

    def close(self) -> None:
        """End the robot program of the UR arm, and close the connections to the robot."""
        if self._pinger is not None:
            self._pinger.close()
        self.armed = False
        self._link.send(commands.END)
        end = time.monotonic() + 1.0
        while self._link.connected and time.monotonic() < end:
            _interrupts.sleep(0.005)  # the program stops the arm before it closes the link
        self._link.close()
        self._rtde.close()

    # --- state ---
    @property
    def state(self) -> RobotState:
        latest = self._rtde.latest
        if latest is None:
            raise self._not_connected()
        return latest

    def _not_connected(self) -> InputError:
        return InputError(
            f"arm {self.name!r}: {self.settings.host} has sent no state: it is not connected",
            hint="connect the cell first: with cell.connect('real') as live: ...",
        )

    @property
    def state_age(self) -> float:
        """Return the age [s] of the latest state of the UR arm."""
        return self._rtde.state_age

    @property
    def q(self) -> Array:
        return np.array(self.state.actual_q)

    @property
    def qd(self) -> Array:
        return np.array(self.state.actual_qd)

    @property
    def speed_scaling(self) -> float:
        """Return the fraction of full speed (0 to 1) that the speed slider and pauses of the UR arm allow."""
        return 0.0 if self.paused else float(self.state.speed_scaling)

    def setpoint(self) -> tuple[Array, Array]:
        state = self.state
        return np.array(state.target_q), np.array(state.target_qd)

    def sample(self) -> ArmSample:
        state = self.state
        q, v, current = (np.array(state.values[k]) for k in ("actual_q", "actual_qd", "actual_current"))
        clock, fraction = float(state.output_double_register_24), float(state.target_speed_fraction)
        return ArmSample(q, v, current, clock, fraction)

    @property
    def paused(self) -> bool:
        return self.state.runtime_state in (RuntimeState.PAUSING, RuntimeState.PAUSED)

    @property
    def moving(self) -> bool:
        """Return whether the UR arm executes a motion, receives setpoints or still has joint speed."""
        streaming = time.monotonic() - self._streamed < 0.2
        return self._link.result == RUNNING or streaming or bool(np.abs(self.qd).max() > 0.01)

    @property
    def modes(self) -> tuple[int, int]:
        """Return the robot mode and safety mode of the UR arm from its latest state."""
        robot = RobotMode.DISCONNECTED if self._rtde.error is not None else self.state.robot_mode
        return int(robot), int(self.state.safety_mode)

    def fault(self) -> Fault | None:
        """Return the current fault of the UR arm for the safety supervisor, or None."""
        if self._rtde.error is not None:
            return self._found(
                "link lost",
                f"the link to {self.settings.host} is lost: {self._rtde.error}",
                "check the cable and that the robot is on",
            )
        state, limits = self.state, self._limits
        safety, mode = state.safety_mode, state.robot_mode
        if safety not in tuple(MAY_MOVE):
            try:
                found = SafetyMode(safety)
            except ValueError:
                return self._found("safety", f"unknown safety mode {safety}", "see the pendant")
            kind = found.name.lower().replace("_", " ").replace("robot ", "").replace("system ", "")
            return self._found(kind, kind, _CURES.get(found, "see the pendant, then power on"))
        if mode != RobotMode.RUNNING:
            names = {int(m): m.name for m in RobotMode}
            return self._found(
                "not running", f"robot mode {names.get(mode, mode)}", "power on, release brakes"
            )
        age = self.state_age
        moving = self.moving
        if self.armed and age > (limits.max_state_age if moving else limits.max_silence):
            return self._found("stale state", f"its state is {age * 1000:.0f} ms old", "check the network")
        # A delay of this process shorter than the watchdog does not stop the robot; a longer one does,
        # whatever state the robot last reported.
        blind = self._rtde.time_since_check
        if self.armed and blind > (limits.watchdog if moving else limits.max_silence):
            text = f"this computer was held up for {blind * 1000:.0f} ms"
            return self._found("stale state", text, "give it less to do, or priority: chrt -f 10 armcell ...")
        stopped = state.runtime_state == RuntimeState.STOPPED  # connections may outlive their program
        if self.armed and (stopped or self._link_is_broken()):
            return self._found(
                "program ended", "our program on the robot ended or its link broke", "call resume()"
            )
        error = float(np.abs(np.subtract(state.target_q, state.actual_q)).max())
        if self.armed and error > limits.max_tracking_error:
            return self._found("tracking error", f"{error:.3f} rad from its target", "is it blocked?")
        return None

    def _link_is_broken(self) -> bool:
        """Return whether the link to the UR arm's robot program has been
        broken for more than `NEXT_STATE` seconds.

        At least two robot states arrive within this time. A stop also ends the program, so the link may
        break before the state that contains the cause of the stop arrives.
        """
        now = time.monotonic()
        if self._link.connected:
            self._broken_at = None
            return False
        if self._broken_at is None:
            self._broken_at = now
        return now - self._broken_at > NEXT_STATE

    def _found(self, kind: str, text: str, hint: str) -> Fault:
        return Fault(self.name, kind, text, hint)

    # --- motion ---
    def follow(self, trajectory: JointTrajectory) -> ExecutionHandle:
        return UrExecution(self, trajectory)

    def forward(self, trajectory: JointTrajectory) -> int:
        """Forward a trajectory to the UR arm, which plays it itself. Return the number of the trajectory."""
        return self._link.forward(trajectory.reindexed(self.joint_names), self.step)

    def clock(self, number: int) -> float:
        """Return the progress [s] of the UR arm along a forwarded trajectory.
        It is 0 before the arm starts.
        """
        state = self.state
        return float(state.output_double_register_24) if state.output_int_register_26 == number else 0.0

    @property
    def result(self) -> str:
        return self._link.result

    def cancel(self) -> None:
        self._link.send(commands.CANCEL)

    def servo(self, q: ArrayLike, v: ArrayLike, at: float) -> None:
        """Stream a setpoint (joint positions and speeds) to the UR arm, which should pass it at a given time.

        Send a new setpoint every period. Setpoints with the same time keep several arms synchronized.

        Args:
            q: joint positions (6,) [rad].
            v: joint speeds (6,) [rad/s].
            at: time to reach `q` [s, this computer's monotonic clock].
        """
        self._mark_streamed()
        if self._rtde.last_two is None:
            raise self._not_connected()
        before, state = self._rtde.last_two
        runs = state.output_double_register_25 > before.output_double_register_25
        pace = self.speed_scaling if runs else 0.0  # rate of the program's clock, which slider and pause slow
        ahead = at - self._rtde.clock.offset - state.timestamp  # [s] on the robot's clock
        ahead = min(max(ahead, 0.0), FARTHEST)
        stamp = float(state.output_double_register_25) + pace * ahead
        fast = 1.0 / max(self.speed_scaling, 0.05)  # speeds refer to the slowed clock
        self._link.servo(q, np.asarray(v) * fast, stamp)

    def _mark_streamed(self) -> None:
        self._streamed = time.monotonic()

    @property
    def time_of_state(self) -> float:
        """Return the time of the UR arm's latest state [s, this computer's monotonic clock]."""
        return self.state.timestamp + self._rtde.clock.offset

    def state_at(self, when: float) -> tuple[Array, Array]:
        """Return the positions and speeds of the UR arm, each (6,),
        at a given time [s, this computer's clock].

        Values are interpolated between two states and clamped at the ends of the history.
        """
        stamp, after = when - self._rtde.clock.offset, self.state
        for state in reversed(list(self._rtde.history)):
            if state.timestamp <= stamp:
                span = after.timestamp - state.timestamp
                share = min((stamp - state.timestamp) / span, 1.0) if span > 0 else 0.0
                q0, q1 = np.array(state.actual_q), np.array(after.actual_q)
                v0, v1 = np.array(state.actual_qd), np.array(after.actual_qd)
                return q0 + share * (q1 - q0), v0 + share * (v1 - v0)
            after = state
        return np.array(after.actual_q), np.array(after.actual_qd)

    # --- force ---
    def zero_force(self) -> None:
        """Zero the force measurement of the UR arm: the mean of the latest
        readings is subtracted from all later readings.
        """
        self._no_force = np.mean([s.actual_TCP_force for s in list(self._rtde.history)], axis=0)

    def external_wrench(self) -> tuple[Array, Array, Array]:
        """Return the force [N] and torque [Nm] at the UR arm's tool,
        and the point [m] to which they refer, all in the base frame.

        A CB3 controller reports the wrench about the TCP and estimates it coarsely from motor currents; an
        e-Series reports it about the flange.
        """
        state = self.state
        felt = np.array(state.actual_TCP_force) - self._no_force
        tool = [0.0] * 6 if self.identity.model.e_series else state.tcp_offset
        point = forward(self.identity.geometry, state.actual_q, tool)[:3, 3]
        return felt[:3], felt[3:], point

    def send_keep_alive(self) -> None:
        """Send a keep-alive signal to the robot program of the UR arm."""
        self._link.send(commands.KEEP_ALIVE)

    def halt(self) -> None:
        """End the robot program of the UR arm, which stops the arm. No motion continues afterwards."""
        self.armed = False
        self._streamed = 0.0
        self._link.send(commands.END)
        halting = threading.Thread(target=self._stop_over_dashboard, name=f"halt {self.name}", daemon=True)
        halting.start()
        self._halting = halting  # assigned after the start, because other threads join it

    def _stop_over_dashboard(self) -> None:
        """Stop the robot program of the UR arm over the dashboard as well, in case the program receives no
        commands.

        A paused program receives no commands from its link.
        """
        _interrupts.sleep(0.3)
        if self.armed:
            return
        try:
            with DashboardClient(self.settings.host, timeout=1.0) as dashboard:
                dashboard.ask("stop")
        except Exception:
            pass  # not reachable: the program's watchdog has stopped the arm
        if not self.armed:
            self._link.close_links()

    def check_resume(self) -> None:
        """Check, before the UR arm resumes, that it is still the same arm and is allowed to move.

        Raises:
            InputError: the check failed; the message states the remedy.
        """
        if self._halting is not None:
            self._halting.join(HALTED_WITHIN)  # otherwise the halt could end the new program
        called = time.monotonic()  # older states do not show what the operator just did
        while self._rtde.error is None and self.time_of_state < called:
            if time.monotonic() > called + FRESH_WITHIN:
                break
            _interrupts.sleep(0.005)
        fault = self.fault() if self._rtde.error is None else None
        if fault is not None and fault.kind not in MENDED_BY_RESUME:
            raise InputError(f"arm {fault.arm!r}: {fault.text}", hint=fault.hint)
        try:
            found = identify(self.settings.host)
        except ArmcellError as error:
            raise InputError(
                f"arm {self.name!r}: the link to {self.settings.host} is lost: {error}",
                hint="check the cable and that the robot is on",
            ) from None
        if (found.serial, found.calibration) != (self.identity.serial, self.identity.calibration):
            raise InputError(
                f"arm {self.name!r}: another robot than before answers at {self.settings.host} "
                f"(serial {found.serial}, before {self.identity.serial})",
                hint="check cables and addresses, then start armcell again",
            )
        check_ready(self.name, found)

    def set_slider(self, fraction: float) -> None:
        """Set the speed slider of the UR arm, 0 to 1.
        If the connection is lost, the next resume sets the slider.
        """
        self._unsent_slider = value = float(np.clip(fraction, 0.0, 1.0))
        with contextlib.suppress(OSError):
            if self._rtde.error is None:
                self._rtde.send(0, (1, value))
                self._unsent_slider = None

    def set_tool_output(self, pin: int, on: bool) -> None:
        self._link.send(commands.TOOL_OUT, (float(on),), pin)

    def set_digital_output(self, pin: int, on: bool) -> None:
        self._link.send(commands.STANDARD_OUT, (float(on),), pin)

    def digital_input(self, bit: int) -> bool:
        """Return a digital input of the UR arm.
        Bits 0-7 are standard inputs, 8-15 configurable, and 16-17 at the tool.
        """
        return bool(self.state.actual_digital_input_bits >> bit & 1)


class UrExecution:
    """Handle of a trajectory that was forwarded to a UR arm, which plays the trajectory itself. The speed
    slider and pauses slow the progress.
    """

    def __init__(self, arm: UrArm, trajectory: JointTrajectory):
        self._arm = arm
        self._number = arm.forward(trajectory)

    def trajectory_time(self) -> float:
        return self._arm.clock(self._number)

    def state(self) -> str:
        return self._arm.result

    def paused(self) -> bool:
        return self._arm.speed_scaling <= 0.0

    def cancel(self) -> None:
        self._arm.cancel()
