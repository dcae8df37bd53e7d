"""Forward kinematics, Jacobians, inverse kinematics and inverse dynamics."""

from armcell.kinematics.dynamics import InverseDynamics
from armcell.kinematics.ik import (
    POSE_JOINTS,
    AnalyticIK,
    IKSettings,
    IKSolver,
    NumericIK,
    TurnedPose,
    ik_solver,
    ik_solvers,
    poses_about_axis,
)
from armcell.kinematics.tree import KinematicTree, kinematic_tree

__all__ = [
    "POSE_JOINTS",
    "AnalyticIK",
    "IKSettings",
    "IKSolver",
    "InverseDynamics",
    "KinematicTree",
    "NumericIK",
    "TurnedPose",
    "ik_solver",
    "ik_solvers",
    "kinematic_tree",
    "poses_about_axis",
]
