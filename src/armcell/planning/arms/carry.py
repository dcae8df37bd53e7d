"""Two arms carry one object: the object's way is planned, and each arm follows it by a fixed grasp.

Both arms' inverse kinematics is solved along the way on one branch, so the relative pose of the hands is
that of the grasps at every instant; one time law moves the object from rest to rest between its waypoints.
Where the straight way is not free, a way round is searched for (see `around`).
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
from armcell.collision.resting import certify_from_rest
from armcell.core import SE3, ErrorCode, InputError, JointPath, JointTrajectory, PlanResult
from armcell.planning.arms.around import Limits, PoseSearch
from armcell.planning.arms.carried import Carried, Hands, Stuck
from armcell.planning.arms.ways import Rounded, Straight, Way, derivatives, time_law
from armcell.scene import PlanningScene
from armcell.timing.chords import chords

Array = NDArray[np.float64]

STEP, TURN = 0.01, 0.02  # [m] and [rad] of the object between two solutions of the inverse kinematics
PADDING = 0.01  # [m] that a way round keeps from what stands, where its ends do and the scene has no more
LIFTS = (0.02, 0.05, 0.1)  # [m] straight up, before a way round, from what the object rests on
ROOM_ENOUGH = 0.8  # of the most that there is at one of these heights
SPACINGS = (
    0.25,
    0.16,
    0.1,
    0.06,
    0.03,
)  # [m] of rounded ways: the first that is free
POSTURES = 4  # at the end of a way round that are tried, where the straight way leads to none


@dataclass(frozen=True, eq=False)
class Leg:
    """A timed motion from rest to rest: times (m,), joints, velocities, accelerations (m, n); even steps."""

    times: Array
    values: tuple[Array, Array, Array]
    path: Array  # (k, n) at even shares of the way
    end: Array  # (dof,) of all joints


@dataclass(frozen=True, eq=False)
class Blocked:
    """Why a way cannot be gone."""

    text: str
    evidence: dict[str, Any] = field(default_factory=dict)
    code: ErrorCode = ErrorCode.PLANNING_FAILED


def plan_carry(
    scene: PlanningScene,
    both: str,
    carried: Carried,
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
    """A motion of both arms that carries the object through poses, at rest in each.

    Args:
        scene: with the arms where the motion begins and the object attached to one of them, and allowed to
            touch the other's hand and what it rests on.
        both: the group of both arms' joints.
        start: T_world_object where the motion begins. poses: where it goes: straight and evenly turned where
            that is free, else on a way round.
        max_speed: of the object [m/s].
        rests_on: what the object may touch where it begins and ends, but not on a way round.
        planning_time: for all ways round together [s]; 0: only straight ways.
    Returns:
        SUCCESS with the trajectory; `evidence["ways"]` says of each pose "straight" or "round". Or what is in
        the way: TIMED_OUT where no way round was found in time, PREEMPTED where it was cancelled.
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
    maker = _Maker(scene, names, Hands(scene, carried), limits[0], limits[1], max_speed)
    stop = Limits(began + planning_time, cancel or threading.Event())
    legs: list[Leg] = []
    ways: list[str] = []
    looked_at = 0
    for k, (a, b) in enumerate(pairwise((start, *poses))):
        q = legs[-1].end if legs else scene.positions
        made = maker.leg(Straight(a, b), q, maker.checker, evidence=True)
        ways.append("straight" if isinstance(made, Leg) else "round")
        if isinstance(made, Blocked) and planning_time > 0:
            made, poses_seen = _Round(maker, scene, carried, rests_on, stop).way(a, b, q, made, (seed, k))
            looked_at += poses_seen
        if isinstance(made, Blocked):
            text = f"on the way to pose {k + 1} of {len(poses)}: {made.text}"
            return PlanResult(
                made.code, text, made.evidence, planner_id="carry", planning_time=time.monotonic() - began
            )
        legs += [made] if isinstance(made, Leg) else made
    trajectory = _joined(names, legs)
    points = chords((trajectory,), (0.0,), 0.0, trajectory.duration)[1]
    return PlanResult(
        ErrorCode.SUCCESS, evidence={"ways": tuple(ways), "poses_looked_at": looked_at},
        path=JointPath(names, np.vstack([leg.path for leg in legs])), trajectory=trajectory,
        planner_id="carry", planning_time=time.monotonic() - began,
        clearance=lambda: maker.checker.clearance(points),
    )  # fmt: skip


