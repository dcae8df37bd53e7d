"""Universal Robots arms in pure Python: state by RTDE, motion by a robot program; kind `ur`."""

from armcell.drivers.ur.kind import UrKind

__all__ = ["UrKind"]
