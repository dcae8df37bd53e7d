"""Forward kinematics, Jacobians and inverse kinematics."""

from armcell.kinematics.dynamics import InverseDynamics
from armcell.kinematics.ik import IKSettings, NumericIK
from armcell.kinematics.tree import KinematicTree, kinematic_tree

__all__ = ["IKSettings", "InverseDynamics", "KinematicTree", "NumericIK", "kinematic_tree"]
