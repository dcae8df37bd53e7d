"""Stages of placing: choose a placement with its straight descent, then open the hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from armcell.collision import ExactChecker
from armcell.core import SE3, PlanResult
from armcell.grasping import (
    RELEASE_GAP,
    Grasp,
    Hand,
    Placement,
    hand_of,
    place_candidates,
    support_surface,
)
from armcell.model import Gripper
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks.search import PartialSolution, SearchState, stage_types
from armcell.tasks.settings import Speed
from armcell.tasks.stages.few_joints import (
    TILT,
    has_few_joints,
    independent_joints,
    placements_in_reach,
)
from armcell.tasks.stages.grasp import finger_state, reachable
from armcell.tasks.stages.moves import plan_straight, plan_within_reach
from armcell.tasks.steps import (
    CheckStillHeld,
    CommandGripper,
    ExpectContact,
    Motion,
    Release,
    Step,
    WatchObject,
)
from armcell.tasks.task import holding_condition
from armcell.timing import reverse_trajectory

UP = (0.0, 0.0, 1.0)
IK_OFF = 1e-4  # [m] tolerance of the IK solution
FINGER_GAP = 0.003  # [m] between an open finger and the other sides of a released object
NO_SIDE = "it does not stand with that side up"
DESCENT = ("candidate", "pre_place", "lower", "after_lower")
"""Names that `descents` provides to later stages."""

Vector = tuple[float, float, float]


@stage_types.register("choose_placement")
@dataclass(frozen=True, eq=False)
class ChoosePlacement:
    """Stage that proposes placements of the held object, each with a collision-free straight descent of the
    arm.

    The descent follows the surface normal, or the vertical if that is impossible.
    """

    object: str
    support: str
    gripper: Gripper
    speed: Speed
    distance: float  # [m] length of the descent
    at: tuple[float, float] | None = None
    up: Vector | None = (
        None  # direction in the object's frame that must point up; None: keep the present side
    )
    among: tuple[Placement, ...] = ()  # the allowed placements; empty: all
    name: str = "placement"
    provides = (*DESCENT, "placement")

    @property
    def requires(self) -> tuple[str, ...]:
        return (holding_condition(self.object),)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        scene = solution.scene
        candidates = self._candidates(scene)
        if not candidates:
            planning.reject(self.name, self.object, NO_SIDE)
        for placement in candidates[: planning.settings.max_candidates]:
            reached = False
            for reaching in self._descents(solution, planning, placement):
                reached = True
                yield reaching
            if not reached and has_few_joints(scene.model, self.gripper):
                yield from self._turned(solution, planning, placement)

    def _turned(
        self, solution: PartialSolution, planning: SearchState, placement: Placement
    ) -> Iterator[PartialSolution]:
        """Yield placing solutions for an arm with few joints: turn a placement until the arm can reach it,
        then add a descent. A placement that the user has given turns by at most `TILT`.
        """
        scene = solution.scene
        item, support = scene.object(self.object), scene.object(self.support)
        for other, released, angle in placements_in_reach(scene, self.gripper, item, support, placement):
            if self.among and abs(angle) > TILT:
                joints = independent_joints(scene.model, self.gripper)
                text = f"with {joints} joints, in reach only with the object turned by"
                planning.reject(self.name, placement.name, f"{text} {np.rad2deg(angle):.0f} deg")
                continue
            yield from self._descents(solution, planning, other, released)

    def _candidates(self, scene: PlanningScene) -> Sequence[Placement]:
        item, support = scene.object(self.object), scene.object(self.support)
        return self.among or place_candidates(item, support, self.at, up=self.up)

    def why_not(self, scene: PlanningScene, most: int) -> Callable[[Grasp], str]:
        """Return a test that rejects grasps with which the hand would
        intersect the support when it places the object.

        Args:
            scene: the scene before the grasp, with the object's present orientation.
            most: number of placements that the test considers.
        """
        hand, places = hand_of(scene.model, self.gripper), self._candidates(scene)[:most]
        surfaces = [surface_of_place(scene.object(self.support), place) for place in places]

        def ask(grasp: Grasp) -> str:
            least = np.inf
            for place, surface in zip(places, surfaces, strict=True):
                T_world_tcp = place.above(RELEASE_GAP) @ grasp.T_object_tcp
                least = min(least, hand_in_support(hand, T_world_tcp, surface))
                if least <= IK_OFF:
                    return ""
            return f"the hand would be inside {self.support}: {least * 1000:.0f} mm" if places else NO_SIDE

        return ask

    def _descents(
        self, solution: PartialSolution, planning: SearchState, placement: Placement,
        released: SE3 | None = None,
    ) -> Iterator[PartialSolution]:  # fmt: skip
        """Yield solutions with a straight descent to a placement.

        Args:
            released: T_world_object at which the hand opens; default: a little above the placement.
        """
        gripper = self.gripper
        T_tcp_object = solution.scene.frame_pose(gripper.tcp_link).inverse() @ solution.scene.frame_pose(
            self.object
        )
        T_world_object = placement.above(RELEASE_GAP) if released is None else released
        T_world_tcp = T_world_object @ T_tcp_object.inverse()
        surface = surface_of_place(solution.scene.object(self.support), placement)
        deep = hand_in_support(hand_of(solution.scene.model, gripper), T_world_tcp, surface)
        if deep > 0:  # tested before IK
            text = f"the hand would be inside {self.support}: {deep * 1000:.0f} mm"
            planning.reject(self.name, placement.name, text)
            return
        scene = solution.scene.with_allowed(self.object, self.support)

        def up(at_place: PlanningScene) -> PlanResult:
            result = off(at_place, placement.normal)
            return result if result.ok or placement.normal == UP else off(at_place, UP)

        def off(at_place: PlanningScene, direction: Vector) -> PlanResult:
            def over(length: float) -> PlanResult:
                x, y, z = (length * w for w in direction)
                above = T_world_tcp.shifted(x, y, z)
                return plan_straight(at_place, gripper.arm_group, gripper.tcp_link, above, self.speed)

            return plan_within_reach(over, self.distance, planning.settings.least_approach)

        yield from descents(
            solution,
            planning,
            scene,
            gripper,
            T_world_tcp,
            self.name,
            placement.name,
            up,
            placement=placement,
        )


Surface = tuple[SE3, float, float]
"""Frame (z along the normal) and size x, y [m] of a support surface."""


def surface_of_place(support: CollisionObject, placement: Placement) -> Surface:
    """Return the surface of the support on which the stage places the object."""
    return support_surface(support, float(np.arccos(min(placement.normal[2], 1.0))) + 1e-6)


def hand_in_support(hand: Hand, T_world_tcp: SE3, surface: Surface) -> float:
    """Return how deep [m] the lowest corner of the hand is below the surface on which it places an object.
    The value is zero or negative if no corner is below.
    """
    low, high = hand.boxes[:, :3], hand.boxes[:, 3:]
    corners = np.concatenate([np.where(pick, high, low) for pick in np.ndindex(2, 2, 2)])
    frame, size_x, size_y = surface
    at = frame.inverse().apply(T_world_tcp.apply(corners))
    above = np.all(np.abs(at[:, :2]) < np.array([size_x, size_y]) / 2, axis=1)
    return float(-at[above, 2].min()) if above.any() else 0.0


def descents(
    solution: PartialSolution,
    planning: SearchState,
    scene: PlanningScene,
    gripper: Gripper,
    T_world_tcp: SE3,
    stage: str,
    candidate: str,
    up: Callable[[PlanningScene], PlanResult],
    *steps: Step,
    **data: Any,
) -> Iterator[PartialSolution]:
    """Yield solutions for placing an object by a straight descent,
    one for each arm state that reaches the placement.

    Arm states without a descent are rejected with a reason.

    Args:
        scene: the scene with the contacts of the placement allowed.
        up: plans the descent backward, from the scene at the placement.
        steps, data: additions to the solutions, besides `candidate`, `pre_place`, `lower` and `after_lower`.
    """
    for arm in reachable(scene, gripper, T_world_tcp, planning, stage, candidate):
        result = up(scene.with_state(arm))
        if not result.ok or result.trajectory is None:
            planning.reject("lower", candidate, result.message)
            continue
        lower = reverse_trajectory(result.trajectory)
        yield solution.then(
            *steps,
            candidate=candidate,
            pre_place=lower.positions[0],
            lower=Motion(
                "lower",
                lower,
                "cartesian",
                result.planning_time,
                result.min_clearance,
                scene,
                {"planned": "backwards", **result.evidence},
            ),
            after_lower=solution.scene.with_state(arm),
            **data,
        )


@stage_types.register("open")
@dataclass(frozen=True, eq=False)
class OpenHand:
    """Stage that opens the hand after placing an object, wide enough to retreat, and detaches the object."""

    object: str
    support: str
    gripper: Gripper
    margin: float  # [m] wider than now, if there is space
    settle: float
    name: str = "open"

    @property
    def requires(self) -> tuple[str, ...]:
        return (holding_condition(self.object),)

    @property
    def consumes(self) -> tuple[str, ...]:
        return (holding_condition(self.object),)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        now = self.gripper.width_in(solution.scene.state)
        detached = solution.scene.with_detached(self.object)
        widths = [min(now + share * self.margin, self.gripper.max_width) for share in (1.0, 0.5, 0.25)]
        for width in dict.fromkeys(widths):  # less if a finger would collide
            opened = detached.with_state(finger_state(self.gripper, width))
            if width > widths[-1] and self._fingers_touch(opened):
                continue
            yield solution.then(
                CheckStillHeld(self.object, self.gripper),
                CommandGripper("open", self.gripper, width, self.gripper.max_force, self.settle),
                Release(self.object),
                WatchObject(self.object, on=False),
                scene=opened,
            )

    def _fingers_touch(self, scene: PlanningScene) -> bool:
        """Return whether an open finger would touch another part of the placed object, such as the opposite
        side of a ring.
        """
        checker = ExactChecker(scene, self.gripper.joint_names)
        checker.set_configuration(scene.positions[checker.columns])
        bodies = [geometry.body for geometry in checker.geometries]
        pairs = [(a, b) for a, b in checker.pairs.tolist() if self.object in (bodies[a], bodies[b])]
        near = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        near = near[checker.pair_gaps(near) < FINGER_GAP] if len(near) else near
        return any(checker.pair_distance(a, b) < FINGER_GAP for a, b in near.tolist())


@stage_types.register("expect_support")
@dataclass(frozen=True, eq=False)
class ExpectSupport:
    """Stage that prepares the placing of an object: it checks that the hand holds the object,
    and allows contact with the support.
    """

    object: str
    support: str
    gripper: Gripper
    name: str = "expect support"

    @property
    def requires(self) -> tuple[str, ...]:
        return (holding_condition(self.object),)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        yield solution.then(
            CheckStillHeld(self.object, self.gripper), ExpectContact(self.object, (self.support,))
        )
