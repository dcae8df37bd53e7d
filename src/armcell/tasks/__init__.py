"""In which order, and what if it fails? Stages, search, recipes."""

from armcell.tasks.arms import Carrying, CarrySettings, SideBySide, shifted, side_by_side
from armcell.tasks.checked import TaskFailed, checked
from armcell.tasks.clearing import ClearSettings
from armcell.tasks.context import Holding, StageReport, TaskContext
from armcell.tasks.moving import MovingSettings, pick_moving
from armcell.tasks.proof import NOISE, Proof, prove, varied
from armcell.tasks.recipes import grasp, hold, let_go, move_to, pick, place, release
from armcell.tasks.recovery import RecoverySettings, transfer
from armcell.tasks.search import Draft, Foresee, Planning, Stage, search
from armcell.tasks.settings import Speed, TaskSettings
from armcell.tasks.steps import Motion, perform_all

__all__ = [
    "NOISE",
    "CarrySettings",
    "Carrying",
    "ClearSettings",
    "Draft",
    "Foresee",
    "Holding",
    "Motion",
    "MovingSettings",
    "Planning",
    "Proof",
    "RecoverySettings",
    "SideBySide",
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
    "pick_moving",
    "place",
    "prove",
    "release",
    "search",
    "shifted",
    "side_by_side",
    "transfer",
    "varied",
]
