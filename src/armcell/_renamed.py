"""Names that armcell has renamed. The traceback of a program that uses one of them ends with the new name.

Python itself suggests names that are spelled alike. The tables hold the names that differ more, and the
packages that were split. `armcell/__init__.py` imports this module only after an exception has ended the
program.
"""

from __future__ import annotations

import inspect
import re
import sys
from types import ModuleType

PACKAGES = {
    "control": "execution, armcell.drivers, armcell.twin and armcell.emulators",
    "control.drivers": "drivers",
    "control.drivers.ur": "drivers.ur",
    "control.twin": "twin",
    "control.ur_controller": "emulators.ur",
    "control.ur_controller.urscript": "emulators.ur.urscript",
    "planning.arms": "planning.multi_arm",
    "planning.explanation": "planning.diagnosis",
    "tasks.clearing": "tasks.bin_clearing",
}
"""Renamed package, without `armcell.` -> the packages that now have its content."""

NAMES = {
    "cell.CameraWatch": "cell.OctomapUpdater",
    "cell.Proposal": "cell.SetupProposal",
    "cell.parsed": "cell.parse_value",
    "collision.Arms": "collision.InterArmChecker",
    "collision.cone": "collision.view_cone",
    "collision.links_apart": "collision.links_by_distance",
    "collision.links_within": "collision.links_in_hull",
    "collision.neighbours": "collision.neighbors",
    "collision.without_arm": "collision.without_arms",
    "collision.without_robot": "collision.remove_robot_points",
    "control.Follower": "drivers.Driver with Capability.PLAY_TRAJECTORY",
    "control.Rack": "emulators.UrRack",
    "control.Steps": "execution.ExecutionSteps",
    "control.playing": "execution.execution_steps",
    "control.drivers.ur.UrDriver": "drivers.real.RealDriver",
    "control.twin.ArmBands": "twin.ArmResidualThresholds",
    "control.twin.Rehearsal": "twin.DryRun",
    "control.twin.Stage": "twin.TwinSimulation",
    "control.twin.TwinBands": "twin.ResidualThresholds",
    "control.twin.learned": "twin.fit_thresholds",
    "control.ur_controller.WorldPlant": "emulators.ur.PhysicsPlant",
    "grasping.AboveSettings": "grasping.TopDownGraspSettings",
    "grasping.Rest": "grasping.StablePose",
    "grasping.grasps_from_above": "grasping.top_down_grasps",
    "grasping.how_near": "grasping.rejection_sort_key",
    "grasping.rests": "grasping.stable_poses",
    "model.Part": "model.MountedRobot",
    "model.setup.Chain": "model.setup.ArmChain",
    "model.setup.described": "model.setup.srdf_of",
    "perception.MarkerSight": "perception.MarkerDetections",
    "perception.SeenMarker": "perception.DetectedMarker",
    "perception.SeenObject": "perception.DetectedObject",
    "perception.Sight": "perception.DetectionResult",
    "perception.colour_distance": "perception.color_distance",
    "perception.colour_name": "perception.color_name",
    "perception.drawn": "perception.draw_detections",
    "perception.organised": "perception.organized_cloud",
    "perception.pieces": "perception.label_pieces",
    "perception.unusable": "perception.check_image",
    "planning.Answer": "planning.PlannerResult",
    "planning.Branch": "planning.IKBranch",
    "planning.PairPlan": "planning.SynchronizedPlan",
    "planning.plan_among_moving": "planning.plan_around_moving_obstacles",
    "planning.plan_beside": "planning.plan_around_moving_arms",
    "planning.plan_together": "planning.plan_synchronized",
    "planning.prepare": "planning.prepare_group",
    "planning.satisfied": "planning.satisfies_constraints",
    "planning.violations": "planning.describe_violations",
    "planning.explanation.beyond_limits": "planning.diagnosis.solutions_beyond_limits",
    "planning.explanation.explain_misuse": "planning.explain_invalid_request",
    "planning.explanation.explained": "planning.diagnosis.with_explanation",
    "records.about_run": "records.run_metadata",
    "records.cell_of": "records.recorded_cell",
    "records.execute_again": "records.reexecute",
    "ros.Bridge": "ros.ForwardedNames",
    "ros.Done": "ros.ActionOutcome",
    "ros.Reach": "ros.DomainScope",
    "ros.State": "ros.GoalState",
    "ros.cdr": "ros.cdr_codec",
    "ros.nodes.CellAccess": "ros.nodes.CellMotions",
    "ros.nodes.LocalCell": "ros.nodes.CellMotions",
    "ros.nodes.RemoteCell": "ros.nodes.RemoteMotions",
    "ros.ros2.Profile": "ros.ros2.QosProfile",
    "scene.Allow": "scene.AllowCollision",
    "scene.AllowByDefault": "scene.AllowCollisionByDefault",
    "scene.Kind": "scene.ObjectKind",
    "scene.Thread": "scene.ScrewThread",
    "sim.Targets": "sim.JointTargets",
    "sim.Trial": "sim.GraspTrial",
    "tasks.AheadSettings": "tasks.PipelineSettings",
    "tasks.Carrying": "tasks.TwoArmCarry",
    "tasks.ClearSettings": "tasks.BinClearingSettings",
    "tasks.Draft": "tasks.PartialSolution",
    "tasks.Foresee": "tasks.Lookahead",
    "tasks.Holding": "tasks.HeldObject",
    "tasks.LayDown": "tasks.IntermediatePlacement",
    "tasks.MovingSettings": "tasks.ConveyorPickSettings",
    "tasks.Part": "tasks.PipelinedTask",
    "tasks.Planning": "tasks.SearchState",
    "tasks.Proof": "tasks.GraspProof",
    "tasks.Straight": "tasks.MoveStraight",
    "tasks.as_it_may_be": "tasks.sample_object_variants",
    "tasks.holding": "tasks.holding_condition",
    "tasks.lay_down": "tasks.place_intermediate",
    "tasks.let_go": "tasks.release_and_retreat",
    "tasks.perform_parts": "tasks.perform_pipelined",
    "tasks.prove": "tasks.prove_grasps",
    "tasks.shifted": "tasks.moved_object_pose",
    "tasks.varied": "tasks.distinct_grasps",
    "tasks.arms.Pace": "tasks.arms.CycleTimes",
    "tasks.stages.ChooseGivenGrasp": "tasks.stages.UseGrasps",
    "tasks.stages.ChooseGivenPlace": "tasks.stages.UsePlacements",
    "tasks.stages.Do": "tasks.stages.RunSteps",
    "tasks.stages.GivenGrasp": "tasks.stages.ExplicitGrasp",
    "tasks.stages.GivenPlace": "tasks.stages.ExplicitPlacement",
    "tasks.stages.Leave": "tasks.stages.Retreat",
    "tasks.stages.Open": "tasks.stages.OpenHand",
    "tasks.stages.Planned": "tasks.stages.AppendPlannedMotion",
    "tasks.stages.Upright": "tasks.stages.UprightConstraint",
    "tasks.stages.Way": "tasks.stages.GripperTranslation",
    "tasks.trees.held": "tasks.trees.held_node",
    "timing.reversed_in_time": "timing.reverse_trajectory",
    "timing.smoothing_departure": "timing.smoothing_deviation",
    "timing.stretched": "timing.slow_down",
    "timing.stretched_to": "timing.slow_down_to_duration",
    "timing.synchronized": "timing.synchronize_trajectories",
}
"""Renamed class or function with its package -> its new package and name, both without `armcell.`."""

