"""Universal Robots arms (kind `ur`) in pure Python: RTDE for state, a program for motion."""

from armcell.drivers.ur.robot_kind import UrKind

__all__ = ["UrKind"]
