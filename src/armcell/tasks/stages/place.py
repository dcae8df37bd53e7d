"""Stages of placing: choose a placement with its straight way down, open."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from armcell.core import SE3, PlanResult
from armcell.grasping import RELEASE_GAP, Placement, hand_of, place_candidates, support_surface
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.search import Draft, Planning
from armcell.tasks.settings import Speed
from armcell.tasks.stages.grasp import finger_state, reachable
from armcell.tasks.stages.moves import straight
from armcell.tasks.steps import Expect, Grip, Motion, Release, Step, StillHeld, Watch
from armcell.timing import reversed_in_time

UPRIGHT = 0.99  # cosine of the angle between the side that shall be up and up
Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class ChoosePlacement:
    """Place candidates on a support that the arm reaches by a free straight line from above."""

    object: str
    support: str
    gripper: Gripper
    speed: Speed
    distance: float  # [m] of the way down
    at: tuple[float, float] | None = None
    up: Vector | None = None  # direction in the object's frame that shall be up; as it stands where None
    name: str = "placement"

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        scene = draft.scene
        item, support = scene.object(self.object), scene.object(self.support)
        candidates = place_candidates(item, support, self.at, other_sides=self.up is not None)
        if self.up is not None:
            up = np.asarray(self.up) / np.linalg.norm(self.up)
            candidates = [c for c in candidates if c.T_world_object.rotation.matrix[2] @ up > UPRIGHT]
            if not candidates:
                planning.reject(self.name, self.object, "it does not stand with that side up")
        for placement in candidates[: planning.settings.max_candidates]:
            yield from self._ways_down(draft, planning, placement)

    def _ways_down(self, draft: Draft, planning: Planning, placement: Placement) -> Iterator[Draft]:
        gripper = self.gripper
        T_tcp_object = draft.scene.frame_pose(gripper.tcp_link).inv() @ draft.scene.frame_pose(self.object)
        T_world_tcp = placement.T_world_object.shifted(z=RELEASE_GAP) @ T_tcp_object.inv()
        deep = self._hand_in_support(draft.scene, T_world_tcp)
        if deep > 0:  # said before any arm is asked
            text = f"the hand would be inside {self.support}: {deep * 1000:.0f} mm"
            planning.reject(self.name, placement.name, text)
            return
        scene = draft.scene.with_allowed(self.object, self.support)

        def up(at_place: PlanningScene) -> PlanResult:
            above = T_world_tcp.shifted(z=self.distance)
            return straight(at_place, gripper.arm_group, gripper.tcp_link, above, self.speed)

        yield from ways_down(
            draft, planning, scene, gripper, T_world_tcp, self.name, placement.name, up, placement=placement
        )

    def _hand_in_support(self, scene: PlanningScene, T_world_tcp: SE3) -> float:
        """How far [m] the hand's corners would be below the surface, where that is."""
        boxes = hand_of(scene.model, self.gripper).boxes
        low, high = boxes[:, :3], boxes[:, 3:]
        corners = np.concatenate([np.where(pick, high, low) for pick in np.ndindex(2, 2, 2)])
        frame, size_x, size_y = support_surface(scene.object(self.support))
        at = frame.inv().apply(T_world_tcp.apply(corners))
        above = np.all(np.abs(at[:, :2]) < np.array([size_x, size_y]) / 2, axis=1)
        return float(-at[above, 2].min()) if above.any() else 0.0


def ways_down(
    draft: Draft, planning: Planning, scene: PlanningScene, gripper: Gripper, T_world_tcp: SE3, stage: str,
    candidate: str, up: Callable[[PlanningScene], PlanResult], *steps: Step, **data: Any,
) -> Iterator[Draft]:  # fmt: skip
    """Ways to come down to a place, each ending in another arm state; what cannot be is rejected by reason.

    Args:
        scene: with the contacts of the place allowed.
        up: plans the way backwards, from the scene at the place.
        steps, data: for the drafts, besides `candidate`, `pre_place`, `lower` and `after_lower`.
    """
    for arm in reachable(scene, gripper, T_world_tcp, planning, stage, candidate):
        result = up(scene.with_state(arm))
        if not result.ok or result.trajectory is None:
            planning.reject("lower", candidate, result.message)
            continue
        lower = reversed_in_time(result.trajectory)
        yield draft.then(
            *steps,
            candidate=candidate,
            pre_place=lower.positions[0],
            lower=Motion("lower", lower, "cartesian", result.planning_time, result.min_clearance),
            after_lower=draft.scene.with_state(arm),
            **data,
        )


@dataclass(frozen=True, eq=False)
class Open:
    """Open wide enough to leave; the object belongs to the world again."""

    object: str
    support: str
    gripper: Gripper
    margin: float  # [m] wider than now
    settle: float
    name: str = "open"

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        joint = draft.scene.state[self.gripper.joint_name]
        width = min(self.gripper.width(joint) + self.margin, self.gripper.max_width)
        scene = draft.scene.with_detached(self.object).with_state(finger_state(self.gripper, width))
        yield draft.then(
            StillHeld(self.object, self.gripper),
            Grip("open", self.gripper, width, self.gripper.max_force, self.settle),
            Release(self.object),
            Watch(self.object, on=False),
            scene=scene,
        )


@dataclass(frozen=True, eq=False)
class ExpectSupport:
    """The object has come along; from here on it may touch its support."""

    object: str
    support: str
    gripper: Gripper
    name: str = "expect support"

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        yield draft.then(StillHeld(self.object, self.gripper), Expect(self.object, (self.support,)))