def _joined(names: tuple[str, ...], legs: Sequence[Leg]) -> JointTrajectory:
    times, values = [legs[0].times], [legs[0].values]
    for leg in legs[1:]:
        times.append(leg.times[1:] + times[-1][-1])
        values.append((leg.values[0][1:], leg.values[1][1:], leg.values[2][1:]))
    return JointTrajectory(names, np.concatenate(times), *(np.vstack(v) for v in zip(*values, strict=True)))


class _Maker:
    """Makes a timed motion of a way of the object, and proves it.

    Attributes:
        checker: of the scene as it was given.
    """

    def __init__(
        self, scene: PlanningScene, names: tuple[str, ...], hands: Hands, velocity: Array,
        acceleration: Array, max_speed: float,
    ):  # fmt: skip
        self.names, self.hands, self.max_speed = names, hands, max_speed
        self.velocity, self.acceleration = velocity, acceleration
        self.checker = KernelChecker(scene, names)

    def leg(
        self, way: Way, q: Array, checker: KernelChecker, padded: bool = False, evidence: bool = False
    ) -> Leg | Blocked:
        """From joints q (dof,) along a way; proven free as it will be executed.

        Args:
            padded: keep the checker's padding as well. evidence: where it is blocked, by what.
        """
        found = self.along(way, q)
        if isinstance(found, Stuck):
            return Blocked(str(found))
        path = found[:, checker.columns]
        if isinstance(way, Rounded) and not checker.certify(path, padded=padded, evidence=False).free:
            return Blocked("the rounded way is not free")  # before it is worked out finely
        times, shares = time_law(path, way, self.velocity, self.acceleration, self.max_speed)
        exact = self.hands.along(way.poses(shares), shares, q)
        if isinstance(exact, Stuck):
            return Blocked(str(exact))
        values = exact[:, checker.columns]
        velocities, accelerations = derivatives(times, values)
        over = float(np.max(np.abs(velocities) / self.velocity))  # bends that the law has not seen
        over = max(over, float(np.sqrt(np.max(np.abs(accelerations) / self.acceleration))), 1.0)
        times, velocities, accelerations = times * over, velocities / over, accelerations / over**2
        trajectory = JointTrajectory(self.names, times, values, velocities, accelerations)
        _, points, room = chords((trajectory,), (0.0,), 0.0, trajectory.duration)
        if padded:
            proof = checker.certify(points, room, padded=True, evidence=evidence)
        else:
            proof = certify_from_rest(checker, points, room, evidence=evidence)
        if not proof.free:
            what = "" if proof.contact is None else f": {proof.contact.describe()}"
            contacts = {"contacts": [proof.contact] if proof.contact else []}
            return Blocked(f"the way is blocked at {100 * proof.at:.0f} %{what}", contacts)
        return Leg(times, (values, velocities, accelerations), path, exact[-1])

    def along(self, way: Way, q: Array) -> Array | Stuck:
        """All joints (k, dof) at even shares of a way."""
        steps = max(int(np.ceil(max(way.metres / STEP, way.radians / TURN))), 4)
        shares = np.linspace(0, 1, steps + 1)
        return self.hands.along(way.poses(shares), shares, q)


