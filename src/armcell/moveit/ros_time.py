"""rospy.Time and rospy.Duration: genpy's arithmetic for the bus's own time stamps."""

from __future__ import annotations

import functools
from typing import Any, ClassVar

from armcell.ros.bus import Clock

SECOND = 1_000_000_000  # [ns]
NO_SESSION = "no cell to talk to: run the script with `armcell run SCRIPT.py --cell CELL`"
session_clocks: list[Clock] = []
"""Clock of the open session of a ROS script, if there is one."""


@functools.total_ordering
class _Stamp:
    """Base class of ROS times and durations (rospy's Time and Duration), which store whole seconds and
    nanoseconds from 0 to 999999999.

    genpy's names `secs` and `nsecs` work as well.
    """

    __slots__ = ("nanosec", "sec")
    _type: ClassVar[str]
    _fields: ClassVar[tuple[str, ...]] = ("sec", "nanosec")

    def __init__(self, secs: float = 0, nsecs: int = 0, **fields: int):
        secs, nsecs = fields.get("sec", secs), fields.get("nanosec", nsecs)
        if not isinstance(secs, int):
            if nsecs:
                raise ValueError("if secs is a float, nsecs cannot be set")
            secs, nsecs = divmod(round(float(secs) * SECOND), SECOND)
        carry, self.nanosec = divmod(int(nsecs), SECOND)
        self.sec = int(secs) + carry

    secs = property(lambda self: self.sec, lambda self, value: setattr(self, "sec", value))
    nsecs = property(lambda self: self.nanosec, lambda self, value: setattr(self, "nanosec", value))

    @classmethod
    def from_sec(cls, seconds: float) -> Any:
        return cls(float(seconds))

    @classmethod
    def from_seconds(cls, seconds: float) -> Any:
        return cls(float(seconds))

    def to_sec(self) -> float:
        return self.sec + self.nanosec * 1e-9

    def to_nsec(self) -> int:
        return self.sec * SECOND + self.nanosec

    def is_zero(self) -> bool:
        return self.sec == 0 and self.nanosec == 0

    def set(self, secs: int, nsecs: int) -> None:
        self.sec, self.nanosec = secs, nsecs

    def __bool__(self) -> bool:
        return not self.is_zero()

    def __hash__(self) -> int:
        return hash((self.sec, self.nanosec))

    def __eq__(self, other: object) -> bool:
        return hasattr(other, "nanosec") and self.to_nsec() == other.to_nsec()  # type: ignore[attr-defined]

    def __lt__(self, other: Any) -> bool:
        if not hasattr(other, "nanosec"):
            return NotImplemented
        return self.to_nsec() < other.to_nsec()

    def __repr__(self) -> str:
        return f"{type(self).__module__.split('.')[-1]}.{type(self).__name__}[{self.to_nsec()}]"

    def __str__(self) -> str:
        return str(self.to_nsec())


def _is(value: object, cls: type) -> bool:
    return getattr(value, "_type", None) == cls._type  # type: ignore[attr-defined]


class Duration(_Stamp):
    """Duration in ROS time, with the arithmetic of rospy.Duration (genpy). A duration may be negative."""

    __slots__ = ()
    _type = "builtin_interfaces/Duration"

    def __add__(self, other: Any) -> Any:
        if _is(other, Time):
            return Time(0, self.to_nsec() + other.to_nsec())
        return Duration(0, self.to_nsec() + other.to_nsec()) if _is(other, Duration) else NotImplemented

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return Duration(0, self.to_nsec() - other.to_nsec()) if _is(other, Duration) else NotImplemented

    def __neg__(self) -> Duration:
        return Duration(0, -self.to_nsec())

    def __abs__(self) -> Duration:
        return Duration(0, abs(self.to_nsec()))

    def __mul__(self, factor: float) -> Duration:
        return Duration(0, round(self.to_nsec() * factor))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        if _is(other, Duration):
            return self.to_nsec() / other.to_nsec()
        return Duration(0, round(self.to_nsec() / other))

    def __floordiv__(self, other: Any) -> Any:
        if _is(other, Duration):
            return self.to_nsec() // other.to_nsec()
        return Duration(0, self.to_nsec() // other)


class Time(_Stamp):
    """Point in ROS time, with the arithmetic of rospy.Time (genpy)."""

    __slots__ = ()
    _type = "builtin_interfaces/Time"

    def __init__(self, secs: float = 0, nsecs: int = 0, **fields: int):
        super().__init__(secs, nsecs, **fields)
        if self.sec < 0:
            raise TypeError("time values must be positive")

    def to_time(self) -> float:
        return self.to_sec()

    @staticmethod
    def now() -> Time:
        """Return the current ROS time from the cell's clock, like rospy.Time.now.

        Raises:
            RuntimeError: no session is open.
        """
        if not session_clocks:
            raise RuntimeError(NO_SESSION)
        return Time.from_sec(session_clocks[-1].now())

    def __add__(self, other: Any) -> Any:
        return Time(0, self.to_nsec() + other.to_nsec()) if _is(other, Duration) else NotImplemented

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        if _is(other, Time):
            return Duration(0, self.to_nsec() - other.to_nsec())
        return Time(0, self.to_nsec() - other.to_nsec()) if _is(other, Duration) else NotImplemented

    def __rsub__(self, other: Any) -> Any:
        return Duration(0, other.to_nsec() - self.to_nsec()) if _is(other, Time) else NotImplemented
