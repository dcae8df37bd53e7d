"""Containers of stages: serial, alternatives, fallbacks, and the merger of simultaneous motions.

They are those of MoveIt Task Constructor: Görner, Haschke, Ritter, Zhang, MoveIt! Task Constructor for
Task-Level Motion Planning (ICRA 2019).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import islice

from armcell.collision.inter_arm_checker import CLEARANCE, InterArmChecker
from armcell.core import InputError, JointState, JointTrajectory, UnknownNameError
from armcell.core.checks import checked
from armcell.scene import PlanningScene
from armcell.tasks.costs import Cost, duration
from armcell.tasks.search import Branch, PartialSolution, SearchState, Stage, in_order, solutions, stage_types
from armcell.tasks.stages.fingers import finger_collision
from armcell.tasks.stages.grasp import finger_state
from armcell.tasks.steps import CommandGripper, Motion, ParallelMotions, Step
from armcell.tasks.task import InterfaceCheck, serial, single
from armcell.timing import merge_trajectories


@stage_types.register("serial")
@dataclass(frozen=True, eq=False)
class Serial:
    """Container that runs its stages in sequence. For example, a pick can be one part of a task."""

    name: str
    stages: tuple[Stage, ...]

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        yield from solutions(self.stages, solution, planning)

    def check_interface(self, have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
        return serial(self.stages, have, scene)


@stage_types.register("alternatives")
@dataclass(frozen=True, eq=False)
@checked()
class Alternatives:
    """Container of alternative stages.
    All of them are planned, and the cheapest solution is proposed first.
    """

    name: str
    stages: tuple[Stage, ...]
    cost: Cost = duration
    most: int = 1  # solutions per alternative that are compared

    def __post_init__(self) -> None:
        _need_some(self.name, self.stages)
        if self.most < 1:
            raise InputError(f"most is {self.most}, it must be at least 1", element=self.name)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        found = in_order((self._branch(stage, solution) for stage in self.stages), planning)
        yield from sorted(found, key=lambda each: self.cost(each.since(solution)))

    def _branch(self, stage: Stage, solution: PartialSolution) -> Branch:
        return lambda planning: islice(planning.propose(stage, solution), self.most)

    def check_interface(self, have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
        return _either(self.stages, have, scene)


@stage_types.register("fallbacks")
@dataclass(frozen=True, eq=False)
class Fallbacks:
    """Container of fallback stages that are tried one after the other until one has a solution."""

    name: str
    stages: tuple[Stage, ...]

    def __post_init__(self) -> None:
        _need_some(self.name, self.stages)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        for stage in self.stages:
            found = False
            for proposal in planning.propose(stage, solution):
                found = True
                yield proposal
            if found or planning.should_stop:
                return

    def check_interface(self, have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
        return _either(self.stages, have, scene)


def _need_some(name: str, stages: tuple[Stage, ...]) -> None:
    if not stages:
        raise InputError("a container needs at least one stage", element=name)


def _either(stages: tuple[Stage, ...], have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
    """Check the interfaces of alternative stages in a container, and collect the problems of all
    alternatives. Later stages may use only data that every alternative leaves available.
    """
    results = [single(stage, have, scene) for stage in stages]
    return InterfaceCheck(
        frozenset.intersection(*(each.have for each in results)),
        tuple(p for each in results for p in each.problems),
    )


@stage_types.register("merger")
@dataclass(frozen=True, eq=False)
@checked()
class Merger:
    """Merger: a container that runs its stages at the same time,
    either for several arms or for arms and grippers.

    Each stage contributes one arm motion or one gripper motion from the same start. The arms are certified to
    keep their distance on one clock; an arm and fingers are certified for every finger position between start
    and end. An uncertified merge is rejected: as an alternative, put the same stages in sequence after it, in
    `Fallbacks`.
    """

    name: str
    stages: tuple[Stage, ...]
    clearance: float = CLEARANCE  # [m] between the arms

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        for choice in _choices(solution, planning, self.stages):
            together = self._together(solution, planning, choice)
            if together is None:
                continue
            scene, data = solution.scene, dict(solution.data)
            for each in choice:
                data |= each.data
                for step in each.since(solution).steps:
                    scene = scene.with_state(_end(step))
            yield solution.then(together, scene=scene, **data)

    def check_interface(self, have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
        parts = [single(stage, have, scene) for stage in self.stages]
        return InterfaceCheck(
            frozenset.union(have, *(part.have for part in parts)),
            tuple(p for part in parts for p in part.problems),
        )

    def _together(
        self, solution: PartialSolution, planning: SearchState, choice: Sequence[PartialSolution]
    ) -> ParallelMotions | None:
        steps = [step for each in choice for step in each.since(solution).steps]
        motions = [step for step in steps if isinstance(step, Motion)]
        grips = [step for step in steps if isinstance(step, CommandGripper)]
        self._check(steps, motions, grips, choice)
        reason = self._unproven(solution.scene, motions, grips)
        if reason:
            planning.reject(self.name, solution.data.get("candidate", ""), reason)
            return None
        motion = motions[0] if motions else None
        if len(motions) > 1:
            trajectory = merge_trajectories(*(m.trajectory for m in motions))
            near = [m.clearance for m in motions if m.clearance is not None]
            motion = Motion(
                self.name,
                trajectory,
                "merged",
                sum(m.planning_time for m in motions),
                min(near, default=None),
                reduce(_both_allow, (m.planned_in for m in motions)),
                {m.name: m.evidence for m in motions},
            )
        return ParallelMotions(motion, tuple(grips))

    def _check(
        self,
        steps: Sequence[Step],
        motions: Sequence[Motion],
        grips: Sequence[CommandGripper],
        choice: Sequence[PartialSolution],
    ) -> None:
        joints = [n for m in motions for n in m.trajectory.joint_names]
        joints += [name for g in grips for name in g.gripper.joint_names]
        why = ""
        if len(steps) != len(choice) or len(motions) + len(grips) != len(steps):
            why = "each of its stages must be one arm motion or one gripper motion"
        elif len(set(joints)) < len(joints):
            why = "two of its stages move the same joint"
        elif any(grip.width <= 0 for grip in grips):
            why = "the arm must rest while a gripper closes on an object"
        if why:
            raise InputError(why, element=f"merger {self.name!r}")

    def _unproven(
        self, scene: PlanningScene, motions: Sequence[Motion], grips: Sequence[CommandGripper]
    ) -> str:
        """Check whether the motions that a merger would run at the same time are certified collision-free.
        Return the reason if they are not, else an empty text.
        """
        if len(motions) > 1:
            trajectories = [m.trajectory for m in motions]
            arms = InterArmChecker(scene, tuple(_group_of(scene, t) for t in trajectories))
            proof = arms.certify(*trajectories, clearance=self.clearance)
            if not proof.free:
                what = proof.contact.describe() if proof.contact else "the arms come too near"
                return f"the arms come within {self.clearance * 1000:.0f} mm after {proof.time:.2f} s: {what}"
        left = list(grips)
        for motion in motions:
            arm = _group_of(scene, motion.trajectory) if grips else ""
            mine = [g for g in left if g.gripper.arm_group == arm]
            left = [g for g in left if g not in mine]
            if mine and (reason := finger_collision(scene, mine, motion.trajectory)):
                return reason
        return finger_collision(scene, left) if left else ""


def _choices(
    solution: PartialSolution, planning: SearchState, stages: Sequence[Stage]
) -> Iterator[tuple[PartialSolution, ...]]:
    """Yield all combinations of proposals in a merger, with one proposal from each stage. All stages start
    from the same partial solution `solution`.
    """
    if not stages:
        yield ()
        return
    for proposal in planning.propose(stages[0], solution):
        for others in _choices(solution, planning, stages[1:]):
            yield (proposal, *others)


def _both_allow(one: PlanningScene | None, other: PlanningScene | None) -> PlanningScene | None:
    """Return the scene for two motions that a merger runs at the same time. It allows the contacts that
    either of the two motions allows.
    """
    if one is None or other is None:
        return one or other
    return replace(one, allowed_pairs={**one.allowed_pairs, **other.allowed_pairs})


def _end(step: Step) -> JointState:
    if isinstance(step, Motion):
        return step.trajectory.end
    assert isinstance(step, CommandGripper)
    return finger_state(step.gripper, step.width)


def _group_of(scene: PlanningScene, trajectory: JointTrajectory) -> str:
    for group in scene.model.groups.values():
        if group.joint_names == trajectory.joint_names:
            return group.name
    raise UnknownNameError("group of joints", ", ".join(trajectory.joint_names), scene.model.groups)
