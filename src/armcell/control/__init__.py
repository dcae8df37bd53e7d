"""Make it move: the Driver protocol, the drivers, the executor."""

from armcell.control import drivers as _registered  # noqa: F401  (fills the table)
from armcell.control.driver import ContactRecord, Driver, DriverOptions, GripperReading, WeldRecord, drivers
from armcell.control.executor import ExecutionSettings, execute, playing

__all__ = [
    "ContactRecord",
    "Driver",
    "DriverOptions",
    "ExecutionSettings",
    "GripperReading",
    "WeldRecord",
    "drivers",
    "execute",
    "playing",
]
