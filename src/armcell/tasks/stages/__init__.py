"""Stages that recipes are made of."""

from armcell.tasks.stages.fingers import MoveGripper
from armcell.tasks.stages.given import (
    ChooseGivenGrasp,
    ChooseGivenPlace,
    GivenGrasp,
    GivenPlace,
    Leave,
    Lift,
    Way,
)
from armcell.tasks.stages.grasp import ChooseGrasp, Close, Planned
from armcell.tasks.stages.moves import Connect, Do, Straight, Upright
from armcell.tasks.stages.place import ChoosePlacement, ExpectSupport, Open

__all__ = [
    "ChooseGivenGrasp",
    "ChooseGivenPlace",
    "ChooseGrasp",
    "ChoosePlacement",
    "Close",
    "Connect",
    "Do",
    "ExpectSupport",
    "GivenGrasp",
    "GivenPlace",
    "Leave",
    "Lift",
    "MoveGripper",
    "Open",
    "Planned",
    "Straight",
    "Upright",
    "Way",
]
