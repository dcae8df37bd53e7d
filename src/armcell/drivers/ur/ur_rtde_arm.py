"""UR arm that the `ur_rtde` library moves, in one subprocess per arm because the library may crash."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armcell._interrupts import unsignaled
from armcell.core import InputError, JointTrajectory
from armcell.drivers.ur import program
from armcell.drivers.ur.arm import INPUTS, UrArm
from armcell.drivers.ur.program import CANCELLED, DONE, RUNNING, ProgramSettings

WORKER = Path(__file__).with_name("ur_rtde_worker.py")

STARTS_WITHIN = 20.0  # [s] to import ur_rtde, connect and upload its script

ENDS_WITHIN = 0.5  # [s] to wait for the subprocess to end before killing it


class UrRtdeConnection:
    """Connection that moves a UR arm with the library `ur_rtde`.
    It has the same interface as `ProgramConnection`.
    """

    def __init__(
        self, arm: str, robot: str, frequency: float, settings: ProgramSettings, scaling: Callable[[], float]
    ):
        self._arm, self._robot, self._frequency, self._settings = arm, robot, frequency, settings
        self._scaling = scaling
        self._process: subprocess.Popen | None = None
        self._socket: socket.socket | None = None
        self._sending = threading.Lock()
        self._session, self._number = 0, 0
        self._ready = threading.Event()
        self.result, self.clock = DONE, 0.0  # result and progress [s] of the last trajectory
        self.playing = 0  # number of the trajectory that the subprocess plays

    @property
    def connected(self) -> bool:
        return self._socket is not None

    def start(self) -> int:
        """Connect a UR arm through the library `ur_rtde`: start the subprocess that uploads the library's
        control script to the robot. Return the session number.

        Raises:
            InputError: ur_rtde cannot take control of the robot.
        """
        self.close_links()
        self._session += 1
        ours, its = socket.socketpair()
        numbers = (self._frequency, self._settings.watchdog, self._settings.stop_deceleration)
        command = [sys.executable, str(WORKER), str(its.fileno()), self._robot, *map(str, numbers)]
        with unsignaled():
            self._process = subprocess.Popen(
                command,
                pass_fds=(its.fileno(),),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
        its.close()
        self._ready.clear()
        self._socket = ours
        threading.Thread(target=self._receive, args=(ours,), name=f"ur_rtde {self._arm}", daemon=True).start()
        end = time.monotonic() + STARTS_WITHIN
        while not self._ready.wait(0.01):
            if self._socket is None or time.monotonic() > end:
                self._end_process()
                said = (self._process.stderr.read() if self._process.stderr else "").strip().splitlines()
                raise InputError(
                    f"arm {self._arm!r}: ur_rtde does not get hold of {self._robot} "
                    f"({said[-1] if said else 'it says nothing'})",
                    hint="look at the pendant; e-Series: remote control must be on",
                )
        threading.Thread(target=self._drain, args=(self._process.stderr,), daemon=True).start()
        return self._session

    def _drain(self, words: Iterable[str] | None) -> None:
        """Discard the errors that the `ur_rtde` subprocess of a UR arm prints, so that a full pipe cannot
        block it.
        """
        for _ in words or ():
            pass

    def _receive(self, link: socket.socket) -> None:
        try:
            with link.makefile("rb") as lines:
                for line in lines:
                    message = json.loads(line)
                    if "ready" in message:
                        self._ready.set()
                    elif message["number"] == self._number:
                        self.clock, self.playing, self.result = (
                            message["clock"],
                            message["number"],
                            message["result"],
                        )
        except (OSError, ValueError):
            pass
        if link is self._socket:
            self._forget()

    def _forget(self) -> None:
        self._socket = None
        if self.result == RUNNING:
            self.result = CANCELLED

    def _order(self, do: str, **more: Any) -> None:
        link = self._socket
        if link is None:
            return
        try:
            with self._sending:
                link.sendall(json.dumps({"do": do, **more}).encode() + b"\n")
        except OSError:
            self._forget()

    def send(self, kind: int, values: Sequence[float] = (), last: int = 0) -> None:
        """Send a command for a UR arm to its `ur_rtde` subprocess. Commands that set outputs are sent over
        RTDE instead.
        """
        plain = [float(v) for v in values]
        match kind:
            case program.KEEP_ALIVE:
                self._order("beat", scaling=self._scaling())
            case program.CANCEL:
                self._order("cancel")
            case program.PAYLOAD:
                self._order("payload", values=plain)
            case program.TCP:
                self._order("tcp", values=plain)
            case program.END:
                self._order("end")

    def servo(self, q: ArrayLike, v: ArrayLike, at: float) -> None:
        """Send a setpoint for a UR arm to its `ur_rtde` subprocess. The arm should pass it at the given
        monotonic time [s].

        All processes on this computer share the monotonic clock.
        """
        point = {"q": np.asarray(q, dtype=float).tolist(), "v": np.asarray(v, dtype=float).tolist()}
        self._order("point", at=at, **point)

    def forward(self, trajectory: JointTrajectory, step: float) -> int:
        """Start a trajectory of a UR arm in its `ur_rtde` subprocess, and return the number of the
        trajectory.
        """
        times = np.arange(0.0, trajectory.duration + step, step)
        first = float(trajectory.times[0])
        rows = [trajectory.sample(first + min(t, trajectory.duration))[0].tolist() for t in times]
        rows.append(rows[-1])
        self._number = self._number % 1000 + 1
        self.result, self.clock = RUNNING, 0.0
        self._order("trajectory", number=self._number, step=step, q=rows)
        return self._number

    def close_links(self) -> None:
        link, self._socket = self._socket, None
        if link is not None:
            link.close()
        self._forget()
        self._end_process()

    def _end_process(self) -> None:
        if self._process is None:
            return
        try:
            self._process.wait(ENDS_WITHIN)
        except subprocess.TimeoutExpired:
            self._process.kill()  # the robot's watchdog ends its script
            self._process.wait()

    def close(self) -> None:
        self.close_links()


SLIDER, TOOL, STANDARD = 0, 1, 2  # indices of the input recipes


class UrRtdeArm(UrArm):
    """UR arm whose state comes from armcell's RTDE client and whose motion is sent with servoJ of `ur_rtde`.

    `ur_rtde` runs in a subprocess.
    """

    inputs = (
        *INPUTS,
        ("tool_digital_output_mask", "tool_digital_output"),
        ("standard_digital_output_mask", "standard_digital_output"),
    )

    def _made_link(self, settings: ProgramSettings) -> UrRtdeConnection:
        # Every keep-alive signal carries the speed scaling of slider and pause.
        own = UrRtdeConnection(self.name, self.settings.host, 1.0 / self.step, settings, self._scaling_now)
        self._rtde_link = own
        return own

    def _scaling_now(self) -> float:
        return self.speed_scaling if self._rtde.latest is not None else 1.0

    def clock(self, number: int) -> float:
        link = self._rtde_link
        return link.clock if link.playing == number else 0.0

    def servo(self, q: ArrayLike, v: ArrayLike, at: float) -> None:
        self._mark_streamed()
        self._link.servo(q, np.asarray(v, dtype=float), at)

    def set_tool_output(self, pin: int, on: bool) -> None:
        self._set(TOOL, (1 << pin, int(on) << pin))

    def set_digital_output(self, pin: int, on: bool) -> None:
        self._set(STANDARD, (1 << pin, int(on) << pin))

    def _set(self, recipe: int, values: tuple[int, int]) -> None:
        try:
            self._rtde.send(recipe, values)
        except OSError as error:
            raise InputError(
                f"arm {self.name!r}: the link to {self.settings.host} is lost: no output is set ({error})",
                hint="check the cable and that the robot is on, then call resume()",
            ) from None
