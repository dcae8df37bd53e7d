"""Stages of picking: choose a grasp by estimated reach time, approach straight, close the hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armcell.collision import ExactChecker
from armcell.core import SE3, JointState, PlanResult
from armcell.grasping import (
    Grasp,
    grasp_candidates,
    hand_of,
    openings,
    rejection_sort_key,
    surface_coverage,
    why_none,
)
from armcell.kinematics import IKSolver, ik_solver
from armcell.model import Gripper
from armcell.planning import synchronized_profile
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks.approach import Approach
from armcell.tasks.grasp_proof import GraspProof, distinct_grasps, prove_grasps
from armcell.tasks.search import PartialSolution, SearchState, stage_types
from armcell.tasks.settings import Speed
from armcell.tasks.stages.few_joints import grasps_in_reach, has_few_joints
from armcell.tasks.stages.moves import plan_straight, plan_within_reach, shifted
from armcell.tasks.steps import (
    CheckLift,
    CommandGripper,
    ConfirmGrasp,
    ExpectContact,
    WatchObject,
)
from armcell.tasks.task import holding_condition
from armcell.timing import reverse_trajectory

Array = NDArray[np.float64]

ALIKE = 0.02  # score difference below which grasps count as equally good
SOLUTIONS_PER_POSE = 3  # IK solutions tried per pose
APPROACH = ("grasp", "candidate", "pre_grasp", "approach", "after_approach")
"""Names that `approaches` provides to later stages."""
GraspFilter = Callable[[PlanningScene], Callable[[Grasp], str]]
"""Maps a scene to a function that returns why a grasp is unusable for later stages; empty if usable."""
SECONDS_BESIDES = 3.0  # [s] of a pick that do not depend on the grasp (approach and closing)


@dataclass(frozen=True, eq=False)
class ReachEstimate:
    """Estimate of how an arm reaches a grasp: its joint positions (n,) before the approach,
    and the travel time to them.

    The time ignores obstacles.
    """

    grasp: Grasp
    q: Array | None  # None: unreachable
    seconds: float  # [s]


@dataclass(frozen=True, eq=False)
class ReachEstimator:
    """Estimator of the time that an arm needs to reach grasps and placements, without regard to obstacles."""

    scene: PlanningScene
    gripper: Gripper
    distance: float  # [m] before the grasp, along its approach, where the motion ends
    seed: int = 0

    @property
    def ik(self) -> IKSolver:
        return ik_solver(self.scene.model, self.gripper.arm_group, self.gripper.tcp_link)

    def nearest_first(
        self, T_world_object: SE3, grasps: Sequence[Grasp], q: Array, speed: Speed
    ) -> list[ReachEstimate]:
        """Estimate the time in which the arm reaches each of the best grasps, which are of about equal
        quality. Return the estimates, shortest time first.

        On a cube, for example, the grasps on its four sides are equally good.

        Args:
            q: start positions (n,) of the arm.
        """
        found = []
        for grasp in grasps:
            if grasp.score <= grasps[0].score - ALIKE:
                break
            back = SE3.from_xyz(0.0, 0.0, -self.distance)
            at = self.ik_near(T_world_object @ grasp.T_object_tcp @ back, q)
            found.append(
                ReachEstimate(grasp, at, np.inf if at is None else round(self.seconds(q, at, speed), 3))
            )
        return sorted(found, key=lambda reach: reach.seconds)

    def ik_near(self, T_world_tcp: SE3, q: Array) -> Array | None:
        """Return joint positions (n,) near q (n,) with which the arm
        reaches the TCP pose of a grasp, or None.

        The result is None if the pose is unreachable.
        """
        reference = self.scene.positions.copy()
        reference[self.ik.columns] = q
        rng = np.random.default_rng(self.seed)
        return next(self.ik.solutions(T_world_tcp, reference, rng), None)

    def seconds(self, q: Array, to: Array, speed: Speed) -> float:
        """Return the minimum time [s] in which a straight joint-space motion can bring the arm to a grasp, at
        given fractions of its speed limits.
        """
        if not np.any(to != q):
            return 0.0
        model, names = self.scene.model, self.ik.joint_names
        acceleration = model.limits(names, "acceleration") * speed.acceleration
        velocity = model.limits(names, "velocity") * speed.velocity
        return synchronized_profile(to - q, velocity, acceleration, acceleration).duration


@stage_types.register("choose_grasp")
@dataclass(frozen=True, eq=False)
class ChooseGrasp:
    """Stage of a pick that proposes grasps, each with a collision-free straight approach. The stage plans the
    approach backward from the grasp.
    """

    object: str
    gripper: Gripper
    speed: Speed
    distance: float  # [m] of the approach
    excluded: tuple[str, ...] = ()
    wider: int = 1  # factor on the number of candidates if later stages reject many
    among: tuple[str, ...] = ()  # names of the allowed grasps; empty: all
    grasp_filter: GraspFilter | None = None  # applied before IK and proofs
    name: str = "grasp"
    provides = (*APPROACH, "proof")

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        item, s = solution.scene.object(self.object), planning.settings
        hand = hand_of(solution.scene.model, self.gripper)
        grasps, rejected = grasp_candidates(item, hand, pose_error=s.pose_error)
        covered = partial(surface_coverage, item, hand, pose_error=s.pose_error)
        none = "" if grasps else why_none(rejected, covered())
        grasps = [g for g in grasps if g.name not in self.excluded]
        if self.among:
            grasps, rejected = [g for g in grasps if g.name in self.among], []
        why_not = self.grasp_filter(solution.scene) if self.grasp_filter is not None else None
        if why_not is not None:  # before the proofs, which take longest
            grasps = self._sifted(planning, grasps, why_not)
        if has_few_joints(solution.scene.model, self.gripper):
            near = grasps_in_reach(
                solution.scene, self.gripper, item, grasps[: s.max_candidates * self.wider],
                s.max_candidates, partial(planning.reject, self.name), s.pose_error,
            )  # fmt: skip
            grasps = [g for g in near if g.name not in self.excluded]
        proofs: dict[str, GraspProof] = {}
        if s.prove_grasps and grasps:
            grasps, proofs = self._proven(solution, planning, item, grasps)
        else:
            reaching = ReachEstimator(solution.scene, self.gripper, self.distance, planning.seed)
            q = solution.scene.positions[reaching.ik.columns]
            near = reaching.nearest_first(item.T_world_object, grasps, q, s.free)
            grasps[: len(near)] = [reach.grasp for reach in near]
        if why_not is not None and proofs:  # last: grasps that fail later if the object turns in the hand
            grasps.sort(key=lambda g: any(why_not(turned) for turned in _turned(proofs[g.name])))
        for grasp in grasps[: s.max_candidates * self.wider]:
            yield from self._approaches(solution, planning, grasp, proofs.get(grasp.name))
        if none and not rejected:
            planning.reject(self.name, "", none)
        for rejection in sorted(
            rejected, key=rejection_sort_key
        ):  # after the candidates that passed more tests
            planning.reject(self.name, rejection.name, rejection.reason + (f" ({none})" if none else ""))
            none = ""

    def _sifted(
        self, planning: SearchState, grasps: list[Grasp], why_not: Callable[[Grasp], str]
    ) -> list[Grasp]:
        kept = []
        for grasp in grasps:
            if reason := why_not(grasp):
                planning.reject(self.name, grasp.name, reason)
            else:
                kept.append(grasp)
        return kept

    def _proven(
        self, solution: PartialSolution, planning: SearchState, item: CollisionObject, grasps: list[Grasp]
    ) -> tuple[list[Grasp], dict[str, GraspProof]]:
        """Return, for the stage that chooses a grasp, the reachable grasps with their proofs of success in
        the physics simulation, best first.

        The order is by P(success) x reachability / time.
        """
        s, model, gripper = planning.settings, solution.scene.model, self.gripper
        worth: dict[str, float] = {}
        reached = []
        for grasp in distinct_grasps(grasps, 3 * s.prove_grasps):
            for opened in openings(grasp, gripper):
                fingers = solution.scene.with_state(finger_state(gripper, opened.opening))
                scene = fingers.with_allowed(self.object, gripper.hand_links)
                T_world_tcp = item.T_world_object @ opened.T_object_tcp
                arms = list(reachable(scene, gripper, T_world_tcp, planning, self.name, grasp.name))
                if arms:
                    seconds = min(_seconds(scene, arm) / self.speed.velocity for arm in arms)
                    worth[grasp.name] = len(arms) / SOLUTIONS_PER_POSE / (SECONDS_BESIDES + seconds)
                    reached.append(opened)
                    break
            if len(reached) == s.prove_grasps:
                break
        proofs = {p.grasp.name: p for p in prove_grasps(model, gripper, item, reached, s.proof_trials)}
        reached.sort(key=lambda g: -proofs[g.name].probability * worth[g.name])
        return reached, proofs

    def _approaches(
        self, solution: PartialSolution, planning: SearchState, grasp: Grasp, proof: GraspProof | None
    ) -> Iterator[PartialSolution]:
        def back(at_grasp: PlanningScene, T_world_tcp: SE3) -> PlanResult:
            over = partial(self._backward, at_grasp, T_world_tcp)
            return plan_within_reach(over, self.distance, planning.settings.least_approach, True)

        for opened in openings(grasp, self.gripper):
            fits = False
            for found in approaches(solution, planning, self.name, self.object, self.gripper, opened, back):
                fits = True
                yield found.then(proof=proof)
            if fits:
                return

    def _backward(self, at_grasp: PlanningScene, T_world_tcp: SE3, distance: float) -> PlanResult:
        back = shifted(T_world_tcp, (0.0, 0.0, -distance), in_own_frame=True)
        return plan_straight(at_grasp, self.gripper.arm_group, self.gripper.tcp_link, back, self.speed)


def approaches(
    solution: PartialSolution, planning: SearchState, stage: str, item: str, gripper: Gripper, grasp: Grasp,
    back: Callable[[PlanningScene, SE3], PlanResult],
) -> Iterator[PartialSolution]:  # fmt: skip
    """Yield partial solutions of a pick that approach a grasp in a straight line, one for each arm state that
    reaches the grasp.

    Arm states without an approach are rejected with a reason.

    Args:
        back: plans the approach backward, from (the scene at the grasp, T_world_tcp).
    """
    opened = solution.scene.with_state(finger_state(gripper, grasp.opening))
    scene = opened.with_allowed(item, gripper.hand_links)
    T_world_tcp = scene.object(item).T_world_object @ grasp.T_object_tcp
    expected = (
        () if scene.object(item).has_cloud else (ExpectContact(item, gripper.contact_links),)
    )  # clouds have no body
    found = False
    for arm in reachable(scene, gripper, T_world_tcp, planning, stage, grasp.name):
        at_grasp = scene.with_state(arm)
        result = back(at_grasp, T_world_tcp)
        if not result.ok or result.trajectory is None:
            planning.reject("approach", grasp.name, result.message)
            continue
        found = True
        approach = reverse_trajectory(result.trajectory)
        yield solution.then(
            CommandGripper("open", gripper, grasp.opening, gripper.max_force),
            *expected,
            scene=opened,
            grasp=grasp,
            candidate=grasp.name,
            pre_grasp=approach.positions[0],
            approach=Approach(
                "approach",
                approach,
                "cartesian",
                result.planning_time,
                result.min_clearance,
                scene,
                {"planned": "backwards", **result.evidence},
                object=item,
                gripper=None if scene.object(item).has_cloud else gripper,
                grasp=grasp,
            ),
            after_approach=at_grasp,
        )
    if found:
        planning.reject(stage, grasp.name, "no complete plan with this grasp")


@stage_types.register("append_planned_motion")
@dataclass(frozen=True, eq=False)
class AppendPlannedMotion:
    """Stage that appends a motion from an earlier stage without planning again, for example the approach that
    the choice of a grasp has already found.

    The motion is `data[motion]`; it leads to the scene `data[scene]`.
    """

    motion: str
    scene: str
    name: str = "planned"

    @property
    def requires(self) -> tuple[str, ...]:
        return self.motion, self.scene

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        yield solution.then(solution.data[self.motion], scene=solution.data[self.scene])


@stage_types.register("close")
@dataclass(frozen=True, eq=False)
class Close:
    """Stage of a pick that closes the hand on the object and attaches the object to the hand.

    The object may then leave its supports.
    """

    object: str
    gripper: Gripper
    supports: tuple[str, ...]
    settle: float
    name: str = "close"
    requires = ("grasp",)

    @property
    def provides(self) -> tuple[str, ...]:
        return (holding_condition(self.object),)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        grasp: Grasp = solution.data["grasp"]
        scene = solution.scene.with_state(finger_state(self.gripper, grasp.width))
        scene = scene.with_attached(self.object, self.gripper.tcp_link, self.gripper.hand_links)
        yield solution.then(
            CommandGripper("close", self.gripper, 0.0, grasp.force, self.settle),
            ConfirmGrasp(self.object, self.gripper, grasp.width),
            WatchObject(self.object, self.supports),
            scene=scene,
        )


@stage_types.register("check_lift")
@dataclass(frozen=True, eq=False)
class LiftCheck:
    """Stage of a pick that checks, after the lift, that the object has risen with the hand."""

    object: str
    gripper: Gripper
    supports: tuple[str, ...]  # from here on, contact with them is unexpected
    height_before: float  # [m] height of the object's origin before the lift
    name: str = "check grasp"

    @property
    def requires(self) -> tuple[str, ...]:
        return (holding_condition(self.object),)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        rise = float(solution.scene.frame_pose(self.object).translation[2]) - self.height_before
        yield solution.then(
            CheckLift(self.object, self.gripper, self.height_before, rise),
            ExpectContact(self.object, self.supports, expected=False),
        )


def _turned(proof: GraspProof) -> Iterator[Grasp]:
    """Yield, for the choice of a grasp, two variants in which the object has rotated between the finger pads,
    one in each direction.

    The angle is the median rotation of the object in the simulated trials of this grasp.
    """
    T = proof.grasp.T_object_tcp
    for angle in (-proof.turn, proof.turn):
        turn = SE3.from_xyz_rpy((0.0, 0.0, 0.0), (0.0, angle, 0.0))
        yield replace(proof.grasp, T_object_tcp=T @ turn)


def _seconds(scene: PlanningScene, arm: JointState) -> float:
    """Return the minimum time [s] in which the arm can reach its
    state at a grasp if obstacles are ignored.
    """
    columns = scene.model.columns(arm.joint_names)
    distance = np.abs(arm.positions - scene.positions[columns])
    return float(np.max(distance / scene.model.limits(arm.joint_names, "velocity")))


def finger_state(gripper: Gripper, width: float) -> JointState:
    return JointState(gripper.joint_names, np.full(len(gripper.joint_names), gripper.joint_position(width)))


def reachable(
    scene: PlanningScene,
    gripper: Gripper,
    T_world_tcp: SE3,
    planning: SearchState,
    stage: str,
    candidate: str,
) -> Iterator[JointState]:
    """Yield collision-free arm states that put the TCP at a grasp pose.
    States in collision are rejected with a reason.
    """
    ik = ik_solver(scene.model, gripper.arm_group, gripper.tcp_link)
    checker = ExactChecker(scene, ik.joint_names)
    rng = np.random.default_rng(planning.seed)
    best, good = None, 0
    for q in ik.solutions(T_world_tcp, scene.positions, rng):
        contacts = checker.contacts(q, padded=False)
        if contacts:
            best = best or contacts
            continue
        good += 1
        yield JointState(ik.joint_names, q)
        if good >= SOLUTIONS_PER_POSE:
            return
    if good == 0:
        reason = "in collision: " + "; ".join(c.describe() for c in best[:2]) if best else "out of reach"
        planning.reject(stage, candidate, reason)
