"""One real arm: its state, its program, and what is wrong with it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.control.drivers.ur import program as commands
from armcell.control.drivers.ur.dashboard import DashboardClient
from armcell.control.drivers.ur.heart import Heart
from armcell.control.drivers.ur.identity import Identity
from armcell.control.drivers.ur.program import ProgramLink, ProgramSettings
from armcell.control.drivers.ur.rtde_client import RobotState, RtdeClient
from armcell.control.drivers.ur.settings import ArmSettings, RealSettings
from armcell.control.safety import Fault
from armcell.control.ur_wire.modes import MAY_MOVE, RobotMode, RuntimeState, SafetyMode
from armcell.core import InputError, JointTrajectory

Array = NDArray[np.float64]

INPUTS = (("speed_slider_mask", "speed_slider_fraction"),)
_CURES = {
    SafetyMode.PROTECTIVE_STOP: "look why, free the arm, then unlock it and resume",
    SafetyMode.SAFEGUARD_STOP: "close the fence, reset the safeguard, then resume",
}


class UrArm:
    """Connects, forwards, streams, stops. One per robot."""

    def __init__(
        self, name: str, joint_names: Sequence[str], settings: ArmSettings, limits: RealSettings,
        identity: Identity, heart: Heart, on_state: Callable[[], None],
    ):  # fmt: skip
        self.name, self.joint_names = name, tuple(joint_names)
        self.settings, self.identity = settings, identity
        self._limits, self._heart = limits, heart
        self.step = 1.0 / identity.model.frequency  # [s]
        self._rtde = RtdeClient(settings.host, identity.model.frequency, INPUTS, lambda _: on_state())
        self._link = ProgramLink(
            name, settings.host, settings.port, settings.own_host,
            ProgramSettings(limits.watchdog, limits.stop_deceleration),
        )  # fmt: skip
        self.armed = False  # the program runs and the supervisor minds it
        self._session = 0
        self._streamed = 0.0  # when a servo target was last sent
        self._beating = threading.Lock()

    # --- connection ---
    def connect(self) -> None:
        """State and program. The arm stays where it is.

        Raises:
            InputError: with the cause and the cure.
        """
        self._rtde.connect()
        self.start_program()

    def start_program(self) -> None:
        """(Re)start our program on the robot; the connection to its state is made anew if it is gone."""
        if self._rtde.error is not None:
            self._rtde.close()
            self._rtde = RtdeClient(self.settings.host, self.step**-1, INPUTS, self._rtde._on_state)
            self._rtde.connect()
        self._session = self._link.start()
        self.armed = True
        settings = self.settings
        if settings.payload is not None:
            self._link.send(commands.PAYLOAD, (settings.payload, *settings.payload_cog))
        if settings.tcp is not None:
            self._link.send(commands.TCP, settings.tcp)

    def close(self) -> None:
        """End the program and leave."""
        self.armed = False
        self._link.send(commands.END)
        end = time.monotonic() + 1.0
        while self._link.connected and time.monotonic() < end:
            time.sleep(0.005)  # its stop comes first
        self._link.close()
        self._rtde.close()

    # --- state ---
    @property
    def state(self) -> RobotState:
        assert self._rtde.latest is not None
        return self._rtde.latest

    @property
    def age(self) -> float:
        """Of the state [s]."""
        return self._rtde.age

    @property
    def q(self) -> Array:
        return np.array(self.state.actual_q)

    @property
    def qd(self) -> Array:
        return np.array(self.state.actual_qd)

    @property
    def scaling(self) -> float:
        """What slider and pause leave of the speed, 0 to 1."""
        return 0.0 if self.paused else float(self.state.speed_scaling)

    @property
    def paused(self) -> bool:
        return self.state.runtime_state in (RuntimeState.PAUSING, RuntimeState.PAUSED)

    @property
    def moving(self) -> bool:
        """Whether something is to move it now, or it moves."""
        streaming = time.monotonic() - self._streamed < 0.2
        return self._link.result == commands.RUNNING or streaming or bool(np.abs(self.qd).max() > 0.01)

    def fault(self) -> Fault | None:
        """What is wrong now; see `Supervised`."""
        if self._rtde.error is not None:
            return self._found(
                "link lost", f"the RTDE connection ended: {self._rtde.error}", "check the cable"
            )
        state, limits = self.state, self._limits
        safety, mode = state.safety_mode, state.robot_mode
        if safety not in tuple(MAY_MOVE):
            try:
                found = SafetyMode(safety)
            except ValueError:
                return self._found("safety", f"unknown safety mode {safety}", "see the pendant")
            kind = found.name.lower().replace("_", " ").replace("robot ", "").replace("system ", "")
            return self._found(kind, kind, _CURES.get(found, "see the pendant; power on, then resume"))
        if mode != RobotMode.RUNNING:
            names = {int(m): m.name for m in RobotMode}
            return self._found(
                "not running", f"robot mode {names.get(mode, mode)}", "power on, release brakes"
            )
        age = self.age
        longest = limits.max_state_age if self.moving else limits.max_silence
        if self.armed and age > longest and self._heart.awake:
            return self._found("stale state", f"its state is {age * 1000:.0f} ms old", "check the network")
        if self.armed and not self._link.connected:
            return self._found("program ended", "our program on the robot ended or its link broke", "resume")
        error = float(np.abs(np.subtract(state.target_q, state.actual_q)).max())
        if self.armed and error > limits.max_tracking_error:
            return self._found("tracking error", f"{error:.3f} rad from its target", "is it blocked?")
        return None

    def _found(self, kind: str, text: str, cure: str) -> Fault:
        return Fault(self.name, kind, text, cure)

    # --- motion ---
    def forward(self, trajectory: JointTrajectory) -> None:
        """Have the robot play a trajectory of its joints."""
        self._link.forward(commands.split(trajectory, self.joint_names), self.step)

    def clock(self) -> float:
        """How far along the forwarded trajectory the robot is [s]."""
        return float(self.state.output_double_register_24)

    @property
    def result(self) -> str:
        return self._link.result

    def cancel(self) -> None:
        self._link.send(commands.CANCEL)

    def servo(self, q: ArrayLike) -> None:
        """A target for now; to be sent again every period."""
        self._streamed = time.monotonic()
        self._link.send(commands.SERVO, np.asarray(q, dtype=float).tolist())

    def beat(self) -> None:
        """Tell the program that we are alive."""
        self._link.send(commands.KEEP_ALIVE)

    def halt(self) -> None:
        """End the program, which stops the arm; nothing goes on after it."""
        self.armed = False
        self._streamed = 0.0
        self._link.send(commands.END)
        threading.Thread(target=self._make_sure, name=f"halt {self.name}", daemon=True).start()

    def _make_sure(self) -> None:
        """A paused program cannot hear us: the dashboard ends it, so that nothing is left to go on."""
        time.sleep(0.3)
        if self.armed:
            return
        try:
            with DashboardClient(self.settings.host, timeout=1.0) as dashboard:
                dashboard.ask("stop")
        except Exception:
            pass  # not reachable: its own watchdog has stopped it
        if not self.armed:
            self._link.close_links()

    def prepare_resume(self) -> None:
        """What a resume needs first.

        Raises:
            InputError: the robot is not ready; says what to do.
        """
        fault = self.fault() if self._rtde.error is None else None
        if fault is not None and fault.kind not in ("program ended", "stale state"):
            raise InputError(f"cannot resume: {fault.arm}: {fault.text}", cure=fault.cure)

    def set_slider(self, fraction: float) -> None:
        """The pendant's speed slider, 0 to 1."""
        self._rtde.send(0, (1, float(np.clip(fraction, 0.0, 1.0))))

    def set_tool_output(self, pin: int, on: bool) -> None:
        self._link.send(commands.TOOL_OUT, (float(on),), pin)

    def set_digital_output(self, pin: int, on: bool) -> None:
        self._link.send(commands.STANDARD_OUT, (float(on),), pin)

    def digital_input(self, bit: int) -> bool:
        """Standard inputs are bits 0 to 7, configurable ones 8 to 15, the tool's 16 and 17."""
        return bool(self.state.actual_digital_input_bits >> bit & 1)
