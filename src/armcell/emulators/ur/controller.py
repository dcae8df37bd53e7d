"""Emulated Universal Robots controllers with all network ports, and the emulated robot kind `ur`.

Several controllers may share a world.
"""

from __future__ import annotations

import selectors
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, BinaryIO
from zlib import crc32

import numpy as np

from armcell.core import InputError
from armcell.core.checks import checked
from armcell.drivers.ur.settings import UrArmSettings
from armcell.drivers.ur.wire.models import UrModel, ur_model
from armcell.drivers.ur.wire.primary import Kinematics
from armcell.drivers.ur.wire.rtde import PORT as RTDE
from armcell.emulators.network import Network
from armcell.emulators.rack import Rack, SharedWorld, emulated_kinds, selector
from armcell.emulators.ur.dashboard_server import DASHBOARD_PORT, DashboardServer, GripperServer
from armcell.emulators.ur.notices import Popup, ScriptFault
from armcell.emulators.ur.plant import KinematicPlant, PhysicsPlant, Plant
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.rtde_server import RtdeServer
from armcell.emulators.ur.script_server import ExternalControl, RemoteHost, ScriptServer

TRACE, _TRACE_RECORD = struct.Struct("<B14d"), struct.Struct("<14d")
"""Trace record: arm index, monotonic time and robot time [s], actual and target positions (6,) [rad]."""

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)


@dataclass(frozen=True)
@checked()
class ControllerSettings:
    """Settings of one emulated UR controller."""

    model: str = "UR10"
    host: str = "127.0.0.2"
    serial: str = "20261122"
    calibration_seed: int | None = None  # None: nominal geometry
    start: tuple[float, ...] = HOME  # [rad]
    remote: bool = True
    powered: bool = True
    external_control: RemoteHost | None = None  # remote host of the URCap; None: not installed
    software: str | None = None  # such as "3.4"; None: the newest


def factory_calibration(model: UrModel, seed: int | None, serial: str = "") -> Kinematics:
    """Return the geometry of the UR robot that a controller emulates: the nominal geometry, or one with
    random manufacturing errors.

    The tolerances are about 1 mm and 1 mrad.

    Args:
        seed: seed of the tolerances; None: the nominal geometry.
        serial: serial number, from which the nominal geometry's checksums are derived.
    """
    if seed is None:  # clients interpret a checksum of zero as "no calibration"
        checksums = tuple(crc32(f"{serial} {i}".encode()) for i in range(6))
        return replace(model.dh, checksums=checksums)
    rng, n = np.random.default_rng(seed), model.dh
    shifted = [
        tuple(float(x + e) for x, e in zip(row, rng.normal(0.0, size, 6)))
        for row, size in ((n.theta, 1e-3), (n.a, 1e-3), (n.d, 5e-4), (n.alpha, 1e-3))
    ]
    return Kinematics(*shifted, checksums=tuple(int(x) for x in rng.integers(1, 2**32 - 1, 6)))


class UrController:
    """Emulated UR controller with its robot and ports, which runs at the control frequency of its model."""

    def __init__(
        self, settings: ControllerSettings, selector: selectors.BaseSelector, plant: Plant | None = None
    ):
        model = ur_model(settings.model)
        model = model if settings.software is None else model.with_software(settings.software)
        self.settings = settings
        self.network = Network(selector)
        self.robot = Robot(
            model, plant or KinematicPlant(settings.start), settings.serial,
            factory_calibration(model, settings.calibration_seed, settings.serial),
        )  # fmt: skip
        self.period, self.answer_time = self.robot.period, 0.0
        self.robot.remote = settings.remote
        if not settings.powered:
            self.robot.power_off()
        host = settings.host
        try:
            self._rtde = RtdeServer(self.robot, self.network, host, RTDE)
            self._external = ExternalControl(self.robot, self.network, settings.external_control)
            self._gripper = GripperServer(self.robot, self.network, host)
            self._script = ScriptServer(self.robot, self.network, host)
            # Last: when the dashboard answers, all other ports are open.
            self._dashboard = DashboardServer(self.robot, self.network, host, self._external, DASHBOARD_PORT)
        except BaseException:
            self.network.close()
            raise

    @property
    def in_use(self) -> bool:
        """Return whether an RTDE client uses the emulated UR controller.
        A client that an injected fault has disconnected still counts.
        """
        return self._rtde.clients > 0 or self.network.faults.refusing or self.network.faults.frozen

    def step(self) -> None:
        """Run one control step of the emulated UR controller:
        the URScript program, the plant and the ports.
        """
        self._external.step()
        self.robot.before_step()
        self.robot.plant.step(self.robot.period)
        self.robot.after_step()
        self._rtde.send_outputs()
        self._script.send_state()
        self.network.flush()

    def reset(self) -> None:
        self.robot.plant.reset()

    def trace(self) -> bytes:
        values = (*self.robot.plant.read()[0], *self.robot.setpoint.q)
        return _TRACE_RECORD.pack(time.monotonic(), self.robot.time, *values)

    def close(self) -> None:
        self.network.close()


class UrRack(Rack[UrController]):
    """Several emulated UR controllers with all their ports, which run in one thread. All arms with simulated
    physics share one physics world.

    Args:
        trace: file for records in the format `TRACE`.
        reset_between_runs: reset arms and objects to their start once all RTDE clients have disconnected.
    Raises:
        InputError: the controllers have different control periods.
    """

    def __init__(
        self,
        settings: Sequence[ControllerSettings],
        plants: Sequence[Plant | None] = (),
        trace: BinaryIO | None = None,
        reset_between_runs: bool = False,
    ):
        super().__init__([], selector(), trace, reset_between_runs)
        try:
            for i, each in enumerate(settings):
                plant = plants[i] if plants else None
                self.controllers.append(UrController(each, self._selector, plant))
        except BaseException:
            self.close()
            raise
        if len({c.period for c in self.controllers}) != 1:
            self.close()
            raise InputError("controllers of one rack have the same control period")


class EmulatedUr:
    """Factory of the robot kind `ur`: it creates an emulated UR controller with all its ports for an arm in
    the cell's physics world.
    """

    physics: Mapping[str, Any] = {}

    def make(
        self, group: str, arm: UrArmSettings, shared: SharedWorld, io: selectors.BaseSelector,
        say: Callable[[str], None],
    ) -> UrController:  # fmt: skip
        serial = arm.serial or f"2026{crc32(group.encode()) % 10000:04d}"
        plant = PhysicsPlant(shared, group, arm.model)
        made = UrController(ControllerSettings(arm.model, arm.host, serial), io, plant)
        made.robot.listeners.append(lambda n: say(str(n)) if isinstance(n, Popup | ScriptFault) else None)
        return made


emulated_kinds.register("ur")(EmulatedUr())
