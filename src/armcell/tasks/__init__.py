"""In which order, and what if it fails? Stages, search, recipes."""

from armcell.tasks.checked import TaskFailed, checked
from armcell.tasks.context import Holding, StageReport, TaskContext
from armcell.tasks.proof import NOISE, Proof, prove, varied
from armcell.tasks.recipes import grasp, hold, let_go, move_to, pick, place, release
from armcell.tasks.search import Draft, Planning, Stage, search
from armcell.tasks.settings import Speed, TaskSettings
from armcell.tasks.steps import Motion, perform_all

__all__ = [
    "NOISE",
    "Draft",
    "Holding",
    "Motion",
    "Planning",
    "Proof",
    "Speed",
    "Stage",
    "StageReport",
    "TaskContext",
    "TaskFailed",
    "TaskSettings",
    "checked",
    "grasp",
    "hold",
    "let_go",
    "move_to",
    "perform_all",
    "pick",
    "place",
    "prove",
    "release",
    "search",
    "varied",
]
