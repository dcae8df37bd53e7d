"""Fingers that move to a width, and what they would touch on the way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import InputError, JointTrajectory
from armcell.core.checks import checked
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.search import Draft, Planning
from armcell.tasks.stages.grasp import finger_state
from armcell.tasks.steps import Grip
from armcell.timing.chords import chords


@dataclass(frozen=True, eq=False)
@checked()
class MoveGripper:
    """Drive a gripper to a width [m], the arm at rest (or moving: in a `Merger`)."""

    name: str
    gripper: Gripper
    width: float

    def __post_init__(self) -> None:
        if not 0 < self.width <= self.gripper.max_width + 1e-9:
            most = self.gripper.max_width * 1000
            text = f"width is {self.width * 1000:.1f} mm, it must be above 0 and at most {most:.1f} mm"
            raise InputError(text, element=self.name)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        grip = Grip(self.name, self.gripper, self.width, self.gripper.max_force)
        if reason := fingers_meanwhile(draft.scene, [grip]):
            planning.reject(self.name, "", reason)
            return
        yield draft.then(grip, scene=draft.scene.with_state(finger_state(self.gripper, self.width)))


def fingers_meanwhile(
    scene: PlanningScene, grips: Sequence[Grip], trajectory: JointTrajectory | None = None
) -> str:
    """What fingers would touch on the way to their widths while the arm moves, whenever they get there.

    Empty where it is proven that they touch nothing.
    """
    names = tuple(g.gripper.joint_name for g in grips)
    columns = scene.model.columns(names)
    ends = np.array([scene.positions[columns], [g.gripper.joint_position(g.width) for g in grips]])
    middle, half = ends.mean(axis=0), np.abs(ends[1] - ends[0]) / 2
    if trajectory is None:
        points, room, joints = middle[None], half, names
    else:
        _, arm, off = chords((trajectory,), (0.0,), 0.0, trajectory.duration)
        points = np.hstack([arm, np.tile(middle, (len(arm), 1))])
        room, joints = np.concatenate([off, half]), trajectory.joint_names + names
    proof = KernelChecker(scene.with_padding(0.0), joints).certify(points, room)
    if proof.free:
        return ""
    what = proof.contact.describe() if proof.contact else "no more is known"
    return f"not proven free while the fingers move: {what}"
