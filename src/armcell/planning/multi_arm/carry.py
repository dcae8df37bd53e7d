"""Planning of an object's motion that two arms carry together with fixed grasps.

Inverse kinematics of both arms along the object path stays on one branch, so the relative pose of the hands
equals the relative pose of the grasps at every instant; one time law moves the object from rest to rest
between its waypoints. If the straight path is blocked, an object pose search finds a detour (see
`closed_chain`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count, pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import certify_from_rest
from armcell.core import SE3, ErrorCode, InputError, JointPath, JointTrajectory, PlanResult
from armcell.planning.multi_arm.closed_chain import (
    CarriedObject,
    ClosedChainFailure,
    ClosedChainIK,
    ObjectPoseSearch,
    SearchLimits,
)
from armcell.planning.multi_arm.object_paths import (
    ObjectPath,
    RoundedObjectPath,
    StraightObjectPath,
    derivatives,
    time_law,
)
from armcell.scene import PlanningScene
from armcell.timing import concatenate_trajectories, slow_down
from armcell.timing.chords import chords

Array = NDArray[np.float64]

STEP, TURN = 0.01, 0.02  # [m] and [rad] of the object between two solutions of the inverse kinematics
PADDING = 0.01  # [m] padding of a detour, if its ends allow it and the scene has no larger padding
LIFTS = (0.02, 0.05, 0.1)  # [m] lift heights off the supports before a detour
ROOM_ENOUGH = 0.8  # sufficient share of the largest clearance among the lift heights
SPACINGS = (
    0.25,
    0.16,
    0.1,
    0.06,
    0.03,
)  # [m] spacings of rounded paths; the first free one is used
POSTURES = 4  # joint solutions tried at the end of a detour


@dataclass(frozen=True, eq=False)
class CarrySegment:
    """Planned segment of a two-arm carry: a timed motion of both arms from rest to rest, along one path of
    the carried object.
    """

    trajectory: JointTrajectory
    path: Array  # (k, n) joint positions at evenly spaced shares of the path
    end: Array  # (dof,) positions of all joints


@dataclass(frozen=True, eq=False)
class BlockedSegment:
    """Reason why the planned carry of two arms is blocked on an object path: text, evidence and
    error code.
    """

    text: str
    evidence: dict[str, Any] = field(default_factory=dict)
    code: ErrorCode = ErrorCode.PLANNING_FAILED


def plan_carry(
    scene: PlanningScene,
    both: str,
    carried: CarriedObject,
    start: SE3,
    poses: Sequence[SE3],
    velocity_scaling: float = 0.3,
    acceleration_scaling: float = 0.2,
    max_speed: float = 0.25,
    rests_on: Sequence[str] = (),
    planning_time: float = 10.0,
    seed: int = 0,
    cancel: threading.Event | None = None,
) -> PlanResult:
    """Plan how two arms carry an object through several poses, with a stop at each pose.

    Args:
        scene: scene with the arms at the start of the motion and the object attached to one of them; the
            object must be allowed to touch the other hand and its supports.
        both: group of both arms' joints.
        start: T_world_object at the start of the motion.
        poses: target poses of the object; the object moves straight with even rotation if this path is free,
            otherwise by a detour.
        max_speed: speed limit of the object [m/s].
        rests_on: supports that the object may touch at its start and end, but not on a detour.
        planning_time: time for all detours together [s]; 0: only straight paths.
    Returns:
        SUCCESS with the trajectory; `evidence["ways"]` lists "straight" or "round" for each pose. On failure
        the obstacle: TIMED_OUT if no detour was found in time, PREEMPTED if planning was canceled.
    Raises:
        InputError: no pose, scalings outside (0, 1], a speed that is not positive, a negative time.
    """
    began = time.monotonic()
    if not poses:
        raise InputError("a carried object needs a pose to go to")
    for what, value in (("velocity", velocity_scaling), ("acceleration", acceleration_scaling)):
        if not 0 < value <= 1:
            raise InputError(f"{what} scaling is {value:g}, it must be in (0, 1]")
    if not max_speed > 0:
        raise InputError(f"max_speed is {max_speed:g} m/s, it must be positive")
    if not (np.isfinite(planning_time) and planning_time >= 0):
        raise InputError(f"planning_time is {planning_time:g} s, it must be at least 0")
    names = scene.model.group(both).joint_names
    limits = [
        scene.model.limits(names, kind) * share
        for kind, share in (("velocity", velocity_scaling), ("acceleration", acceleration_scaling))
    ]
    builder = _SegmentBuilder(scene, names, ClosedChainIK(scene, carried), limits[0], limits[1], max_speed)
    stop = SearchLimits(began + planning_time, cancel or threading.Event())
    segments: list[CarrySegment] = []
    ways: list[str] = []
    poses_tried = 0
    for k, (a, b) in enumerate(pairwise((start, *poses))):
        q = segments[-1].end if segments else scene.positions
        made = builder.build(StraightObjectPath(a, b), q, builder.checker, evidence=True)
        ways.append("straight" if isinstance(made, CarrySegment) else "round")
        if isinstance(made, BlockedSegment) and planning_time > 0:
            made, poses_seen = _DetourPlanner(builder, scene, carried, rests_on, stop).plan(
                a, b, q, made, (seed, k)
            )
            poses_tried += poses_seen
        if isinstance(made, BlockedSegment):
            text = f"on the way to pose {k + 1} of {len(poses)}: {made.text}"
            return PlanResult(
                made.code, text, made.evidence, planner_id="carry", planning_time=time.monotonic() - began
            )
        segments += [made] if isinstance(made, CarrySegment) else made
    trajectory = concatenate_trajectories(*(segment.trajectory for segment in segments))
    points = chords((trajectory,), (0.0,), 0.0, trajectory.duration)[1]
    return PlanResult(
        ErrorCode.SUCCESS, evidence={"ways": tuple(ways), "poses_looked_at": poses_tried},
        path=JointPath(names, np.vstack([segment.path for segment in segments])), trajectory=trajectory,
        planner_id="carry", planning_time=time.monotonic() - began,
        clearance=lambda: builder.checker.clearance(points),
    )  # fmt: skip


class _SegmentBuilder:
    """Builder for the motions of a two-arm carry: it certifies and times the motion of both arms along a path
    of the object.

    Attributes:
        checker: checker of the given scene.
    """

    def __init__(
        self, scene: PlanningScene, names: tuple[str, ...], hands: ClosedChainIK, velocity: Array,
        acceleration: Array, max_speed: float,
    ):  # fmt: skip
        self.names, self.hands, self.max_speed = names, hands, max_speed
        self.velocity, self.acceleration = velocity, acceleration
        self.checker = KernelChecker(scene, names)

    def build(
        self, way: ObjectPath, q: Array, checker: KernelChecker, padded: bool = False, evidence: bool = False
    ) -> CarrySegment | BlockedSegment:
        """Compute a timed, certified motion of two arms that carry an object along a path. The arms start
        from joint positions q (dof,).

        Args:
            padded: also keep the checker's padding.
            evidence: report the contact that blocks the path.
        """
        found = self.along(way, q)
        if isinstance(found, ClosedChainFailure):
            return BlockedSegment(str(found))
        path = found[:, checker.columns]
        if (
            isinstance(way, RoundedObjectPath)
            and not checker.certify(path, padded=padded, evidence=False).free
        ):
            return BlockedSegment("the rounded path is not free")  # checked before the fine computation
        times, shares = time_law(path, way, self.velocity, self.acceleration, self.max_speed)
        exact = self.hands.solve_path(way.poses(shares), shares, q)
        if isinstance(exact, ClosedChainFailure):
            return BlockedSegment(str(exact))
        values = exact[:, checker.columns]
        velocities, accelerations = derivatives(times, values)
        over = float(
            np.max(np.abs(velocities) / self.velocity)
        )  # curvature between the samples of the time law
        over = max(over, float(np.sqrt(np.max(np.abs(accelerations) / self.acceleration))), 1.0)
        trajectory = slow_down(JointTrajectory(self.names, times, values, velocities, accelerations), over)
        _, points, room = chords((trajectory,), (0.0,), 0.0, trajectory.duration)
        if padded:
            proof = checker.certify(points, room, padded=True, evidence=evidence)
        else:
            proof = certify_from_rest(checker, points, room, evidence=evidence)
        if not proof.free:
            what = "" if proof.contact is None else f": {proof.contact.describe()}"
            contacts = {"contacts": [proof.contact] if proof.contact else []}
            return BlockedSegment(f"the path is blocked at {100 * proof.at:.0f} %{what}", contacts)
        return CarrySegment(trajectory, path, exact[-1])

    def along(self, way: ObjectPath, q: Array) -> Array | ClosedChainFailure:
        """Compute the joint positions (k, dof) of two arms that carry an object, at even steps along its
        path.
        """
        steps = max(int(np.ceil(max(way.meters / STEP, way.radians / TURN))), 4)
        shares = np.linspace(0, 1, steps + 1)
        return self.hands.solve_path(way.poses(shares), shares, q)


class _DetourPlanner:
    """Planner for a detour on which two arms carry an object to its next pose: they lift the object, go
    around the obstacle, and set the object down.
    """

    def __init__(
        self,
        builder: _SegmentBuilder,
        scene: PlanningScene,
        carried: CarriedObject,
        rests_on: Sequence[str],
        limits: SearchLimits,
    ):
        strict = scene.with_allowed(carried.name, tuple(rests_on), allow=False) if rests_on else scene
        strict = strict.with_padding(max(scene.padding, PADDING))
        self.builder, self.hands, self.limits = builder, builder.hands, limits
        self.checker = KernelChecker(strict, builder.names)
        self.columns = self.checker.columns

    def plan(
        self, a: SE3, b: SE3, q: Array, blocked: BlockedSegment, seed: tuple[int, int]
    ) -> tuple[list[CarrySegment] | BlockedSegment, int]:
        """Plan the segments of a detour on which two arms, starting from joints q, carry an object from pose
        a to pose b.

        Return the segments, or the reason why there are none, and the number of poses tried.
        """
        ends = self._ends(a, b, q)
        if isinstance(ends, BlockedSegment):
            return BlockedSegment(f"{blocked.text}; {ends.text}", blocked.evidence | ends.evidence), 0
        up = self._clear(a, q)
        downs = [d for end in ends if (d := self._clear(b, end)) is not None]
        if up is None or not downs:
            where = "start" if up is None else "goal"
            text = f"{blocked.text}; at the {where} it cannot be lifted off what it rests on"
            return BlockedSegment(text, blocked.evidence), 0
        goal = downs[0][0]
        posts = [d[1] for d in downs if d[0].isclose(goal)]
        self.checker.relax_margins(up[1][self.columns])
        self.checker.relax_margins(posts[0][self.columns])
        poses_tried, began = 0, time.monotonic()
        for attempt in count():
            if self.limits.over:
                break
            rng = np.random.default_rng([*seed, attempt])
            search = ObjectPoseSearch(self.hands, self.checker, up[0], up[1], goal, posts, rng, self.limits)
            poses = search.find_poses()
            poses_tried += search.poses_tried
            segments = None if poses is None else self._made(a, q, poses, b)
            if segments is not None:
                return segments, poses_tried
        if self.limits.cancel.is_set():
            return BlockedSegment(
                f"{blocked.text}; cancelled", blocked.evidence, ErrorCode.PREEMPTED
            ), poses_tried
        text = (
            f"{blocked.text}; no detour was found in {time.monotonic() - began:.1f} s "
            f"({poses_tried} poses of it looked at): give it more planning_time, or poses to go through"
        )
        return BlockedSegment(text, blocked.evidence, ErrorCode.TIMED_OUT), poses_tried

    def _ends(self, a: SE3, b: SE3, q: Array) -> list[Array] | BlockedSegment:
        """Find the joint positions of both arms at the goal pose of the object in a two-arm carry.

        The result contains the positions at the end of the straight path, otherwise the nearest ones.
        """
        led = self.builder.along(StraightObjectPath(a, b), q)
        found = self.hands.postures(b, q) if isinstance(led, ClosedChainFailure) else [led[-1]]
        if isinstance(found, ClosedChainFailure):
            return BlockedSegment(f"{found.group} does not reach the pose itself")
        checker = self.builder.checker
        free = [p for p in found if not checker.touches(p[self.columns])]
        if not free:
            contacts = checker.exact.contacts(found[0][self.columns], padded=False)
            what = f": {contacts[0].describe()}" if contacts else ""
            return BlockedSegment(
                f"the pose itself is not free with the arms in this posture{what}", {"contacts": contacts[:1]}
            )
        return free[:POSTURES]

    def _clear(self, T: SE3, q: Array) -> tuple[SE3, Array] | None:
        """Choose an object pose with enough clearance for the planning of a two-arm carry: pose T, or the
        lowest suitable pose above T. Return the pose and the joint positions (dof,).

        Return None if the object touches at all these poses.
        """
        here = [(T, q)]
        for height in LIFTS:
            above = T.shifted(z=height)
            there = self.hands.solve(above, here[-1][1])
            if isinstance(there, ClosedChainFailure):
                break
            here.append((above, there))
        rooms = [self.checker.clearance(joints[None, self.columns], most=PADDING) for _, joints in here]
        for (pose, joints), room in zip(here, rooms, strict=True):
            if room >= ROOM_ENOUGH * max(rooms) and not self.checker.touches(joints[self.columns]):
                return pose, joints
        return None

    def _made(self, a: SE3, q: Array, poses: list[SE3], b: SE3) -> list[CarrySegment] | None:
        """Build the segments of a detour on which two arms carry an object: straight from object pose a to
        the first of `poses`, through all `poses`, then straight to object pose b.
        """
        up = self._straight([a, poses[0]], q, self.builder.checker)
        if up is None:
            return None
        through = self._through(poses, up[-1].end if up else q)
        if through is None:
            return None
        down = self._straight([poses[-1], b], through[-1].end, self.builder.checker)
        return None if down is None else [*up, *through, *down]

    def _through(self, poses: list[SE3], q: Array) -> list[CarrySegment] | None:
        """Build one segment of a two-arm carry that moves the object through several poses, with rounded
        corners. Try with collision padding first, then without.

        If the rounded segment is not free, build straight segments with stops.
        """
        if len(poses) > 2:
            for padded, spacing in product((True, False), SPACINGS):
                if self.limits.over:
                    return None
                way = RoundedObjectPath(poses, spacing, self.hands.carried.radius)
                segment = self.builder.build(way, q, self.checker, padded)
                if isinstance(segment, CarrySegment):
                    return [segment]
        return self._straight(poses, q, self.checker)

    def _straight(self, poses: list[SE3], q: Array, checker: KernelChecker) -> list[CarrySegment] | None:
        segments: list[CarrySegment] = []
        for way in (StraightObjectPath(a, b) for a, b in pairwise(poses) if not a.isclose(b)):
            segment = self.builder.build(way, segments[-1].end if segments else q, checker)
            if isinstance(segment, BlockedSegment):
                return None
            segments.append(segment)
        return segments
