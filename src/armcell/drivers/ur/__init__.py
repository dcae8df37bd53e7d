"""Driver for Universal Robots arms in pure Python: state by RTDE, motion by a robot program."""

from armcell.drivers.ur.driver import UrDriver

__all__ = ["UrDriver"]
