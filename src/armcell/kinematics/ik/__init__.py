"""Inverse kinematics solvers."""

from armcell.kinematics.ik.numeric import IKSettings, NumericIK

__all__ = ["IKSettings", "NumericIK"]
