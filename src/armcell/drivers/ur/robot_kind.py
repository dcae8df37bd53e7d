"""The robot kind `ur`: arms of Universal Robots."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from armcell import _interrupts
from armcell.core import InputError
from armcell.drivers.real import BackendLibrary, NetworkReport, RealSettings, RobotKind, robot_kinds
from armcell.drivers.real.arm import Array
from armcell.drivers.real.robot_kind import check_distinct
from armcell.drivers.ur.arm import UrArm
from armcell.drivers.ur.calibration import calibrated_model
from armcell.drivers.ur.dashboard import DashboardClient
from armcell.drivers.ur.identity import UrIdentity, check_identity, check_ready, identify, measure_network
from armcell.drivers.ur.rtde_client import RtdeClient
from armcell.drivers.ur.settings import FIRST_PORT, UrArmSettings
from armcell.drivers.ur.ur_rtde_arm import UrRtdeArm
from armcell.drivers.ur.wire.kinematics import frames_of
from armcell.drivers.ur.wire.models import ur_model
from armcell.model import RobotModel

POWER_TIME = 30.0  # [s] to power on and release the brakes


class UrKind(RobotKind[UrArmSettings, UrIdentity]):
    """Robot kind `ur` for arms of Universal Robots.
    Their state comes from RTDE, and a robot program or `ur_rtde` moves them.
    """

    arm_settings = UrArmSettings
    joints = 6
    backends = ("own", "ur_rtde")
    libraries: ClassVar = {
        "ur_rtde": BackendLibrary("ur_rtde", "rtde_control", "ur-rtde", "up to Python 3.12")
    }
    gripper_hint = "add 'gripper: {kind: socket}' or '{kind: tool_io}' to its arm under 'real: arms:'"

    def complete_settings(
        self, arms: Mapping[str, UrArmSettings], model: RobotModel
    ) -> dict[str, UrArmSettings]:
        for arm in arms.values():
            ur_model(arm.model)
        numbered = {
            name: arm.model_copy(update={"port": arm.port or FIRST_PORT + 10 * i})
            for i, (name, arm) in enumerate(arms.items())
        }
        check_distinct(numbered, "port", "port")
        return numbered

    def controller_description(self, backend: str) -> str:
        return "our program" if backend == "own" else backend

    # --- identity and readiness ---
    def identify(self, arm: UrArmSettings) -> UrIdentity:
        return identify(arm.host)

    def check_identity(self, name: str, arm: UrArmSettings, found: UrIdentity) -> None:
        check_identity(name, arm, found)

    def check_ready(self, name: str, found: UrIdentity) -> None:
        check_ready(name, found)

    def calibrated(self, model: RobotModel, group: str, found: UrIdentity) -> RobotModel:
        return calibrated_model(model, group, found.model.dh, found.geometry)

    def make_arm(
        self, name: str, joint_names: tuple[str, ...], arm: UrArmSettings, limits: RealSettings,
        found: UrIdentity, on_state: Callable[[], None],
    ) -> UrArm:  # fmt: skip
        made = UrRtdeArm if arm.backend == "ur_rtde" else UrArm
        return made(name, joint_names, arm, limits, found, on_state)

    # --- bring-up ---
    def measure_network(self, arm: UrArmSettings) -> NetworkReport:
        return measure_network(arm.host, identify(arm.host).model.frequency)

    def power_on(self, name: str, arm: UrArmSettings) -> str:
        found = identify(arm.host)
        if found.robot_mode == "RUNNING":
            check_ready(name, found)
            return "was on"
        try:
            check_ready(name, found)
        except InputError as error:
            if "not running" not in error.reason:
                raise
        with DashboardClient(arm.host) as dashboard:
            dashboard.ask("power on")
            end = time.monotonic() + POWER_TIME
            released = False
            while time.monotonic() < end:
                mode = dashboard.word("robotmode")
                if mode == "RUNNING":
                    return "on, brakes released"
                if mode == "IDLE" and not released:
                    dashboard.ask("brake release")
                    released = True
                _interrupts.sleep(0.2)
        raise InputError(f"{arm.host} is not running after {POWER_TIME:g} s", hint="look at the pendant")

    def measured_positions(self, arm: UrArmSettings) -> Array:
        client = RtdeClient(arm.host, 125.0)
        client.connect()
        try:
            if client.latest is None:
                raise InputError(f"{arm.host} sends no state", hint="look at the pendant")
            return np.array(client.latest.actual_q)
        finally:
            client.close()

    def flange_position(self, found: UrIdentity, q: Array) -> Array:
        return frames_of(found.geometry, q)[6, :3, 3] * (-1.0, -1.0, 1.0)  # base_link is turned by pi


robot_kinds.register("ur")(UrKind())
