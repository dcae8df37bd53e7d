"""A complete robot kind without hardware: its "robot" is an object in this process.

It shows what a vendor's package contributes, and lets tests run mode `real` without an emulator.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass

import numpy as np

from armcell.core import InputError
from armcell.drivers import Fault
from armcell.drivers.motion_guard import ArmSample
from armcell.drivers.real import ArmSettings, NetworkReport, RealArm, RobotKind, check_serial_and_calibration
from armcell.drivers.real.arm import StreamedExecution

RUNNING, NORMAL, PROTECTIVE_STOP = 7, 1, 3  # in the numbers of ur_dashboard_msgs


class ToySettings(ArmSettings):
    joints: int = 7


class ToyRobot:
    """The robot at an address: it is where its last due setpoint put it."""

    def __init__(self, joints: int):
        self.joints, self.serial = joints, "toy 1"
        self.q, self.v = np.zeros(joints), np.zeros(joints)
        self.setpoints: deque[tuple[float, np.ndarray, np.ndarray]] = deque()
        self.slider, self.stopped = 1.0, False

    def update(self) -> None:
        while self.setpoints and self.setpoints[0][0] <= time.monotonic():
            _, self.q, self.v = self.setpoints.popleft()

    def hold(self) -> None:
        self.update()
        self.setpoints.clear()
        self.v = np.zeros(self.joints)


ROBOTS: dict[str, ToyRobot] = {}
"""The robots by address; a test puts them here as another would plug them in."""


@dataclass(frozen=True)
class ToyIdentity:
    host: str
    serial: str
    calibration: str = "nominal"

    def __str__(self) -> str:
        return f"toy, serial {self.serial}"


class ToyArm(RealArm):
    step = 0.008

    def __init__(self, name, joint_names, settings, limits, identity, on_state):
        self.name, self.joint_names, self.settings, self.identity = name, joint_names, settings, identity
        self._lead, self._on_state = limits.stream_lead, on_state

    @property
    def robot(self) -> ToyRobot:
        return ROBOTS[self.settings.host]

    # --- connection ---
    def connect(self):
        self.restart()

    def connect_gripper(self, gripper):
        return None

    def close(self):
        self.halt()

    def send_keep_alive(self):
        self._on_state()

    # --- state ---
    @property
    def time_of_state(self):
        return time.monotonic()

    def state_at(self, when):
        self.robot.update()
        return self.robot.q.copy(), self.robot.v.copy()

    def setpoint(self):
        return self.state_at(time.monotonic())

    def sample(self):
        q, v = self.state_at(time.monotonic())
        return ArmSample(q, v, np.zeros(len(q)), 0.0, self.robot.slider)

    @property
    def speed_scaling(self):
        return self.robot.slider

    def set_slider(self, fraction):
        self.robot.slider = fraction

    @property
    def modes(self):
        return RUNNING, PROTECTIVE_STOP if self.robot.stopped else NORMAL

    def external_wrench(self):
        return np.zeros(3), np.zeros(3), np.zeros(3)

    def zero_force(self):
        pass

    # --- faults ---
    def fault(self):
        if self.robot.stopped:
            return Fault(self.name, "protective stop", "protective stop", "unlock it")
        return None

    def halt(self):
        self.robot.hold()

    def check_resume(self):
        if self.robot.stopped:
            raise InputError(f"arm {self.name!r}: protective stop", hint="unlock it")

    def restart(self):
        self.robot.hold()

    # --- motion ---
    def follow(self, trajectory):
        return StreamedExecution([self], trajectory.reindexed(self.joint_names), self._lead, self.fault)

    def servo(self, q, v, at):
        self.robot.update()
        self.robot.setpoints.append((at, np.array(q), np.array(v)))

    def cancel(self):
        self.robot.hold()


class ToyKind(RobotKind[ToySettings, ToyIdentity]):
    arm_settings = ToySettings
    joints = 7
    gripper_hint = "toys have no gripper"

    def identify(self, arm):
        if arm.host not in ROBOTS:
            raise InputError(f"no toy answers at {arm.host}", hint="plug it in")
        return ToyIdentity(arm.host, ROBOTS[arm.host].serial)

    def check_identity(self, name, arm, found):
        check_serial_and_calibration(name, arm, found)

    def check_ready(self, name, found):
        if ROBOTS[found.host].stopped:
            raise InputError(f"arm {name!r}: the toy at {found.host} is stopped", hint="unlock it")

    def calibrated(self, model, group, found):
        return model  # each toy is as its model says

    def make_arm(self, name, joint_names, arm, limits, found, on_state):
        return ToyArm(name, joint_names, arm, limits, found, on_state)

    def measure_network(self, arm):
        return NetworkReport(0.001, 0.001, 0.008, 0.008, 125.0)

    def power_on(self, name, arm):
        return "was on"

    def measured_positions(self, arm):
        return ROBOTS[arm.host].q.copy()

    def flange_position(self, found, q):
        raise InputError("a toy does not know where its flange is")
