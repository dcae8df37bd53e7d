"""Base class of the inverse kinematics solvers: input checks, choice of solution, diagnosis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, ErrorCode, IKResult, InputError, Registry
from armcell.core.checks import checked
from armcell.kinematics.ik.chain import Chain, chain_of, errors_at, goal_in_base
from armcell.kinematics.ik.descent import descend, null_space_step
from armcell.kinematics.ik.full_turns import full_turn_equivalents
from armcell.kinematics.ik.seeds import Seeds, rank, seeds_of, take_nearest
from armcell.kinematics.tree import FIXED, kinematic_tree
from armcell.model import RobotModel

Array = NDArray[np.float64]
Validity = Callable[[Array], bool]

CLOSEST_SEEDS, CLOSEST_ITERATIONS = (
    12,
    200,
)  # seeds and iterations of the search for the nearest reachable pose if there is no solution
POSE_JOINTS = 6  # independent joints of an arm that reaches any orientation at a position
COARSE = (5e-5, 1e-3)  # [m], [rad] tolerances for fewer joints: rounded numbers of a URDF miss a pose by more
# than the default tolerances, and no other joint makes up for them. A limit of 1.57 is 8e-4 below pi / 2.
PROBED = 3  # random states in which the independent joints are counted; few of the states are singular
DEPENDENT = 1e-3  # least singular value [1 or m/rad] of an independent motion: larger than rounding in a URDF
AT_LIMIT = 1e-3  # [rad or m] joints nearer to a limit count as being at the limit


@dataclass(frozen=True)
@checked()
class IKSettings:
    """Settings of the IK solvers. Only the numeric solver needs the settings of the search."""

    position_tolerance: float = 1e-6  # [m]
    rotation_tolerance: float = 1e-6  # [rad]
    max_iterations: int = 30  # for each seed
    seeds: int = 200  # number of seeds before a pose counts as unreachable
    solutions: int = 8  # number of distinct valid solutions from which the nearest is chosen

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0 < value < np.inf:
                raise InputError(f"{field.name} is {value:g}, it must be positive and finite")


@dataclass(frozen=True, eq=False)
class ChainData:
    """Data that an IK solver precomputes for its kinematic chain.
    The data are valid while the robot's other joints keep their positions.
    """

    chain: Chain
    seeds: Seeds
    geometry: Array | None = None  # link dimensions for the analytic solver


class IKSolver(ABC):
    """Base class of inverse kinematics solvers. An instance solves for one planning group and tip link of a
    robot.

    Apart from a cache, a solver has no state, so calls do not influence each other.

    Attributes:
        method: "analytic" or "numeric".
        independent_joints: number of independent directions in which the group's joints move the tip.
        lower, upper: limits of the group's joints (n,) [rad or m]; infinite for joints without limits.
        columns: indices of the group's joints in the model's positions (n,).
    """

    method = ""
    nearest_first = False  # whether `solutions` are sorted by their distance from the reference

    def __init__(
        self, model: RobotModel, group: str, tip_link: str | None = None, settings: IKSettings = IKSettings()
    ):
        self.group = model.group(group)
        self.tip_link = tip_of(model, group, tip_link)
        self.tree = kinematic_tree(model)
        self.joint_names = self.group.joint_names
        self.independent_joints = independent_joints(model, self.joint_names, self.tip_link)
        if settings == IKSettings() and self.independent_joints < POSE_JOINTS:
            settings = replace(settings, position_tolerance=COARSE[0], rotation_tolerance=COARSE[1])
        self.model, self.settings = model, settings
        self.columns = np.array(model.columns(self.joint_names), dtype=np.int64)
        self.lower, self.upper = model.lower[self.columns], model.upper[self.columns]
        self._others = other_columns(model, self.joint_names, self.tip_link)
        start = model.default_positions()
        self._kept = (start[self._others].tobytes(), self._prepare(start))

    def _prepare(self, positions: Array) -> ChainData:
        chain = chain_of(self.tree, self.joint_names, self.tip_link, positions)
        return ChainData(chain, seeds_of(chain))

    @classmethod
    def solves(cls, model: RobotModel, group: str, tip_link: str | None = None) -> bool:
        """Return whether a class of IK solvers supports the given planning group and tip link."""
        return True

    @property
    def chain_data(self) -> ChainData:
        """Data that an IK solver precomputed for its compiled functions during the latest query.

        The data depends on the positions of the robot's other joints in that query.
        """
        return self._kept[1]

    @abstractmethod
    def _search(self, prepared: ChainData, goal: Array, reference: Array, rng: np.random.Generator | None,
                outside: dict[str, int]) -> Iterator[Array]:  # fmt: skip
        """Search for distinct solutions (n,) of an IK solver that reach a goal (12,), the desired tip pose in
        the base frame of the chain.

        The method also counts, in `outside` per joint, the solutions that only this joint's limits forbid.
        """

    def _nearer(self, prepared: ChainData, goal: Array, reference: Array, q: Array) -> Array:
        """Return a solution of the IK solver for the same pose as `q` (n,) that is closer to the reference.

        The default implementation returns `q` itself.
        """
        return q

    def solutions(
        self, T_world_tip: SE3, reference: ArrayLike, rng: np.random.Generator | None = None,
        equivalents: bool = False,
    ) -> Iterator[Array]:  # fmt: skip
        """Yield the distinct solutions (n,) of an IK solver that are within the joint limits.

        Each solution is turned by full turns to be as near as possible to the reference.

        Args:
            T_world_tip: desired pose of the tip link.
            reference: positions (dof,) of all joints; joints outside the group stay at these positions.
            rng: random generator for the numeric solver's random seeds.
            equivalents: whether to yield, after each solution, also those that differ from it by full turns.
        Raises:
            InputError: a value is not finite, or `reference` has the wrong length.
        """
        prepared, goal, at = self._question(T_world_tip, reference)
        for q in self._search(prepared, goal, at, rng, {}):
            yield from full_turn_equivalents(q, at, prepared.chain) if equivalents else (q,)

    def nearest(
        self, T_world_tip: SE3, reference: ArrayLike, rng: np.random.Generator | None = None, among: int = 16
    ) -> list[Array]:
        """Return up to `among` distinct solutions (n,) of an IK solver, sorted by their distance from the
        reference, nearest first.

        See `solutions` for the arguments.
        """
        at = np.asarray(reference, dtype=float)
        found = list(islice(self.solutions(T_world_tip, at, rng), among))
        return sorted(found, key=lambda q: float(np.linalg.norm(q - at[self.columns])))

    def solve(
        self,
        T_world_tip: SE3,
        reference: ArrayLike,
        is_valid: Validity | None = None,
        rng: np.random.Generator | None = None,
    ) -> IKResult:
        """Run the IK solver for a pose: return the valid solution that is nearest to the reference.

        Args:
            T_world_tip: desired pose of the tip link.
            reference: positions (dof,) of all joints; the solution should be near the group's positions.
            is_valid: function that returns whether group positions (n,) are valid, for example free of
                collisions.
            rng: random generator for the numeric solver's random seeds.
        Returns:
            SUCCESS with `positions` (n,), or NO_IK_SOLUTION with the nearest positions found. If `is_valid`
                rejected solutions, the evidence contains their number `invalid_solutions` and the solutions
                `invalid`. Otherwise it contains `closest_pose`, `joints_at_limit`, `outside_limits` (number
                of solutions outside a joint's limits, by joint), `distance_m` (from the first joint to the
                goal) and `reach_m` (of the arm).
        Raises:
            InputError: a value is not finite, or `reference` has the wrong length.
        """
        prepared, goal, at = self._question(T_world_tip, reference)
        best, least, valid = None, np.inf, 0
        rejected: list[Array] = []
        outside: dict[str, int] = {}
        for q in self._search(prepared, goal, at, rng, outside):
            if is_valid is not None and not is_valid(q):
                rejected.append(q)
                continue
            valid += 1
            apart = q - at
            if (apart := float(apart @ apart)) < least:
                best, least = q, apart
            if self.nearest_first or valid >= self.settings.solutions:
                break
        if best is not None:
            nearer = self._nearer(prepared, goal, at, best)
            if nearer is not best and (is_valid is None or is_valid(nearer)):
                best = nearer
            position, angle = errors_at(prepared.chain.table, best, goal)
            return IKResult(ErrorCode.SUCCESS, positions=best, position_error=position, rotation_error=angle)
        if not rejected:
            return self._closest(prepared, goal, at, np.asarray(reference, dtype=float), outside)
        best = min(rejected, key=lambda q: float(np.linalg.norm(q - at)))
        position, angle = errors_at(prepared.chain.table, best, goal)
        return IKResult(
            ErrorCode.NO_IK_SOLUTION,
            f"{len(rejected)} solution(s) reach the pose, each of them in collision",
            {"invalid_solutions": len(rejected), "invalid": rejected, "outside_limits": outside},
            positions=best,
            position_error=position,
            rotation_error=angle,
        )

    def descend(
        self, q: Array, T_world_tip: SE3, iterations: int = 60, *, wish: Array | None = None,
        bounds: Array | None = None,
    ) -> tuple[float, float, bool]:  # fmt: skip
        """Let an IK solver improve joint positions `q` (dof,) in place, so that the tip approaches the
        desired pose.

        Args:
            q: initial positions of all joints; receives the result.
            T_world_tip: desired pose of the tip link.
            iterations: maximum number of iterations.
            wish: desired change (n,) of a redundant group's joints; the solver applies its null-space part,
                if the pose is still reached.
            bounds: (n, 2) bounds of the group's joints that replace their limits.
        Returns:
            Position error [m], rotation error [rad], and whether the descent converged.
        """
        prepared, goal, at = self._question(T_world_tip, q)
        chain, s = prepared.chain, self.settings
        within = chain.bounds if bounds is None else bounds
        if wish is not None and wish.any() and null_space_step(
            chain.table, within, goal, chain.position_weight, wish, iterations, s.position_tolerance,
            s.rotation_tolerance, at,
        ):  # fmt: skip
            position, angle, ok = *errors_at(chain.table, at, goal), True
        else:
            position, angle, ok = self._descend(chain, within, goal, at, iterations)
        q[self.columns] = at
        return position, angle, ok

    def _descend(
        self, chain: Chain, bounds: Array, goal: Array, at: Array, iterations: int
    ) -> tuple[float, float, bool]:
        """Let an IK solver improve joint positions `at` (n,) in place, as long as the pose error
        decreases.
        """
        n = len(at)
        return descend(
            chain.table, bounds, goal, chain.position_weight, iterations, iterations,
            self.settings.position_tolerance, self.settings.rotation_tolerance, at,
            np.empty((len(chain.table), 6)), np.empty((n, 7)),
        )[:3]  # fmt: skip

    def _question(self, T_world_tip: SE3, reference: ArrayLike) -> tuple[ChainData, Array, Array]:
        """Check a query to an IK solver. Return the precomputed data, the goal pose (12,) and the reference
        positions (n,) of the group.

        The goal is the pose of the tip in the chain's base frame.

        Raises:
            InputError: a value is not finite, or `reference` has the wrong length.
        """
        positions = np.asarray(reference, dtype=float)
        if positions.shape != (self.model.dof,):
            raise InputError(
                f"the reference has shape {positions.shape}, {self.model.name!r} needs ({self.model.dof},)",
                hint="give positions of all joints of the robot, in the model's order",
            )
        if not np.isfinite(positions.sum()):
            bad = [n for n, v in zip(self.model.joint_names, positions, strict=True) if not np.isfinite(v)]
            raise InputError(f"the reference position of {', '.join(bad)} is not finite")
        key, prepared = self._kept
        if len(self._others) and (now := positions[self._others].tobytes()) != key:
            prepared = self._prepare(positions)
            self._kept = (now, prepared)
        goal = np.empty(12)
        if not goal_in_base(prepared.chain.inverse_base, T_world_tip.matrix, goal):
            raise InputError(f"the wanted pose of {self.tip_link} has a value that is not finite")
        return prepared, goal, positions[self.columns]

    def _closest(
        self, prepared: ChainData, goal: Array, at: Array, reference: Array, outside: dict[str, int]
    ) -> IKResult:
        """Return the failed result of an IK solver. It contains the reachable pose that is nearest to the
        unreachable goal pose.
        """
        chain, seeds = prepared.chain, prepared.seeds
        scores = np.empty(len(seeds.positions), np.float32)
        rank(seeds.poses, goal, chain.position_weight, scores)
        best, least = at, (np.inf, np.inf)
        for k in range(CLOSEST_SEEDS):
            q = np.clip(at, chain.bounds[:, 0], chain.bounds[:, 1]) if k == 0 else seeds.positions[
                take_nearest(scores)].copy()  # fmt: skip
            position, angle, _ = self._descend(chain, chain.bounds, goal, q, CLOSEST_ITERATIONS)
            if position + 0.1 * angle < least[0] + 0.1 * least[1]:
                best, least = q, (position, angle)
        limits = self.at_limit(best)
        distance = float(np.linalg.norm(goal[[3, 7, 11]]))
        if outside:
            count = f"{sum(outside.values())} solution(s) reach the pose"
            why = f"{count}, each outside limits ({_counts(outside)}); within them"
        elif distance > chain.reach:
            why = (
                f"{self.tip_link} cannot reach the pose: it is {distance:.2f} m from the first joint, "
                f"the arm reaches {chain.reach:.2f} m at most;"
            )
        else:
            why = f"{self.tip_link} cannot reach the pose:"
        message = f"{why} the closest is {least[0] * 1000:.0f} mm and {np.rad2deg(least[1]):.0f} deg away" + (
            f", with {', '.join(limits)} at the limit" if limits else ""
        )
        if self.independent_joints < POSE_JOINTS:
            message += (
                f"; {self.independent_joints} joints reach only some orientations at a position: allow more "
                "in the goal's orientation tolerance (pi: any), or take the closest pose"
            )
        full = reference.copy()
        full[self.columns] = best
        evidence: dict[str, Any] = {
            "closest_pose": self.tree.link_pose(full, self.tip_link),
            "joints_at_limit": limits,
            "outside_limits": outside,
            "distance_m": distance,
            "reach_m": chain.reach,
        }
        return IKResult(
            ErrorCode.NO_IK_SOLUTION,
            message,
            evidence,
            best,
            position_error=least[0],
            rotation_error=least[1],
        )

    def at_limit(self, q: Array) -> list[str]:
        """Return the names of the joints of an IK solver that are within 1e-3 of a joint limit at `q`
        (n,).
        """
        near = np.minimum(q - self.lower, self.upper - q) < AT_LIMIT
        return [name for name, yes in zip(self.joint_names, near, strict=True) if yes]


ik_solvers: Registry[type[IKSolver]] = Registry("IK solver", "armcell.ik_solvers")
"""Inverse kinematics solvers by name, for `ik_solvers` in robot.yaml."""


def _counts(outside: dict[str, int]) -> str:
    return ", ".join(f"{name}: {count}" for name, count in outside.items())


def tip_of(model: RobotModel, group: str, tip_link: str | None) -> str:
    """Return the link that an IK solver moves to the desired pose: `tip_link` if given, otherwise the tip
    link of the planning group.

    Raises:
        UnknownNameError: the group or link does not exist.
        InputError: `tip_link` is None and the group is not a chain, so it has no tip link.
    """
    tip = tip_link or model.group(group).tip_link
    if tip is None:
        raise InputError(f"group {group!r} is not a chain, so it has no tip", hint="name the link to place")
    model.link(tip)
    return tip


def independent_joints(model: RobotModel, joint_names: tuple[str, ...], link: str) -> int:
    """Return the number of independent directions in which joints move a link. The joints of a telescope, for
    example, count as one.
    """
    tree, rng = kinematic_tree(model), np.random.default_rng(0)
    q, columns, most = model.default_positions(), model.columns(joint_names), 0
    for _ in range(PROBED):
        q[columns] += rng.uniform(0.1, 1.0, len(columns))
        jacobian = tree.jacobian(q, link, joint_names)
        most = max(most, int(np.linalg.matrix_rank(jacobian, tol=DEPENDENT)))
    return most


def other_columns(model: RobotModel, joint_names: tuple[str, ...], tip_link: str) -> NDArray[np.int64]:
    """Return the indices of joints that move the tip link of an IK solver but do not belong to its planning
    group.
    """
    tree = kinematic_tree(model)
    moving = {int(tree.column[j]) for j in tree.path_to(tip_link) if tree.kind[j] != FIXED}
    return np.array(sorted(moving - set(model.columns(joint_names))), dtype=np.int64)