MEMBERS = (
    ("about", "metadata"),
    ("aim", "set_joint_targets"),
    ("apart", "find_too_close"),
    ("at_once", "thread_count"),
    ("both", "combined"),
    ("branch", "fork"),
    ("centre_of_mass", "center_of_mass"),
    ("centres", "centers"),
    ("change", "edit_scene"),
    ("checked", "check_interface"),
    ("clear", "request_start"),
    ("code", "outcome_code"),
    ("cure", "hint"),
    ("deviations", "residuals"),
    ("draft", "solution"),
    ("drafts", "propose"),
    ("executed", "execute_trajectory"),
    ("find_elsewhere", "add_service_finder"),
    ("first_near", "first_too_close"),
    ("forget_elsewhere", "remove_service_finder"),
    ("gives", "provides"),
    ("held", "held_object"),
    ("hopeless", "should_stop"),
    ("inv", "inverse"),
    ("judged", "accepted"),
    ("keeps_time", "follows_clock"),
    ("lacks", "missing_policies"),
    ("lay_downs", "intermediate_placements"),
    ("least", "minimum"),
    ("listen", "add_listener"),
    ("made_way", "yielded"),
    ("measured", "object_poses"),
    ("meet", "rendezvous"),
    ("moved_unseen", "displaced_objects"),
    ("needs", "requires"),
    ("offset", "desired"),
    ("other", "others"),
    ("own", "close_on_shutdown"),
    ("pace", "cycle_times"),
    ("parts", "input_differences"),
    ("parts", "tasks"),
    ("place", "set_configuration"),
    ("place_object", "set_object_pose"),
    ("planned", "plan_response"),
    ("play", "queue_trajectory"),
    ("prepared", "chain_data"),
    ("rehearse", "dry_run"),
    ("rest", "stop_motions"),
    ("rows", "torque_coefficients"),
    ("running", "others"),
    ("send", "send_goal"),
    ("set", "change_settings"),
    ("set_present", "set_current_state"),
    ("settled", "wait_until_idle"),
    ("sieve", "grasp_filter"),
    ("stage", "simulation"),
    ("standing", "at_rest"),
    ("stoppable", "cancel_on_stop_event"),
    ("taker", "receiver"),
    ("takes", "consumes"),
    ("tell", "queue_event"),
    ("tidy", "array_converter"),
    ("told", "plan_metadata"),
    ("traffic", "coordinator"),
    ("trajectory", "motion"),
    ("trusted", "unchecked"),
    ("unfinished", "unfinished_goals"),
    ("unknown", "fail_unknown_function"),
    ("wanted", "goal"),
    ("watching", "monitor"),
    ("way_in", "pre_grasp_approach"),
    ("way_out", "post_grasp_retreat"),
    ("works", "motions"),
)
"""Renamed attributes, methods and parameters: old name, new name."""

