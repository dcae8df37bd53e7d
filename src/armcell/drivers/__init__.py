"""Robot drivers: the Driver interface, drivers by mode (sim, fake, real), and the safety supervisor."""

from armcell.drivers import fake, sim, ur
from armcell.drivers.driver import (
    ContactRecord,
    Driver,
    DriverOptions,
    GripperReading,
    ReportsModes,
    WeldRecord,
    drivers,
)
from armcell.drivers.following import Follower, Following
from armcell.drivers.safety import Fault, SafetyEvent, Supervisor

__all__ = [
    "ContactRecord",
    "Driver",
    "DriverOptions",
    "Fault",
    "Follower",
    "Following",
    "GripperReading",
    "ReportsModes",
    "SafetyEvent",
    "Supervisor",
    "WeldRecord",
    "drivers",
    "fake",
    "sim",
    "ur",
]
