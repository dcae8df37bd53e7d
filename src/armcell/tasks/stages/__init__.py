"""Stages that recipes are made of."""

from armcell.tasks.stages.grasp import ChooseGrasp, Close, Planned
from armcell.tasks.stages.moves import Connect, Straight
from armcell.tasks.stages.place import ChoosePlacement, ExpectSupport, Open

__all__ = [
    "ChooseGrasp",
    "ChoosePlacement",
    "Close",
    "Connect",
    "ExpectSupport",
    "Open",
    "Planned",
    "Straight",
]