class _Round:
    """A way round for one pair of poses: up from what the object rests on, round, and down."""

    def __init__(
        self, maker: _Maker, scene: PlanningScene, carried: Carried, rests_on: Sequence[str], limits: Limits
    ):
        strict = scene.with_allowed(carried.name, tuple(rests_on), allow=False) if rests_on else scene
        strict = strict.with_padding(max(scene.padding, PADDING))
        self.maker, self.hands, self.limits = maker, maker.hands, limits
        self.checker = KernelChecker(strict, maker.names)
        self.columns = self.checker.columns

    def way(
        self, a: SE3, b: SE3, q: Array, blocked: Blocked, seed: tuple[int, int]
    ) -> tuple[list[Leg] | Blocked, int]:
        """Legs from joints q with the object at a to b, or why there are none; poses that were looked at."""
        ends = self._ends(a, b, q)
        if isinstance(ends, Blocked):
            return Blocked(f"{blocked.text}; {ends.text}", blocked.evidence | ends.evidence), 0
        up = self._clear(a, q)
        downs = [d for end in ends if (d := self._clear(b, end)) is not None]
        if up is None or not downs:
            where = "start" if up is None else "goal"
            text = f"{blocked.text}; at the {where} it cannot be lifted off what it rests on"
            return Blocked(text, blocked.evidence), 0
        goal = downs[0][0]
        posts = [d[1] for d in downs if d[0].isclose(goal)]
        self.checker.relax_margins(up[1][self.columns])
        self.checker.relax_margins(posts[0][self.columns])
        looked_at, began = 0, time.monotonic()
        for attempt in count():
            if self.limits.over:
                break
            rng = np.random.default_rng([*seed, attempt])
            search = PoseSearch(self.hands, self.checker, up[0], up[1], goal, posts, rng, self.limits)
            poses = search.way()
            looked_at += search.looked_at
            legs = None if poses is None else self._made(a, q, poses, b)
            if legs is not None:
                return legs, looked_at
        if self.limits.cancel.is_set():
            return Blocked(f"{blocked.text}; cancelled", blocked.evidence, ErrorCode.PREEMPTED), looked_at
        text = (
            f"{blocked.text}; no way round was found in {time.monotonic() - began:.1f} s "
            f"({looked_at} poses of it looked at): give it more planning_time, or poses to go through"
        )
        return Blocked(text, blocked.evidence, ErrorCode.TIMED_OUT), looked_at

    def _ends(self, a: SE3, b: SE3, q: Array) -> list[Array] | Blocked:
        """All joints at the goal, as they may be: those that the straight way leads to, or the nearest."""
        led = self.maker.along(Straight(a, b), q)
        found = self.hands.postures(b, q) if isinstance(led, Stuck) else [led[-1]]
        if isinstance(found, Stuck):
            return Blocked(f"{found.group} does not reach the pose itself")
        checker = self.maker.checker
        free = [p for p in found if not checker.touches(p[self.columns])]
        if not free:
            contacts = checker.exact.contacts(found[0][self.columns], padded=False)
            what = f": {contacts[0].describe()}" if contacts else ""
            return Blocked(
                f"the pose itself is not free with the arms in this posture{what}", {"contacts": contacts[:1]}
            )
        return free[:POSTURES]

    def _clear(self, T: SE3, q: Array) -> tuple[SE3, Array] | None:
        """T, or a pose straight above it if there is more room, and the joints there; None if all touch."""
        here = [(T, q)]
        for height in LIFTS:
            above = T.shifted(z=height)
            there = self.hands.at(above, here[-1][1])
            if isinstance(there, Stuck):
                break
            here.append((above, there))
        rooms = [self.checker.clearance(joints[None, self.columns], most=PADDING) for _, joints in here]
        for (pose, joints), room in zip(here, rooms, strict=True):
            if room >= ROOM_ENOUGH * max(rooms) and not self.checker.touches(joints[self.columns]):
                return pose, joints
        return None

    def _made(self, a: SE3, q: Array, poses: list[SE3], b: SE3) -> list[Leg] | None:
        """Legs from a up to the first pose, through all, and from the last down to b."""
        up = self._straight([a, poses[0]], q, self.maker.checker)
        if up is None:
            return None
        through = self._through(poses, up[-1].end if up else q)
        if through is None:
            return None
        down = self._straight([poses[-1], b], through[-1].end, self.maker.checker)
        return None if down is None else [*up, *through, *down]

    def _through(self, poses: list[SE3], q: Array) -> list[Leg] | None:
        """One rounded leg through poses, padded if it can be; else straight ones, at rest in each pose."""
        if len(poses) > 2:
            for padded, spacing in product((True, False), SPACINGS):
                if self.limits.over:
                    return None
                way = Rounded(poses, spacing, self.hands.carried.radius)
                leg = self.maker.leg(way, q, self.checker, padded)
                if isinstance(leg, Leg):
                    return [leg]
        return self._straight(poses, q, self.checker)

    def _straight(self, poses: list[SE3], q: Array, checker: KernelChecker) -> list[Leg] | None:
        legs: list[Leg] = []
        for way in (Straight(a, b) for a, b in pairwise(poses) if not a.isclose(b)):
            leg = self.maker.leg(way, legs[-1].end if legs else q, checker)
            if isinstance(leg, Blocked):
                return None
            legs.append(leg)
        return legs