KEYS = {
    "laid_down": "intermediate_placements",
    "lay_down": "intermediate_placement",
}
"""Renamed key of an outcome's evidence -> its new name."""


def new_name(error: BaseException) -> str:
    """Return a sentence with the new name of the name that an exception is about; "" for other exceptions."""
    found = None
    if isinstance(error, ModuleNotFoundError):
        found = _new_package(error.name or "")
    elif isinstance(error, ImportError):
        match = re.match(r"cannot import name '(\w+)' from '([\w.]+)'", str(error))
        found = _new_member_of_package(match[2], match[1]) if match else None
    elif isinstance(error, AttributeError) and error.name:
        if isinstance(error.obj, ModuleType):
            found = _new_member_of_package(error.obj.__name__, error.name)
        elif _is_ours(error.obj):
            new = [new for old, new in MEMBERS if old == error.name and hasattr(error.obj, new)]
            found = f"{error.name} is now {new[0]}" if new else None
    elif isinstance(error, KeyError):
        old = str(error).strip("'")
        found = f"{old} is now {KEYS[old]}" if old in KEYS else None
    elif isinstance(error, TypeError):
        match = re.search(r"(\w+?)(?:\.__init__)?\(\) got an unexpected keyword argument '(\w+)'", str(error))
        found = _new_parameter(match[1], match[2]) if match else None
    return f"armcell has renamed this: {found}" if found else ""


def _is_ours(item: object) -> bool:
    kind = item if isinstance(item, type) else type(item)
    return any(base.__module__.partition(".")[0] == "armcell" for base in kind.__mro__)


def _new_package(module: str) -> str | None:
    """Return where the content of a missing package is now, by the longest part of its name that is known."""
    parent, *parts = module.split(".")
    for n in range(len(parts), 0, -1) if parent == "armcell" else ():
        if (old := ".".join(parts[:n])) in PACKAGES:
            return f"armcell.{old} is now armcell.{PACKAGES[old]}"
    return None


def _new_member_of_package(module: str, name: str) -> str | None:
    """Return the new name of a name that a package lacks. Prefer a name that was in the same package."""
    if found := _new_package(f"{module}.{name}"):
        return found
    rows = [old for old in NAMES if old.rpartition(".")[2] == name and module.partition(".")[0] == "armcell"]
    rows.sort(key=lambda old: f"armcell.{old}" != f"{module}.{name}")
    return f"{name} is now armcell.{NAMES[rows[0]]}" if rows else None


def _new_parameter(function: str, name: str) -> str | None:
    """Return the new name of a parameter, if a function or class of a loaded package has it."""
    possible = {new for old, new in MEMBERS if old == name}
    packages = [m for n, m in sys.modules.items() if n.partition(".")[0] == "armcell"] if possible else []
    called = (getattr(package, function, None) for package in packages)
    for call in filter(callable, called):
        if new := possible & inspect.signature(call).parameters.keys():
            return f"{name} is now {new.pop()}"
    return None
