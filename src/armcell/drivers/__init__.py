"""Robot drivers: base class Driver, drivers by mode (sim, fake, real), safety supervisor."""

from armcell.drivers import fake, franka, real, sim, ur
from armcell.drivers.driver import (
    Capability,
    ContactRecord,
    Driver,
    DriverOptions,
    GripperReading,
    WeldRecord,
    drivers,
)
from armcell.drivers.execution_handle import ExecutionHandle
from armcell.drivers.proxy import DriverProxy
from armcell.drivers.safety import Fault, SafetyEvent, Supervisor
from armcell.drivers.ur.dashboard import DashboardClient

__all__ = [
    "Capability",
    "ContactRecord",
    "DashboardClient",
    "Driver",
    "DriverOptions",
    "DriverProxy",
    "ExecutionHandle",
    "Fault",
    "GripperReading",
    "SafetyEvent",
    "Supervisor",
    "WeldRecord",
    "drivers",
    "fake",
    "franka",
    "real",
    "sim",
    "ur",
]
