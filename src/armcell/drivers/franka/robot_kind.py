"""The robot kind `franka`: arms of Franka Robotics."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from armcell import _interrupts
from armcell.core import InputError
from armcell.drivers.franka.arm import FrankaArm
from armcell.drivers.franka.client import FciClient
from armcell.drivers.franka.identity import (
    FrankaIdentity,
    check_identity,
    check_load,
    check_ready,
    identify,
)
from armcell.drivers.franka.settings import FrankaArmSettings
from armcell.drivers.franka.wire.commands import REQUESTS, Command
from armcell.drivers.franka.wire.state import RobotMode
from armcell.drivers.real import BackendLibrary, NetworkReport, RealSettings, RobotKind, robot_kinds
from armcell.drivers.real.arm import Array
from armcell.model import RobotModel

STATES = 2000  # of a network measurement: two seconds
TRIPS = 50
QUESTIONS = {  # commands that change nothing; each protocol has one of them
    Command.GET_ROBOT_MODEL: b"",
    Command.GET_CARTESIAN_LIMIT: REQUESTS[Command.GET_CARTESIAN_LIMIT].pack(0),
}
OPERATOR_TIME = 60.0  # [s] in which the operator unlocks the brakes


class FrankaKind(RobotKind[FrankaArmSettings, FrankaIdentity]):
    """Robot kind `franka`: arms that are driven over the Franka
    Control Interface (FCI), protocols 5 and 10.
    """

    arm_settings = FrankaArmSettings
    joints = 7
    backends = ("own", "franky")
    libraries: ClassVar = {"franky": BackendLibrary("franky-control", "franky", "franka", "for Linux")}
    calibrates = False
    effort = "torque", "Nm"
    gripper_hint = "add 'gripper: {kind: hand}' to its arm under 'real: arms:'"

    def complete_settings(
        self, arms: Mapping[str, FrankaArmSettings], model: RobotModel
    ) -> dict[str, FrankaArmSettings]:
        for name, arm in arms.items():
            check_load(name, arm)
        return dict(arms)

    def controller_description(self, backend: str) -> str:
        return "armcell, at 1 kHz" if backend == "own" else backend

    def identify(self, arm: FrankaArmSettings) -> FrankaIdentity:
        return identify(arm.host)

    def check_identity(self, name: str, arm: FrankaArmSettings, found: FrankaIdentity) -> None:
        check_identity(name, arm, found)

    def check_ready(self, name: str, found: FrankaIdentity) -> None:
        check_ready(name, found)

    def calibrated(self, model: RobotModel, group: str, found: FrankaIdentity) -> RobotModel:
        raise InputError(
            f"arm {group!r}: a Franka robot reports no factory calibration of its geometry",
            hint="set 'real: {calibration: compare}'",
        )

    def make_arm(
        self, name: str, joint_names: tuple[str, ...], arm: FrankaArmSettings, limits: RealSettings,
        found: FrankaIdentity, on_state: Callable[[], None],
    ) -> FrankaArm:  # fmt: skip
        return FrankaArm(name, joint_names, arm, limits, found, on_state)

    # --- bring-up ---
    def measure_network(self, arm: FrankaArmSettings) -> NetworkReport:
        client = FciClient(arm.host)
        try:
            trips, arrivals = [], []
            question = next(c for c in QUESTIONS if c in client.protocol.commands)
            for _ in range(TRIPS):
                began = time.monotonic()
                client.ask(question, QUESTIONS[question])
                trips.append(time.monotonic() - began)
            client.states()
            for _ in range(STATES):
                client.first_state()
                arrivals.append(time.monotonic())
        finally:
            client.close()
        gaps = np.diff(arrivals)
        return NetworkReport(
            float(np.median(trips)), max(trips), float(np.median(gaps)), float(gaps.max()), 1000.0
        )

    def power_on(self, name: str, arm: FrankaArmSettings) -> str:
        end = time.monotonic() + OPERATOR_TIME
        found = identify(arm.host)
        was_on = found.state.mode != RobotMode.OTHER
        while found.state.mode == RobotMode.OTHER and time.monotonic() < end:
            _interrupts.sleep(1.0)  # Desk unlocks the brakes, not the control interface
            found = identify(arm.host)
        check_ready(name, found)
        return "was on" if was_on else "on, brakes unlocked in Desk"

    def measured_positions(self, arm: FrankaArmSettings) -> Array:
        return identify(arm.host).state["q"]

    def flange_position(self, found: FrankaIdentity, q: Array) -> Array:
        return _flange(q)


_DH = (  # a [m], d [m], alpha [rad] of the joints and the flange: Franka's documentation, Craig's convention
    (0.0, 0.333, 0.0), (0.0, 0.0, -np.pi / 2), (0.0, 0.316, np.pi / 2), (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2), (0.0, 0.0, np.pi / 2), (0.088, 0.0, np.pi / 2), (0.0, 0.107, 0.0),
)  # fmt: skip


def _flange(q: Array) -> Array:
    """Return the nominal flange position (3,) [m, base] at joint positions (7,) [rad] for arms of the robot
    kind `franka`.
    """
    T = np.eye(4)
    for (a, d, alpha), theta in zip(_DH, (*q, 0.0), strict=True):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ np.array(
            [
                [ct, -st, 0.0, a],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return T[:3, 3]


robot_kinds.register("franka")(FrankaKind())
