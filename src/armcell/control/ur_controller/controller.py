"""An emulated Universal Robots controller: one robot with all its ports; several may share one world."""

from __future__ import annotations

import logging
import selectors
import struct
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from armcell import _interrupts
from armcell.control.ur_controller.dashboard_server import PORT as DASHBOARD
from armcell.control.ur_controller.dashboard_server import DashboardServer
from armcell.control.ur_controller.external_control import ExternalControl, RemoteHost
from armcell.control.ur_controller.gripper_server import GripperServer
from armcell.control.ur_controller.network import Network
from armcell.control.ur_controller.plant import KinematicPlant, Plant
from armcell.control.ur_controller.robot import Robot
from armcell.control.ur_controller.rtde_server import RtdeServer
from armcell.control.ur_controller.script_server import PRIMARY, REALTIME, SECONDARY, ScriptServer
from armcell.control.ur_wire.models import UrModel, ur_model
from armcell.control.ur_wire.primary import Kinematics
from armcell.control.ur_wire.rtde import PORT as RTDE
from armcell.core import InputError
from armcell.core.checks import checked

log = logging.getLogger(__name__)

TRACE = struct.Struct("<B14d")
"""A line of a trace: which arm, monotonic and robot's time [s], actual and target positions (6,) [rad]."""

MAX_LAG = 1.0  # [s] behind the wall clock that is caught up; what is beyond is lost
HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)


@dataclass(frozen=True)
@checked()
class ControllerSettings:
    """One emulated controller."""

    model: str = "UR10"
    host: str = "127.0.0.2"
    serial: str = "20261122"
    calibration_seed: int | None = None  # None: nominal geometry
    start: tuple[float, ...] = HOME  # [rad]
    remote: bool = True
    powered: bool = True
    external_control: RemoteHost | None = None  # of the URCap; None: it is not installed


def factory_calibration(model: UrModel, seed: int | None) -> Kinematics:
    """A robot's own geometry: nominal, or off by what manufacturing leaves (about 1 mm, 1 mrad)."""
    if seed is None:
        return model.dh
    rng, n = np.random.default_rng(seed), model.dh
    shifted = [
        tuple(float(x + e) for x, e in zip(row, rng.normal(0.0, size, 6)))
        for row, size in ((n.theta, 1e-3), (n.a, 1e-3), (n.d, 5e-4), (n.alpha, 1e-3))
    ]
    return Kinematics(*shifted, checksums=tuple(int(x) for x in rng.integers(1, 2**32 - 1, 6)))


class UrController:
    """One controller: `before_step`, the plant's step, `after_step`, at its model's frequency."""

    def __init__(
        self, settings: ControllerSettings, selector: selectors.BaseSelector, plant: Plant | None = None
    ):
        model = ur_model(settings.model)
        self.settings = settings
        self.network = Network(selector)
        self.robot = Robot(
            model, plant or KinematicPlant(settings.start), settings.serial,
            factory_calibration(model, settings.calibration_seed),
        )  # fmt: skip
        self.robot.remote = settings.remote
        if not settings.powered:
            self.robot.power_off()
        host = settings.host
        try:
            self._rtde = RtdeServer(self.robot, self.network, host, RTDE)
            self._external = ExternalControl(self.robot, self.network, settings.external_control)
            self._dashboard = DashboardServer(self.robot, self.network, host, self._external, DASHBOARD)
            self._gripper = GripperServer(self.robot, self.network, host)
            self._script = ScriptServer(self.robot, self.network, host, (PRIMARY, SECONDARY, REALTIME))
        except BaseException:
            self.network.close()
            raise

    def step(self) -> None:
        """One control step of everything."""
        self._external.step()
        self.robot.before_step()
        self.robot.plant.step(self.robot.period)
        self.robot.after_step()
        self._rtde.send_outputs()
        self._script.send_state()
        self.network.flush()

    def close(self) -> None:
        self.network.close()


class Rack:
    """Controllers that run together in one thread, paced by the wall clock.

    All have the same control period; those behind physics share one world.

    Raises:
        InputError: controllers of different periods.
    """

    def __init__(
        self,
        settings: Sequence[ControllerSettings],
        plants: Sequence[Plant | None] = (),
        trace: BinaryIO | None = None,
    ):
        self._trace = trace
        self._selector = selectors.DefaultSelector()
        self.controllers: list[UrController] = []
        try:
            for i, each in enumerate(settings):
                plant = plants[i] if plants else None
                self.controllers.append(UrController(each, self._selector, plant))
        except BaseException:
            self.close()
            raise
        if len({c.robot.period for c in self.controllers}) != 1:
            self.close()
            raise InputError("controllers of one rack have the same control period")
        self.lost = 0.0  # [s] of wall time that could not be kept up with
        self._stop = threading.Event()
        self._opened = False

    def open(self) -> None:
        """Open the ports; whoever connects is served as soon as `run` goes on. `run` does this itself."""
        if not self._opened:
            self._opened = True
            for controller in self.controllers:
                controller.step()  # compiles, on the first run on a machine: not with clients who wait
            for controller in self.controllers:
                controller.network.open()

    def run(self) -> None:
        """Serve until `stop`. The controllers' cycles are not in step, as real ones' are not: each begins a
        part of a period after the one before.
        """
        self.open()
        turn, due = 0, time.monotonic()
        part = self.controllers[0].robot.period / len(self.controllers)
        while not self._stop.is_set():
            _interrupts.check()
            now = time.monotonic()
            if now >= due:
                controller = self.controllers[turn]
                controller.step()
                if self._trace is not None:
                    self._write(controller)
                turn, due = (turn + 1) % len(self.controllers), due + part
                if now - due > MAX_LAG:
                    self.lost += now - due
                    due = now
            wait = max(due - time.monotonic(), 0.0)
            frozen = any(c.network.faults.frozen for c in self.controllers)
            if frozen:  # unread data would wake the selector at once
                time.sleep(min(wait, 0.002))
            for key, _ in self._selector.select(0.0 if frozen else wait):
                key.data()

    def _write(self, controller: UrController) -> None:
        index, robot = self.controllers.index(controller), controller.robot
        values = (*robot.plant.read()[0], *robot.setpoint.q)
        self._trace.write(TRACE.pack(index, time.monotonic(), robot.time, *values))  # type: ignore[union-attr]

    def stop(self) -> None:
        self._stop.set()

    def close(self) -> None:
        for controller in self.controllers:
            controller.close()
        self._selector.close()

    def __enter__(self) -> Rack:
        self.open()
        self._thread = threading.Thread(target=self.run, name="ur-controller", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()
        self._thread.join(timeout=5.0)
        self.close()
