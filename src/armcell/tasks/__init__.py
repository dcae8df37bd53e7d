"""Task planning and execution: stages, search, recipes, and recovery from failures."""

from armcell.tasks.arms import CarrySettings, SideBySide, TwoArmCarry, moved_object_pose, side_by_side
from armcell.tasks.bin_clearing import BinClearingSettings
from armcell.tasks.containers import Alternatives, Fallbacks, Merger, Serial
from armcell.tasks.context import HeldObject, StageReport, TaskContext
from armcell.tasks.conveyor_pick import ConveyorPickSettings, pick_moving
from armcell.tasks.costs import Cost, clearance, costs, duration, path_length, weighted
from armcell.tasks.grasp_proof import NOISE, GraspProof, distinct_grasps, prove_grasps, sample_object_variants
from armcell.tasks.intermediate_placement import IntermediatePlacement, PickAndPlace, place_intermediate
from armcell.tasks.pick import Pick, grasp, grasp_stages, pick, pick_stages
from armcell.tasks.pipelined import PipelinedTask, PipelineSettings, perform_pipelined, picking, placing
from armcell.tasks.recipes import (
    hold,
    move_to,
    perform_stages,
    place,
    place_stages,
    release,
    release_and_retreat,
)
from armcell.tasks.recovery import RecoverySettings, transfer
from armcell.tasks.search import (
    Lookahead,
    PartialSolution,
    SearchState,
    Stage,
    make_stage,
    search,
    solutions,
    stage_types,
)
from armcell.tasks.settings import Speed, TaskSettings
from armcell.tasks.sorting import SortSettings, sort
from armcell.tasks.stage_statistics import stage_table
from armcell.tasks.stages import Connect, MoveGripper, MoveStraight
from armcell.tasks.steps import Motion, perform_all
from armcell.tasks.task import Task, TaskError, TaskFailed, TaskPlan, check_task, checked, holding_condition

__all__ = [
    "NOISE",
    "Alternatives",
    "BinClearingSettings",
    "CarrySettings",
    "Connect",
    "ConveyorPickSettings",
    "Cost",
    "Fallbacks",
    "GraspProof",
    "HeldObject",
    "IntermediatePlacement",
    "Lookahead",
    "Merger",
    "Motion",
    "MoveGripper",
    "MoveStraight",
    "PartialSolution",
    "Pick",
    "PickAndPlace",
    "PipelineSettings",
    "PipelinedTask",
    "RecoverySettings",
    "SearchState",
    "Serial",
    "SideBySide",
    "SortSettings",
    "Speed",
    "Stage",
    "StageReport",
    "Task",
    "TaskContext",
    "TaskError",
    "TaskFailed",
    "TaskPlan",
    "TaskSettings",
    "TwoArmCarry",
    "check_task",
    "checked",
    "clearance",
    "costs",
    "distinct_grasps",
    "duration",
    "grasp",
    "grasp_stages",
    "hold",
    "holding_condition",
    "make_stage",
    "move_to",
    "moved_object_pose",
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
    "prove_grasps",
    "release",
    "release_and_retreat",
    "sample_object_variants",
    "search",
    "side_by_side",
    "solutions",
    "sort",
    "stage_table",
    "stage_types",
    "transfer",
    "weighted",
]
