"""Numeric inverse kinematics for any chain: search from many seeds, and free rotation about one axis.

The search runs descents of damped least squares (Numba). The free rotation about one axis serves arms
with fewer than six joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, UnknownNameError
from armcell.core.checks import float_array, require
from armcell.kinematics.ik.chain import Chain, errors_at
from armcell.kinematics.ik.descent import PATIENCE, approach_in_null_space, descend
from armcell.kinematics.ik.full_turns import nearest_turns
from armcell.kinematics.ik.seeds import rank, sampling_range, take_nearest
from armcell.kinematics.ik.solver import POSE_JOINTS, ChainData, IKSettings, IKSolver, ik_solvers
from armcell.model import Joint, JointLimits, Link, RobotModel

DISTINCT = 1e-2  # [rad or m] in any joint
Array = NDArray[np.float64]
TABLED = 64  # maximum number of precomputed seeds, nearest first; the remaining seeds are random
BATCH = 4  # number of solutions per call of the compiled search
POLISH = 12  # iterations that bring an arm with fewer than six joints as near to the goal as it gets
BARREN = 32  # if a solution exists, the search ends after this many seeds without a new one
SOLUTIONS = 16  # of the arm, among which distinct angles are searched
APART = 1e-3  # [rad] distinct angles
STRAIGHTEN = 24  # steps that reduce the tilt of a solution


def ik_problem(
    chain: Chain, goal: NDArray[np.float64], reference: NDArray[np.float64], settings: IKSettings
) -> tuple[Any, ...]:
    """Return the problem of numeric IK as one argument of the compiled search.

    The problem is a plain tuple, because Numba takes 2 us longer to find the type of a named tuple.

    Args:
        goal: (12,) desired pose of the tip in the chain's base frame.
        reference: (n,) positions near which the solutions' full turns are chosen.
    """
    s = settings
    return (
        chain.table, chain.bounds, chain.turning, goal, chain.position_weight, reference, s.max_iterations,
        s.position_tolerance, s.rotation_tolerance,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def search(problem, seeds, scores, tries, found, count, want):
    """Search numerically for distinct IK solutions from many start configurations (seeds), and append up to
    `want` of them to `found` at row `count`.

    Args:
        problem: see `ik_problem`.
        seeds: (s, n) seeds, tried by increasing score; the score of a tried seed becomes infinite.
        tries: maximum number of seeds to try in this call.
    Returns:
        Number of seeds tried, number of solutions in `found`.
    """
    table, bounds, turning, goal, scale, reference, iterations, position_tolerance, rotation_tolerance = (
        problem
    )
    n = len(bounds)
    patience = np.int64(PATIENCE)  # for a literal Numba would compile descend again
    q, axes, J = np.empty(n), np.empty((len(table), 6)), np.empty((n, 7))
    for tried in range(tries):
        if count >= want:
            return tried, count
        seed = take_nearest(scores)
        for c in range(n):
            q[c] = min(max(seeds[seed, c], bounds[c, 0]), bounds[c, 1])
        reached = descend(
            table, bounds, goal, scale, iterations, patience, position_tolerance, rotation_tolerance,
            q, axes, J,
        )[2]  # fmt: skip
        if not reached or nearest_turns(q, reference, bounds, turning) >= 0:
            continue
        new = True
        for other in range(count):
            largest = 0.0
            for c in range(n):
                largest = max(largest, abs(found[other, c] - q[c]))
            new = new and largest > DISTINCT
        if new:
            for c in range(n):
                found[count, c] = q[c]
            count += 1
    return tries, count


@njit(cache=True, error_model="numpy")
def any_solution(problem, seeds, poses, tries, found):
    """Search numerically for one IK solution from tabulated start configurations (seeds), and write it to
    `found` (1, n). Return whether one was found.
    """
    scores = np.empty(len(seeds), np.float32)
    _, _, _, goal, scale, _, _, _, _ = problem
    rank(poses, goal, scale, scores)
    return search(problem, seeds, scores, tries, found, 0, 1)[1] > 0


@ik_solvers.register("numeric")
class NumericIK(IKSolver):
    """Numeric IK solver, which runs damped least squares from many start configurations (seeds).

    The seeds are the reference, then the precomputed poses nearest to the goal, then random positions.
    """

    method = "numeric"

    def _search(self, prepared: ChainData, goal: Array, reference: Array, rng: np.random.Generator | None,
                outside: dict[str, int]) -> Iterator[Array]:  # fmt: skip
        chain, s = prepared.chain, self.settings
        if np.linalg.norm(goal[[3, 7, 11]]) > chain.reach + s.position_tolerance:
            return
        problem = ik_problem(chain, goal, reference, s)
        found, count, given = np.empty((s.seeds, len(reference))), 0, 0
        for seeds, scores, left in self._seeds(prepared, goal, reference, rng):
            while left > 0:
                tried, count = search(problem, seeds, scores, min(left, BARREN), found, count, given + BATCH)
                left -= tried
                if count == given > 0 and tried == BARREN:
                    return
                for q in found[given:count]:
                    few = self.independent_joints < POSE_JOINTS
                    yield self._polished(chain, goal, q) if few else q.copy()
                given = count

    def _polished(self, chain: Chain, goal: Array, q: Array) -> Array:
        """Refine a numeric IK solution that is within the coarse tolerance. The returned positions (n,) are
        at least as close to the goal pose.
        """
        better = q.copy()
        exact = IKSettings()
        descend(
            chain.table, chain.bounds, goal, chain.position_weight, POLISH, POLISH, exact.position_tolerance,
            exact.rotation_tolerance, better, np.empty((len(chain.table), 6)), np.empty((len(q), 7)),
        )  # fmt: skip
        before, after = (sum(errors_at(chain.table, x, goal)) for x in (q, better))
        return better if after < before else q.copy()

    def _nearer(self, prepared: ChainData, goal: Array, reference: Array, q: Array) -> Array:
        if len(q) <= 6:
            return q
        chain, nearer = prepared.chain, q.copy()
        approach_in_null_space(
            chain.table,
            chain.bounds,
            goal,
            chain.position_weight,
            reference,
            self.settings.position_tolerance,
            self.settings.rotation_tolerance,
            nearer,
        )
        return nearer

    def nearer(self, q: Array, T_world_tip: SE3, wanted: Array, reference: Array) -> Array:
        """For a redundant chain, return a numeric IK solution (n,) that is closer to the wanted positions
        (n,) than the solution q (n,). The tip pose stays the same.

        Args:
            reference: positions (dof,) of all joints; joints outside the group stay at these positions.
        Raises:
            InputError: an array has the wrong length or is not finite.
        """
        n = len(self.group.joint_names)
        q, wanted = float_array(q, (n,), "q"), float_array(wanted, (n,), "wanted")
        reference = float_array(reference, (self.model.dof,), "reference")
        prepared, goal, _ = self._question(T_world_tip, reference)
        return self._nearer(prepared, goal, wanted, q)

    def _seeds(self, prepared: ChainData, goal: Array, reference: Array, rng: np.random.Generator | None):
        """Yield batches (k, n) of start configurations (seeds) for numeric IK, with a score for each seed
        (lower is better) and the number of seeds to try.

        All batches together contain at most `settings.seeds` tries.
        """
        yield reference[None], np.zeros(1, np.float32), 1
        tabled = prepared.seeds
        scores = np.empty(len(tabled.positions), np.float32)
        rank(tabled.poses, goal, prepared.chain.position_weight, scores)
        rest = max(self.settings.seeds - 1, 0)
        yield tabled.positions, scores, min(rest, TABLED)
        rest -= TABLED
        if rest > 0:
            low, high = sampling_range(prepared.chain)
            rng = np.random.default_rng(0) if rng is None else rng
            yield rng.uniform(low, high, (rest, len(low))), np.arange(rest, dtype=np.float32), rest


@dataclass(frozen=True, eq=False)
class TurnedPose:
    """Reachable tip pose T_world_tip that numeric IK has found for a goal with a free axis of rotation, and
    the angle [rad] by which this pose is turned about the axis.
    """

    angle: float
    T_world_tip: SE3


def poses_about_axis(
    model: RobotModel, group: str, tip_link: str, T_tip_axis: SE3, T_world_axis: SE3, reference: ArrayLike,
    tilt: float = 0.0,
) -> Iterator[TurnedPose]:  # fmt: skip
    """Solve numeric IK for a goal that may rotate freely about one axis: yield reachable tip poses with
    distinct angles about the axis.

    The z axis of the frame `axis` is the axis of rotation. The tip reaches the pose
    `T_world_axis @ Rz(angle) @ tilt @ inverse(T_tip_axis)` within the joint limits. A continuous joint about
    the axis extends the chain, so that an arm with five joints has a finite number of solutions. An arm with
    fewer joints reaches a measured pose only with a small tilt about the frame's x and y axes.

    Args:
        reference: positions (dof,) of all joints of the model.
        tilt: [rad] maximum rotation about each of the frame's x and y axes; the solutions have little tilt.
    Raises:
        UnknownNameError: no such group or link.
        InputError: an axis is not a pose, or the reference is not (dof,) finite numbers.
    """
    arm = model.group(group)
    if tip_link not in model.links:
        raise UnknownNameError("link", tip_link, model.links)
    require(isinstance(T_tip_axis, SE3) and isinstance(T_world_axis, SE3), "the axes must be poses (SE3)")
    bounds = JointLimits(-tilt, tilt)
    added, parent, T = [], tip_link, T_tip_axis
    for kind, axis in (("tilt_x", (1, 0, 0)), ("tilt_y", (0, 1, 0))) if tilt > 0.0 else ():
        added.append(Joint(f"{tip_link}/{kind}", "revolute", parent, f"{tip_link}/{kind}", T, axis, bounds))
        parent, T = added[-1].child, SE3.identity()
    added.append(Joint(f"{tip_link}/spin", "continuous", parent, f"{tip_link}/axis", T, (0, 0, 1)))
    extended = replace(
        model,
        links={**model.links, **{joint.child: Link(joint.child) for joint in added}},
        joints={**model.joints, **{joint.name: joint for joint in added}},
        groups={
            **model.groups,
            group: replace(
                arm, joint_names=(*arm.joint_names, *(j.name for j in added)), tip_link=added[-1].child
            ),
        },
    )
    start = np.append(float_array(reference, (model.dof,), "reference"), np.zeros(len(added)))
    solver, apart = NumericIK(extended, group, added[-1].child), max(APART, 2 * tilt)
    found: list[float] = []
    for q in islice(solver.solutions(T_world_axis, start, np.random.default_rng(0)), SOLUTIONS):
        if tilt > 0.0:
            for _ in range(STRAIGHTEN):  # each step also keeps the arm near its positions
                upright = np.concatenate([q[: -len(added)], np.zeros(len(added) - 1), q[-1:]])
                q = solver.nearer(q, T_world_axis, upright, start)
        angle = -float(q[-1])
        if all(abs(np.sin((angle - other) / 2)) > apart / 2 for other in found):
            found.append(angle)
            start[solver.columns] = q
            yield TurnedPose(angle, solver.tree.link_pose(start, tip_link))
