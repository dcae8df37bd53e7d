"""Robot control: drivers, trajectory executor, safety supervisor, emulated UR controller."""

from armcell.control import drivers as _registered  # noqa: F401  (registers the drivers)
from armcell.control.driver import (
    ContactRecord,
    Driver,
    DriverOptions,
    GripperReading,
    ReportsModes,
    WeldRecord,
    drivers,
)
from armcell.control.drivers.ur.dashboard import DashboardClient
from armcell.control.executor import ExecutionSettings, execute, playing
from armcell.control.following import Follower, Steps
from armcell.control.gate import (
    CHANGED,
    NOT_STARTED,
    DriverWorld,
    Executable,
    GuardedMotion,
    MotionGate,
    UngatedMotion,
)
from armcell.control.safety import Fault, SafetyEvent, Supervisor
from armcell.control.ur_controller import ControllerSettings, Rack

__all__ = [
    "CHANGED",
    "NOT_STARTED",
    "ContactRecord",
    "ControllerSettings",
    "DashboardClient",
    "Driver",
    "DriverOptions",
    "DriverWorld",
    "Executable",
    "ExecutionSettings",
    "Fault",
    "Follower",
    "GripperReading",
    "GuardedMotion",
    "MotionGate",
    "Rack",
    "ReportsModes",
    "SafetyEvent",
    "Steps",
    "Supervisor",
    "UngatedMotion",
    "WeldRecord",
    "drivers",
    "execute",
    "playing",
]
