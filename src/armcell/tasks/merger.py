"""Motions of several stages made at once, where it is proven that they may be."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from armcell.collision.arms import CLEARANCE, Arms, merged
from armcell.core import InputError, JointState, JointTrajectory, UnknownNameError
from armcell.core.checks import checked
from armcell.scene import PlanningScene
from armcell.tasks.interfaces import Checked, single
from armcell.tasks.search import Draft, Planning, Stage
from armcell.tasks.stages.fingers import fingers_meanwhile
from armcell.tasks.stages.grasp import finger_state
from armcell.tasks.steps import Grip, Motion, Step, Together


@dataclass(frozen=True, eq=False)
@checked()
class Merger:
    """Stages that begin where it begins and are performed at once: two arms, or arms and grippers.

    Every stage adds one motion of an arm or one drive of a gripper. Two arms are proven to keep apart on one
    clock; an arm and fingers are proven free wherever between their ends the fingers are meanwhile. What
    cannot be proven is rejected: put the same stages after one another behind it, in `Fallbacks`.
    """

    name: str
    stages: tuple[Stage, ...]
    clearance: float = CLEARANCE  # [m] between two arms

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        for ways in _choices(draft, planning, self.stages):
            together = self._together(draft, planning, ways)
            if together is None:
                continue
            scene, data = draft.scene, dict(draft.data)
            for way in ways:
                data |= way.data
                for step in way.since(draft).steps:
                    scene = scene.with_state(_end(step))
            yield draft.then(together, scene=scene, **data)

    def checked(self, have: frozenset[str], scene: PlanningScene | None) -> Checked:
        parts = [single(stage, have, scene) for stage in self.stages]
        return Checked(
            frozenset.union(have, *(part.have for part in parts)),
            tuple(p for part in parts for p in part.problems),
        )

    def _together(self, draft: Draft, planning: Planning, ways: Sequence[Draft]) -> Together | None:
        steps = [step for way in ways for step in way.since(draft).steps]
        motions = [step for step in steps if isinstance(step, Motion)]
        grips = [step for step in steps if isinstance(step, Grip)]
        self._check(steps, motions, grips, ways)
        reason = self._unproven(draft.scene, motions, grips)
        if reason:
            planning.reject(self.name, draft.data.get("candidate", ""), reason)
            return None
        motion = motions[0] if motions else None
        if len(motions) == 2:
            trajectory = merged(motions[0].trajectory, motions[1].trajectory)
            near = [m.clearance for m in motions if m.clearance is not None]
            motion = Motion(
                self.name,
                trajectory,
                "merged",
                sum(m.planning_time for m in motions),
                min(near, default=None),
                _both_allow(motions[0].planned_in, motions[1].planned_in),
                {m.name: m.evidence for m in motions},
            )
        return Together(motion, tuple(grips))

    def _check(
        self, steps: Sequence[Step], motions: Sequence[Motion], grips: Sequence[Grip], ways: Sequence[Draft]
    ) -> None:
        joints = [n for m in motions for n in m.trajectory.joint_names]
        joints += [g.gripper.joint_name for g in grips]
        why = ""
        if len(steps) != len(ways) or len(motions) + len(grips) != len(steps):
            why = "each of its stages must be one motion of an arm or one drive of a gripper"
        elif len(motions) > 2:
            why = f"{len(motions)} arms move: two can be proven at once"
        elif len(set(joints)) < len(joints):
            why = "two of its stages move the same joint"
        elif any(grip.width <= 0 for grip in grips):
            why = "a gripper that closes on something does so with the arm at rest"
        if why:
            raise InputError(why, element=f"merger {self.name!r}")

    def _unproven(self, scene: PlanningScene, motions: Sequence[Motion], grips: Sequence[Grip]) -> str:
        """Why it may not be done at once; empty if it may."""
        if len(motions) == 2:
            first, second = (m.trajectory for m in motions)
            groups = _group_of(scene, first), _group_of(scene, second)
            proof = Arms(scene, groups).certify(first, second, clearance=self.clearance)
            if not proof.free:
                what = proof.contact.describe() if proof.contact else "the arms come too near"
                return f"the arms come within {self.clearance * 1000:.0f} mm after {proof.time:.2f} s: {what}"
        left = list(grips)
        for motion in motions:
            arm = _group_of(scene, motion.trajectory) if grips else ""
            mine = [g for g in left if g.gripper.arm_group == arm]
            left = [g for g in left if g not in mine]
            if mine and (reason := fingers_meanwhile(scene, mine, motion.trajectory)):
                return reason
        return fingers_meanwhile(scene, left) if left else ""


def _choices(draft: Draft, planning: Planning, stages: Sequence[Stage]) -> Iterator[tuple[Draft, ...]]:
    """One way of each stage, all from the same draft."""
    if not stages:
        yield ()
        return
    for way in planning.drafts(stages[0], draft):
        for others in _choices(draft, planning, stages[1:]):
            yield (way, *others)


def _both_allow(one: PlanningScene | None, other: PlanningScene | None) -> PlanningScene | None:
    """The scene that two motions are planned in, with the contacts of both."""
    if one is None or other is None:
        return one or other
    return replace(one, allowed_pairs={**one.allowed_pairs, **other.allowed_pairs})


def _end(step: Step) -> JointState:
    if isinstance(step, Motion):
        return step.trajectory.end
    assert isinstance(step, Grip)
    return finger_state(step.gripper, step.width)


def _group_of(scene: PlanningScene, trajectory: JointTrajectory) -> str:
    for group in scene.model.groups.values():
        if group.joint_names == trajectory.joint_names:
            return group.name
    raise UnknownNameError("group of joints", ", ".join(trajectory.joint_names), scene.model.groups)
