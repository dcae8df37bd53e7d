"""Intermediate placements of an object, for goals that no single grasp reaches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice, pairwise

from armcell.core import Outcome
from armcell.core.checks import checked, require
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.pick import pick_stages
from armcell.tasks.recipes import place_stages
from armcell.tasks.regrasp import PlacementGoal, RegraspStep, RestingPose, Vector, regrasp_sequences
from armcell.tasks.search import Lookahead, PartialSolution, SearchState, Stage, solutions, stage_types
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stages import ChoosePlacement
from armcell.tasks.steps import perform_all
from armcell.tasks.task import plan_stages

MOST = 2  # intermediate placements in a row


@dataclass(frozen=True)
class PlacementRecord:
    """Record of an intermediate placement: the object's pose and the number of steps that lead to it."""

    pose: RestingPose
    steps: int


@stage_types.register("intermediate_placement")
@dataclass(frozen=True, eq=False)
@checked()
class IntermediatePlacement:
    """Stage that puts an object down at an intermediate placement
    from which another grasp can reach the goal.

    Up to `most` intermediate placements in a row are allowed.

    It picks the object first unless a hand already holds it. The rest of the sequence to the goal is planned
    as a check and discarded.
    """

    object: str
    support: str  # the goal's
    gripper: Gripper
    at: tuple[float, float] | None = None
    up: Vector | None = None
    most: int = MOST
    name: str = "intermediate placement"
    provides = ("intermediate_placements",)

    def __post_init__(self) -> None:
        require(self.most >= 1, f"most is {self.most}, it must be at least 1")

    @property
    def goal(self) -> PlacementGoal:
        return PlacementGoal(self.object, self.support, self.at, self.up)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        inner = replace(planning)  # a single failed motion must not end the search
        for sequence in regrasp_sequences(solution.scene, self.goal, self.gripper, inner, self.most):
            stages = self._stages(solution.scene, sequence, planning.settings)
            yield from islice(solutions(stages, solution, inner), 1)
            if planning.should_stop:
                return

    def _stages(
        self, scene: PlanningScene, sequence: tuple[RegraspStep, ...], s: TaskSettings
    ) -> list[Stage]:
        stages: list[Stage] = []
        for step, after in pairwise(sequence):
            (pose,) = step.poses
            if self.object not in scene.attached:
                stages += self._pick_stages(scene, step, s)
            stages += self._place_stages(step, s)
            stages.append(_AddRecord(pose))
            scene = scene.with_detached(self.object) if self.object in scene.attached else scene
            scene = scene.with_object_pose(self.object, pose.placement.T_world_object)
            if after is sequence[-1]:
                goes_on = (*self._pick_stages(scene, after, s), *self._place_stages(after, s))
                stages.append(Lookahead("continue to the goal", goes_on))
        return stages

    def _pick_stages(self, scene: PlanningScene, step: RegraspStep, s: TaskSettings) -> list[Stage]:
        places = tuple(pose.placement for pose in step.poses)
        ahead = ChoosePlacement(
            self.object, step.poses[0].on, self.gripper, s.near, s.lower_distance, among=places
        )
        return pick_stages(scene, self.object, self.gripper, s, ahead=[ahead], among=step.grasps)

    def _place_stages(self, step: RegraspStep, s: TaskSettings) -> list[Stage]:
        places = tuple(pose.placement for pose in step.poses)
        return place_stages(self.object, step.poses[0].on, self.gripper, s, among=places)


@stage_types.register("pick_and_place")
@dataclass(frozen=True, eq=False)
@checked()
class PickAndPlace:
    """Stage that picks an object and places it, with intermediate placements where necessary."""

    object: str
    support: str
    gripper: Gripper
    at: tuple[float, float] | None = None
    up: Vector | None = None
    intermediate_placements: int = MOST
    name: str = "pick and place"
    provides = ("placement",)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        found = False
        for direct in self._direct(solution, planning):
            found = True
            yield direct
        if found or planning.should_stop or not self.intermediate_placements:
            return
        down = IntermediatePlacement(
            self.object, self.support, self.gripper, self.at, self.up, self.intermediate_placements
        )
        for laid in down.propose(solution, planning):
            yield from self._direct(laid, planning)

    def _direct(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        s, item = planning.settings, self.object
        goal = ChoosePlacement(item, self.support, self.gripper, s.near, s.lower_distance, self.at, self.up)
        stages = pick_stages(solution.scene, item, self.gripper, s, ahead=[goal])
        stages += place_stages(item, self.support, self.gripper, s, self.at, self.up)
        yield from solutions(stages, solution, replace(planning))


@dataclass(frozen=True, eq=False)
class _AddRecord:
    """Stage that records an intermediate placement (its pose and the number of steps so far) in the data of
    the partial solution.
    """

    pose: RestingPose
    name: str = "placement record"

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        before = solution.data.get("intermediate_placements", ())
        yield solution.then(
            intermediate_placements=(*before, PlacementRecord(self.pose, len(solution.steps)))
        )


def place_intermediate(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None = None,
    up: Vector | None = None, most: int = MOST,
) -> Outcome:  # fmt: skip
    """Place an object at an intermediate pose from which the arm can bring it to the goal with another grasp.

    The whole sequence to the goal is planned before the arm moves. Measure the object's pose before you pick
    it again.

    Args:
        on, at, up: the goal, as for `place`.
        most: maximum number of intermediate placements in a row.
    Returns:
        SUCCESS with `placement`, `support` and `intermediate_placements` (their number in the sequence) in
        the evidence; otherwise the reasons per side.
    """
    stages = [IntermediatePlacement(item, on, gripper, at, up, most)]
    solution, outcome = plan_stages(ctx, stages, f"intermediate placement of {item}")
    if solution is None:
        return outcome
    records: tuple[PlacementRecord, ...] = solution.data["intermediate_placements"]
    first = records[0]
    count = f", the first of {len(records)}" if len(records) > 1 else ""
    ctx.emit(
        "note", f"{item}: no single grasp reaches the goal; intermediate placement on {first.pose.on}{count}"
    )
    outcome = perform_all(ctx, solution.steps[: first.steps])
    evidence = {
        "placement": first.pose.placement,
        "support": first.pose.on,
        "intermediate_placements": len(records),
    }
    return replace(outcome, evidence={**outcome.evidence, **evidence})
