"""Mode `real`: one driver for real arms of any kind, and the interface of robot kinds."""

from armcell.drivers.real.arm import RealArm, RealGripper
from armcell.drivers.real.driver import RealDriver
from armcell.drivers.real.identity import NetworkReport, RobotIdentity, check_serial_and_calibration
from armcell.drivers.real.robot_kind import (
    BackendLibrary,
    RobotKind,
    identify_all,
    kind_of,
    real_settings,
    robot_kinds,
)
from armcell.drivers.real.settings import ArmSettings, RealSettings

__all__ = [
    "ArmSettings",
    "BackendLibrary",
    "NetworkReport",
    "RealArm",
    "RealDriver",
    "RealGripper",
    "RealSettings",
    "RobotIdentity",
    "RobotKind",
    "check_serial_and_calibration",
    "identify_all",
    "kind_of",
    "real_settings",
    "robot_kinds",
]
