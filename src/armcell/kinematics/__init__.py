"""Forward kinematics, Jacobians and inverse kinematics."""

from armcell.kinematics.ik import IKSettings, NumericIK
from armcell.kinematics.tree import KinematicTree, kinematic_tree

__all__ = ["IKSettings", "KinematicTree", "NumericIK", "kinematic_tree"]
