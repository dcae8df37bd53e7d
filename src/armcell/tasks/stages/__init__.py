"""Stages from which the task recipes are composed."""

from armcell.tasks.stages.explicit_grasps import (
    ExplicitGrasp,
    ExplicitPlacement,
    GripperTranslation,
    Lift,
    Retreat,
    UseGrasps,
    UsePlacements,
)
from armcell.tasks.stages.fingers import MoveGripper
from armcell.tasks.stages.grasp import AppendPlannedMotion, ChooseGrasp, Close, LiftCheck
from armcell.tasks.stages.moves import Connect, MoveStraight, RunSteps, UprightConstraint
from armcell.tasks.stages.place import ChoosePlacement, ExpectSupport, OpenHand

__all__ = [
    "AppendPlannedMotion",
    "ChooseGrasp",
    "ChoosePlacement",
    "Close",
    "Connect",
    "ExpectSupport",
    "ExplicitGrasp",
    "ExplicitPlacement",
    "GripperTranslation",
    "Lift",
    "LiftCheck",
    "MoveGripper",
    "MoveStraight",
    "OpenHand",
    "Retreat",
    "RunSteps",
    "UprightConstraint",
    "UseGrasps",
    "UsePlacements",
]
