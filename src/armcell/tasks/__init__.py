"""Task planning and execution: stages, search, recipes, and recovery from failures."""

from armcell.tasks.arms import Carrying, CarrySettings, SideBySide, shifted, side_by_side
from armcell.tasks.bin_clearing import ClearSettings
from armcell.tasks.containers import Alternatives, Fallbacks, Serial
from armcell.tasks.context import Holding, StageReport, TaskContext
from armcell.tasks.conveyor_pick import MovingSettings, pick_moving
from armcell.tasks.costs import Cost, clearance, costs, duration, path_length, weighted
from armcell.tasks.interfaces import TaskError, check_task, holding
from armcell.tasks.intermediate_placement import IntermediatePlacement, PickAndPlace, place_intermediate
from armcell.tasks.merger import Merger
from armcell.tasks.pick import Pick, grasp, grasp_stages, pick, pick_stages
from armcell.tasks.pipelined import PipelinedTask, PipelineSettings, perform_pipelined, picking, placing
from armcell.tasks.proof import NOISE, Proof, as_it_may_be, prove, varied
from armcell.tasks.recipes import hold, let_go, move_to, perform_stages, place, place_stages, release
from armcell.tasks.recovery import RecoverySettings, transfer
from armcell.tasks.search import (
    Lookahead,
    PartialSolution,
    Planning,
    Stage,
    make_stage,
    search,
    solutions,
    stage_types,
)
from armcell.tasks.settings import Speed, TaskSettings
from armcell.tasks.sorting import SortSettings, sort
from armcell.tasks.stage_statistics import stage_table
from armcell.tasks.stages import Connect, MoveGripper, Straight
from armcell.tasks.steps import Motion, perform_all
from armcell.tasks.task import Task, TaskFailed, TaskPlan, checked

__all__ = [
    "NOISE",
    "Alternatives",
    "CarrySettings",
    "Carrying",
    "ClearSettings",
    "Connect",
    "Cost",
    "Fallbacks",
    "Holding",
    "IntermediatePlacement",
    "Lookahead",
    "Merger",
    "Motion",
    "MoveGripper",
    "MovingSettings",
    "PartialSolution",
    "Pick",
    "PickAndPlace",
    "PipelineSettings",
    "PipelinedTask",
    "Planning",
    "Proof",
    "RecoverySettings",
    "Serial",
    "SideBySide",
    "SortSettings",
    "Speed",
    "Stage",
    "StageReport",
    "Straight",
    "Task",
    "TaskContext",
    "TaskError",
    "TaskFailed",
    "TaskPlan",
    "TaskSettings",
    "as_it_may_be",
    "check_task",
    "checked",
    "clearance",
    "costs",
    "duration",
    "grasp",
    "grasp_stages",
    "hold",
    "holding",
    "let_go",
    "make_stage",
    "move_to",
    "path_length",
    "perform_all",
    "perform_pipelined",
    "perform_stages",
    "pick",
    "pick_moving",
    "pick_stages",
    "picking",
    "place",
    "place_intermediate",
    "place_stages",
    "placing",
    "prove",
    "release",
    "search",
    "shifted",
    "side_by_side",
    "solutions",
    "sort",
    "stage_table",
    "stage_types",
    "transfer",
    "varied",
    "weighted",
]
