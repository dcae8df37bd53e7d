"""Pick of one object by two arms, which approach both ends and close at the same time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from armcell.collision import neighbors
from armcell.collision.inter_arm_checker import InterArmChecker, without_arms
from armcell.core import (
    SE3,
    SO3,
    CartesianRequest,
    ErrorCode,
    JointGoal,
    JointState,
    JointTrajectory,
    Outcome,
    PlanResult,
)
from armcell.grasping import grip_force, pre_opening
from armcell.kinematics import ik_solver
from armcell.planning import CarriedObject, plan_cartesian
from armcell.scene import PlanningScene
from armcell.tasks.arms.coupled import move_together
from armcell.tasks.arms.hand_pair import HandPair, PairHold
from armcell.tasks.context import TaskContext
from armcell.tasks.pick import Pick
from armcell.tasks.search import PartialSolution, SearchState, Stage, search, stage_types
from armcell.tasks.stages import AppendPlannedMotion
from armcell.tasks.stages.grasp import finger_state
from armcell.tasks.steps import DONE, ExpectContact, perform_all
from armcell.timing import merge_trajectories, reverse_trajectory, synchronize_trajectories

GRASPS = 6  # grasps for which detours are searched if no straight path exists
OPEN_SETTLE = 0.3  # [s] pause after opening both hands


class PickWithTwoArms(Pick):
    """Pick recipe in which two arms grasp one object at the same time, each at one end. The recipe does not
    lift the object; `TwoArmCarry.move` does.

    Args:
        route: later poses of the object; grasps that cannot reach them are rejected.
    """

    def __init__(self, hands: HandPair, route: Sequence[SE3] = ()):
        super().__init__(f"grasp {hands.item} with both arms", partial(hands.ctx.emit, "note"))
        self._hands, self._route = hands, tuple(route)

    def plan(self) -> tuple[PartialSolution | None, Outcome]:
        hands, ctx = self._hands, self._hands.ctx
        budget = ctx.settings.planning_budget + hands.settings.planning_time
        settings = replace(ctx.settings, planning_budget=budget, planning_threads=1)
        planning = SearchState(settings, ctx.seed, ctx.cancel)
        stages: list[Stage] = [
            ChooseGraspPair(hands, self._route),
            ConnectPair(hands),
            AppendPlannedMotion("approach", "after_approach", "approach"),
            ClosePair(hands),
        ]
        solution = search(stages, PartialSolution(ctx.scene()), planning)
        if solution is not None:
            return solution, DONE
        why = planning.rejections.details[-1][2] if planning.rejections.details else "no grasp was tried"
        return None, Outcome(ErrorCode.PLANNING_FAILED, f"{self.label}: {why}")

    def perform(self, solution: PartialSolution) -> Outcome:
        return perform_all(self._hands.ctx, solution.steps)


@dataclass(frozen=True, eq=False)
class GraspPair:
    """Pair of grasps with which two arms hold an object at both ends, and the simultaneous straight
    approaches of the arms.
    """

    approaches: tuple[JointTrajectory, ...]  # by arm, of equal duration
    at_grasp: JointState  # of both arms
    Ts_object_tcp: Mapping[str, SE3]  # by arm group


@stage_types.register("choose_grasp_pair")
@dataclass(frozen=True, eq=False)
class ChooseGraspPair:
    """Stage of a two-arm pick that proposes pairs of grasps, one grasp at each end of the object. With each
    pair, the arms can carry the object along a route.

    Grasps with straight paths along the route come first, then grasps with detours around obstacles.
    """

    hands: HandPair
    route: tuple[SE3, ...] = ()
    name: str = "grasp"
    provides = ("grasp_pair", "supports", "approach", "after_approach")

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        scene, others = solution.scene, []
        for pair in self._pairs(scene, planning):
            ahead = self._along_route(scene, pair, 0.0) if self.route else None
            if ahead is None or ahead.ok:
                yield self._proposal(solution, pair)
                continue
            planning.reject(self.name, "", ahead.message)
            others.append(pair)
        end = time.monotonic() + self.hands.settings.planning_time
        others = others[:GRASPS]
        for k, pair in enumerate(others):
            seconds = (end - time.monotonic()) / (len(others) - k)
            if seconds <= 0 or planning.cancel.is_set():
                break
            ahead = self._along_route(scene, pair, seconds)
            if ahead.ok:
                yield self._proposal(solution, pair)
            else:
                planning.reject(self.name, "", ahead.message)

    def _proposal(self, solution: PartialSolution, pair: GraspPair) -> PartialSolution:
        hands = self.hands
        approach = _Approach(hands, merge_trajectories(*pair.approaches))
        widths = {g: _opening(hands, g) for g in hands.groups}
        return solution.then(
            _MoveFingers(hands, "open both", widths, OPEN_SETTLE), grasp_pair=pair,
            supports=tuple(neighbors(solution.scene, hands.item)), approach=approach,
            after_approach=solution.scene.with_state(pair.at_grasp),
        )  # fmt: skip

    def _along_route(self, scene: PlanningScene, pair: GraspPair, seconds: float) -> PlanResult:
        """Plan how two arms carry the picked object along a route,
        while they hold it with a given pair of grasps.
        """
        hands = self.hands
        trial = hands.attached(scene.with_state(pair.at_grasp))
        carried = CarriedObject(hands.item, dict(pair.Ts_object_tcp), hands.tips)
        start = scene.object(hands.item).T_world_object
        return hands.plan(trial, carried, start, self.route, seconds)

    def _pairs(self, scene: PlanningScene, planning: SearchState) -> Iterator[GraspPair]:
        """Yield simultaneous approaches of both arms for a two-arm pick,
        those nearest to the present state first.
        """
        hands, item = self.hands, scene.object(self.hands.item)
        options = {}
        for group in hands.groups:
            options[group] = list(self._approaches(scene, group, item.T_world_object))
            if not options[group]:
                planning.reject(self.name, group, f"{group} has no straight way to {hands.ends[group]!r}")
                return
        start = scene.state

        def far(pair: Sequence[tuple[JointTrajectory, SE3]]) -> float:
            return sum(
                float(np.abs(a.positions[0] - start.reindexed(a.joint_names).positions).max())
                for a, _ in pair
            )

        arms = InterArmChecker(scene, hands.groups)
        for pair in sorted(product(*options.values()), key=far):
            motions = synchronize_trajectories([trajectory for trajectory, _ in pair])
            if not arms.certify(motions[0], motions[1], clearance=0.01, evidence=False).free:
                planning.reject(self.name, "", "the hands come too near each other")
                continue
            state = motions[0].end.as_dict() | motions[1].end.as_dict()
            Ts = {g: T for g, (_, T) in zip(hands.groups, pair, strict=True)}
            yield GraspPair(tuple(motions), JointState.from_mapping(state), Ts)

    def _approaches(
        self, scene: PlanningScene, group: str, T_world_object: SE3
    ) -> Iterator[tuple[JointTrajectory, SE3]]:
        """Yield straight approaches with which one arm of a two-arm pick reaches its end of the object. Each
        approach is paired with its grasp pose T_object_tcp.
        """
        hands, gripper, s = self.hands, self.hands.grippers[group], self.hands.settings
        alone = without_arms(_with_open_hands(hands, scene), hands.other(group))
        alone = alone.with_allowed(hands.item, gripper.hand_links)
        ik = ik_solver(alone.model, group, gripper.tcp_link)
        for turn in (0.0, np.pi):
            T = scene.object(hands.item).subframes[hands.ends[group]] @ SE3(
                SO3.exp((0.0, 0.0, turn)), np.zeros(3)
            )
            target = T_world_object @ T
            for q in ik.nearest(target, alone.positions, among=8):
                at = alone.with_state(JointState(ik.joint_names, q))
                back = target @ SE3.from_xyz(0.0, 0.0, -s.approach)
                near = hands.ctx.settings.near
                result = plan_cartesian(
                    at, CartesianRequest(group, (back,), gripper.tcp_link, velocity_scaling=near.velocity,
                                         acceleration_scaling=near.acceleration),
                )  # fmt: skip
                if result.ok and result.trajectory is not None:
                    yield reverse_trajectory(result.trajectory), T


@stage_types.register("connect_pair")
@dataclass(frozen=True, eq=False)
class ConnectPair:
    """Stage of a two-arm pick that moves both arms to their pre-grasps.
    The motion is planned after the hands have opened.
    """

    hands: HandPair
    name: str = "both to the ends"
    requires = ("grasp_pair",)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        hands, pair = self.hands, solution.data["grasp_pair"]
        goals = {
            g: JointGoal(JointState(a.joint_names, a.positions[0]))
            for g, a in zip(hands.groups, pair.approaches, strict=True)
        }
        expected = (ExpectContact(hands.item, hands.grippers[g].contact_links) for g in hands.groups)
        yield solution.then(_MoveTogether(hands, goals, self.name), *expected)


@stage_types.register("close_pair")
@dataclass(frozen=True, eq=False)
class ClosePair:
    """Stage of a two-arm pick that closes both hands and then checks that they hold the object."""

    hands: HandPair
    name: str = "close"
    requires = ("grasp_pair", "supports")

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        hands = self.hands
        item = solution.scene.object(hands.item)
        closed = dict.fromkeys(hands.groups, 0.0)
        force = {g: grip_force(item, hands.grippers[g]) for g in hands.groups}
        yield solution.then(
            _MoveFingers(hands, "close both", closed, hands.settings.settle, force),
            _HoldWithBoth(hands, solution.data["grasp_pair"], solution.data["supports"]),
        )


# --- steps ---
@dataclass(frozen=True, eq=False)
class _MoveFingers:
    """Step of a two-arm pick that moves both grippers at the same time."""

    hands: HandPair
    name: str
    widths: Mapping[str, float]
    settle: float
    force: Mapping[str, float] | None = None

    def perform(self, ctx: TaskContext) -> Outcome:
        return self.hands.move_fingers(self.name, self.widths, self.settle, self.force)


@dataclass(frozen=True, eq=False)
class _MoveTogether:
    """Step of a two-arm pick that plans and executes a synchronized motion of both arms."""

    hands: HandPair
    goals: Mapping[str, JointGoal]
    name: str

    def perform(self, ctx: TaskContext) -> Outcome:
        return move_together(ctx, self.hands.both, self.goals, self.name)


@dataclass(frozen=True, eq=False)
class _Approach:
    """Step of a two-arm pick that moves both hands straight to their grasps."""

    hands: HandPair
    trajectory: JointTrajectory
    name: str = "approach both"

    def perform(self, ctx: TaskContext) -> Outcome:
        return self.hands.play(self.name, self.trajectory)


@dataclass(frozen=True, eq=False)
class _HoldWithBoth:
    """Step of a two-arm pick that checks that both hands hold the object,
    and records the poses of hands and object.
    """

    hands: HandPair
    pair: GraspPair
    supports: tuple[str, ...]

    def perform(self, ctx: TaskContext) -> Outcome:
        hands, driver = self.hands, ctx.driver
        for group in hands.groups:
            reading = driver.gripper(hands.grippers[group].name)
            if reading.held != hands.item:
                apart = 1000 * reading.width
                text = f"{group} has not grasped {hands.item}: its fingers are {apart:.0f} mm apart"
                return Outcome(ErrorCode.CONTROL_FAILED, f"{text}; {ctx.belief(hands.item)}")
        driver.watch_object(hands.item, self.supports)
        q = np.concatenate([a.positions[-1] for a in self.pair.approaches])
        order = [n for a in self.pair.approaches for n in a.joint_names]
        q = q[[order.index(n) for n in hands.names]]
        T_object = driver.object_poses()[hands.item]
        commanded, measured = hands.tcp_poses_at(q), hands.measured_tcp_poses()
        grasps = {g: T_object.inverse() @ commanded[g] for g in hands.groups}
        first, second = hands.first, hands.second
        hands.hold = PairHold(
            CarriedObject(hands.item, grasps, hands.tips), measured[first].inverse() @ measured[second],
            measured[first].inverse() @ T_object, self.supports, q,
        )  # fmt: skip
        ctx.emit("grasp", f"both hands hold {hands.item}")
        return DONE


def _with_open_hands(hands: HandPair, scene: PlanningScene) -> PlanningScene:
    for group, gripper in hands.grippers.items():
        scene = scene.with_state(finger_state(gripper, _opening(hands, group)))
    return scene


def _opening(hands: HandPair, group: str) -> float:
    """Return the width [m] to which one gripper opens in a two-arm pick,
    before it closes on its end of the object.
    """
    item, gripper = hands.ctx.scene().object(hands.item), hands.grippers[group]
    width = item.extent(item.subframes[hands.ends[group]].rotation.matrix[:, 1])
    return pre_opening(width, gripper)
