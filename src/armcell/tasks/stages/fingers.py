"""Gripper motions to a width, and collision checks of the moving fingers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import InputError, JointState, JointTrajectory
from armcell.core.checks import checked
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.search import PartialSolution, SearchState, stage_types
from armcell.tasks.stages.grasp import finger_state
from armcell.tasks.steps import CommandGripper, Motion, ParallelMotions, Step
from armcell.timing.chords import chords


@stage_types.register("move_gripper")
@dataclass(frozen=True, eq=False)
@checked()
class MoveGripper:
    """Stage that moves the fingers of a gripper to a width [m] while the arm rests.

    In a `Merger`, the arm may move meanwhile.
    """

    name: str
    gripper: Gripper
    width: float

    def __post_init__(self) -> None:
        if not 0 < self.width <= self.gripper.max_width + 1e-9:
            most = self.gripper.max_width * 1000
            text = f"width is {self.width * 1000:.1f} mm, it must be above 0 and at most {most:.1f} mm"
            raise InputError(text, element=self.name)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        grip = CommandGripper(self.name, self.gripper, self.width, self.gripper.max_force)
        if reason := finger_collision(solution.scene, [grip]):
            planning.reject(self.name, "", reason)
            return
        yield solution.then(grip, scene=solution.scene.with_state(finger_state(self.gripper, self.width)))


def opened_in_transit(scene: PlanningScene, steps: Sequence[Step]) -> tuple[Step, ...]:
    """Let fingers move while the arm moves. Each gripper motion directly before an arm motion becomes
    simultaneous with it, if no finger then touches anything. Return the steps of the task.

    Args:
        scene: at the start of the steps, with the present finger positions.
    """
    found: list[Step] = []
    for step in steps:
        grip = found[-1] if found else None
        if isinstance(step, Motion) and isinstance(grip, CommandGripper) and grip.width > 0:
            fingers = grip.gripper.joint_names
            now = JointState(fingers, scene.positions[scene.model.columns(fingers)])
            if not finger_collision((step.planned_in or scene).with_state(now), [grip], step.trajectory):
                found[-1] = ParallelMotions(step, (grip,))
                continue
        found.append(step)
    return tuple(found)


def finger_collision(
    scene: PlanningScene, grips: Sequence[CommandGripper], trajectory: JointTrajectory | None = None,
    padded: bool = False,
) -> str:  # fmt: skip
    """Describe a contact that gripper fingers may cause while they move to the given widths.
    The text is empty if there is none.

    The check holds for any finger speed and during an arm motion. If `padded`, the fingers also keep the
    scene's padding: the arm deviates slightly from its planned pose.

    Empty if the motion is certified collision-free.
    """
    grips = [g for g in grips if g.gripper.joint_name]
    if not grips:
        return ""
    names = tuple(g.gripper.joint_name for g in grips)
    columns = scene.model.columns(names)
    ends = np.array([scene.positions[columns], [g.gripper.joint_position(g.width) for g in grips]])
    middle, half = ends.mean(axis=0), np.abs(ends[1] - ends[0]) / 2
    if trajectory is None and len(grips) == 1:
        points, room, joints = ends, np.zeros(1), names
    elif trajectory is None:
        points, room, joints = middle[None], half, names
    else:
        _, arm, off = chords((trajectory,), (0.0,), 0.0, trajectory.duration)
        points = np.hstack([arm, np.tile(middle, (len(arm), 1))])
        room, joints = np.concatenate([off, half]), trajectory.joint_names + names
    proof = KernelChecker(scene, joints).certify(points, room, padded)
    if proof.free:
        return ""
    what = proof.contact.describe() if proof.contact else "no contact found"
    return f"not proven free while the fingers move: {what}"
