"""Universal Robots arms, in pure Python: state over RTDE, motion by a program of ours on the robot."""

from armcell.control.drivers.ur.driver import UrDriver

__all__ = ["UrDriver"]
