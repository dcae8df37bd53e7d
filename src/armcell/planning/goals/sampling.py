"""Sampling of joint positions that reach a goal, from the whole region that the goal allows."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
    SO3,
    Box,
    ConstraintGoal,
    Constraints,
    Goal,
    JointGoal,
    OrientationConstraint,
    Plane,
    PoseGoal,
    PositionConstraint,
)
from armcell.core.geometry import local_bounds
from armcell.kinematics import POSE_JOINTS, IKSolver, ik_solver
from armcell.model import RobotModel
from armcell.planning.constraints.constraint_validation import joint_ranges
from armcell.planning.constraints.evaluation import (
    distance_to_shape,
    region_distance,
    rotation_error,
    rotation_of,
    satisfies_constraints,
)
from armcell.planning.constraints.manifold import LEAST, ConstraintManifold
from armcell.planning.moved_frame import MovedFrame
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

WIDE = (1e-3, 1e-2)  # [rad or m], [rad] a goal with larger tolerances is a region to be sampled
SHARE = 0.9  # used share of the tolerances; the rest is for the solver's own tolerance
ATTEMPTS = 500  # random references per goal
TRIES = 50  # attempts to sample a point inside a shape
EQUIVALENTS = 4  # number of positions that differ by full turns


def is_region(goal: Goal) -> bool:
    """Return whether many different joint positions can meet a goal, so that a planner can sample goal
    configurations.

    This is the case for pose goals, constraint goals, and joint goals with a tolerance above `WIDE[0]`. All
    other joint goals specify one configuration, apart from full turns of joints.
    """
    return isinstance(goal, PoseGoal | ConstraintGoal) or (
        isinstance(goal, JointGoal) and goal.tolerance > WIDE[0]
    )


def is_wide(goal: PoseGoal) -> bool:
    """Return whether the tolerances of a pose goal are so large that joint positions for it should be
    sampled.
    """
    return goal.position_tolerance > WIDE[0] or bool(np.max(goal.orientation_tolerance) > WIDE[1])


def sample_goal_positions(
    scene: PlanningScene, group: str, goal: Goal, rng: np.random.Generator, deadline: float = np.inf
) -> Iterator[Array]:
    """Sample joint positions (n,) that reach a goal and are within the joint limits; collisions are not
    checked.

    Args:
        deadline: [s] of time.monotonic(), after which sampling ends.
    """
    if isinstance(goal, PoseGoal):
        if is_wide(goal) and len(scene.model.group(group).joint_names) < POSE_JOINTS:
            return _of_constraints(scene, group, _constraints_of(goal), rng, deadline)
        return _of_pose(scene, group, goal, rng, deadline)
    if isinstance(goal, ConstraintGoal):
        return _of_constraints(scene, group, goal.constraints, rng, deadline)
    if isinstance(goal, JointGoal):
        return _of_joints(scene, group, goal, rng)
    return iter(())


def reaches_goal(scene: PlanningScene, group: str, goal: PoseGoal | ConstraintGoal, q: Array,
            slack: tuple[float, float] = (0.0, 0.0)) -> bool:  # fmt: skip
    """Return whether joint positions q (n,) reach a goal, within the goal's tolerances or within `slack` (a
    distance [m] and an angle [rad]).
    """
    if isinstance(goal, ConstraintGoal):
        return satisfies_constraints(scene, group, goal.constraints, q)
    pose, wanted = MovedFrame(scene, group, goal.link).pose(q), goal.T_world_link
    apart = float(np.linalg.norm(pose.translation - wanted.translation))
    error = rotation_error(wanted.rotation, pose.rotation, "rotation_vector")
    if np.ndim(goal.orientation_tolerance) == 0:
        error = np.linalg.norm(error)
    turned = np.abs(error) <= np.maximum(goal.orientation_tolerance, slack[1])
    return apart <= max(goal.position_tolerance, slack[0]) and bool(np.all(turned))


# --- joints ---


def _of_joints(
    scene: PlanningScene, group: str, goal: JointGoal, rng: np.random.Generator
) -> Iterator[Array]:
    """Draw random samples for a goal of joint positions, first near the exact goal, then from its whole
    tolerance region.
    """
    names = scene.model.group(group).joint_names
    low, high = joint_ranges(scene, group, ())
    named = np.array([name in goal.state.joint_names for name in names])
    center = scene.state.updated(goal.state).reindexed(names).positions
    for k in range(ATTEMPTS):
        reach = goal.tolerance * min(1.0, (k + 1) / (ATTEMPTS / 4))
        yield np.clip(center + np.where(named, rng.uniform(-reach, reach, len(names)), 0.0), low, high)


def full_turn_equivalents(
    model: RobotModel, joint_names: tuple[str, ...], q: Array, start: Array
) -> list[Array]:
    """List the joint positions (n,) that differ from the goal sample q (n,) only by full turns of joints,
    sorted by distance from the start.

    Joints that drive a mimic joint at a non-integer ratio keep their position.
    """
    followed = {j.mimic.joint for j in model.joints.values() if j.mimic and j.mimic.multiplier % 1.0}
    choices = []
    for name, value, at in zip(joint_names, q, start, strict=True):
        joint = model.joint(name)
        near = np.array([value])
        if joint.type != "prismatic" and name not in followed:
            turns = value + 2 * np.pi * (np.round((at - value) / (2 * np.pi)) + np.arange(-1, 2))
            within = turns[(turns >= joint.limits.lower - 1e-9) & (turns <= joint.limits.upper + 1e-9)]
            near = within if len(within) else near
        choices.append(sorted(near, key=lambda v, at=at: abs(v - at))[:2])
    found = [np.array(values) for values in itertools.product(*choices)]
    return sorted(found, key=lambda other: float(np.linalg.norm(other - start)))[:EQUIVALENTS]


# --- poses ---


def _of_pose(
    scene: PlanningScene, group: str, goal: PoseGoal, rng: np.random.Generator, deadline: float
) -> Iterator[Array]:
    """Draw random samples of joint positions for a pose goal. IK solutions of the exact goal pose alternate
    with IK solutions of random poses within the goal's tolerances.

    The exact solutions include equivalents by full turns; random poses are solved from random references.
    """
    moved_frame = MovedFrame(scene, group, goal.link)
    ik = ik_solver(scene.model, group, moved_frame.link)
    target = moved_frame.link_target(goal.T_world_link)
    exact = ik.solutions(target, scene.positions, rng, equivalents=True)
    for _ in range(ATTEMPTS):
        yield from islice(exact, 1)
        reference = scene.positions.copy()
        reference[ik.columns] = _random(ik, rng)
        yield from ik.nearest(moved_frame.link_target(_within(goal, rng)), reference, rng, among=1)
        if time.monotonic() > deadline:
            return


def _constraints_of(goal: PoseGoal) -> Constraints:
    """Convert the tolerances of a pose goal to constraints, from which goal states can be sampled.

    The regions are cubes inside the balls of the tolerances: a projection onto them has three directions.
    """
    side = 2 * max(goal.position_tolerance / np.sqrt(3), LEAST[1])
    cube = Box(side, side, side), SE3(SO3.identity(), goal.T_world_link.translation)
    turn = np.asarray(goal.orientation_tolerance, dtype=float)
    if turn.ndim == 0:
        turn = np.full(3, turn if turn >= np.pi else turn / np.sqrt(3))
    x, y, z = (float(v) for v in np.maximum(turn, LEAST[0]))
    turned = OrientationConstraint(goal.T_world_link.rotation, (x, y, z), goal.link)
    return Constraints(
        positions=(PositionConstraint((cube,), goal.link),),
        orientations=() if min(x, y, z) >= np.pi else (turned,),
    )


def _random(ik: IKSolver, rng: np.random.Generator) -> Array:
    return rng.uniform(
        np.where(np.isfinite(ik.lower), ik.lower, -np.pi), np.where(np.isfinite(ik.upper), ik.upper, np.pi)
    )


def _within(goal: PoseGoal, rng: np.random.Generator) -> SE3:
    """Sample a random pose within the tolerances of a pose goal, uniformly in position and rotation vector.

    Position and rotation vector are uniform in balls. With three angular tolerances, the rotation vector is
    uniform in their box.
    """

    def in_ball(radius: float) -> Array:
        direction = rng.normal(size=3)
        return direction / np.linalg.norm(direction) * radius * rng.random() ** (1 / 3)

    T = goal.T_world_link
    offset = in_ball(SHARE * goal.position_tolerance)
    if np.ndim(goal.orientation_tolerance) == 0:
        turn = SO3.exp(in_ball(min(SHARE * float(goal.orientation_tolerance), np.pi)))  # type: ignore[arg-type]
    else:
        turn = _turn(np.asarray(goal.orientation_tolerance, dtype=float), "rotation_vector", rng)
    return SE3(T.rotation @ turn, T.translation + offset)


def _turn(tolerance: Array, parameterization: str, rng: np.random.Generator) -> SO3:
    """Sample a random rotation for a pose goal. Its rotation error is within the tolerances (3,)."""
    most = np.minimum(np.where(tolerance < np.pi, SHARE * tolerance, np.pi), np.pi)
    for _ in range(TRIES):
        turn = rotation_of(rng.uniform(-most, most), parameterization)
        # Beyond half a turn, the same rotation has another error.
        error = rotation_error(SO3.identity(), turn, parameterization)
        if np.all((np.abs(error) <= tolerance) | (tolerance >= np.pi)):
            return turn
    return SO3.identity()


# --- constraints ---


def _of_constraints(
    scene: PlanningScene, group: str, wanted: Constraints, rng: np.random.Generator, deadline: float
) -> Iterator[Array]:
    """Draw random samples of joint positions for a goal that is defined by constraints.

    The sampler starts from the request's start or from random positions, and moves each of them to the
    nearest solution or to a random solution.
    """
    low, high = joint_ranges(scene, group, wanted.joints)
    columns = scene.model.columns(scene.model.group(group).joint_names)
    start = scene.positions[columns]
    wide_low = np.where(np.isfinite(low), low, np.minimum(start - np.pi, high))
    wide_high = np.where(np.isfinite(high), high, np.maximum(start + np.pi, low))
    few = len(start) < POSE_JOINTS and bool(wanted.positions or wanted.orientations)
    manifold = ConstraintManifold(scene, group, wanted) if few else None
    for k in range(ATTEMPTS):
        q = np.clip(start, low, high) if k == 0 else rng.uniform(wide_low, wide_high)
        if k % 4 == 1:  # joints without a constraint keep their position
            asked = {c.joint for c in wanted.joints}
            names = scene.model.group(group).joint_names
            stays = np.array([name not in asked for name in names])
            q = np.where(stays, start, q)
        if manifold is not None:
            solution = manifold.project(q, low, high)
        elif wanted.positions or wanted.orientations:
            solution = _pulled(scene, group, wanted, q, rng, clip=k % 2 == 0)
        else:
            solution = q
        if solution is not None and satisfies_constraints(scene, group, wanted, solution):
            yield solution
        if time.monotonic() > deadline:
            return


def _pulled(
    scene: PlanningScene, group: str, wanted: Constraints, q: Array, rng: np.random.Generator, clip: bool
) -> Array | None:
    """Move a goal sample q (n,) to joint positions at which the first constrained link satisfies its
    constraints.
    """
    first = (*wanted.positions, *wanted.orientations)[0]
    moved_frame = MovedFrame(scene, group, first.link)
    pose = moved_frame.pose(q)
    rotation = pose.rotation
    for o in wanted.orientations:
        if MovedFrame(scene, group, o.link).name == moved_frame.name:
            rotation = _rotation(scene, o, rotation, rng, clip)
            break
    at = pose.translation
    for c in wanted.positions:
        if MovedFrame(scene, group, c.link).name == moved_frame.name:
            at = _point(scene, c, pose.apply(c.point), rng, clip) - rotation.matrix @ np.asarray(c.point)
            break
    ik = ik_solver(scene.model, group, moved_frame.link)
    found = ik.nearest(moved_frame.link_target(SE3(rotation, at)), moved_frame.full(q), rng, among=1)
    return found[0] if found else None


def _rotation(
    scene: PlanningScene, c: OrientationConstraint, present: SO3, rng: np.random.Generator, clip: bool
) -> SO3:
    wanted = scene.frame_pose(c.frame).rotation @ c.rotation
    tolerance = np.asarray(c.tolerance, dtype=float)
    if not clip:
        return wanted @ _turn(tolerance, c.parameterization, rng)
    most = np.where(tolerance < np.pi, SHARE * tolerance, np.inf)
    error = rotation_error(wanted, present, c.parameterization)
    return wanted @ rotation_of(np.clip(error, -most, most), c.parameterization)


def _point(
    scene: PlanningScene, c: PositionConstraint, present: Array, rng: np.random.Generator, keep: bool
) -> Array:
    """Sample a point in the world from the region of a position constraint that belongs to a goal.

    The result is the current point if it is inside the region, otherwise a random point of the region.
    """
    if keep and region_distance(scene, c, present) == 0.0:
        return present
    shape, T_frame_shape = c.region[int(rng.integers(len(c.region)))]
    T = scene.frame_pose(c.frame) @ T_frame_shape
    if isinstance(shape, Plane):  # a half space: at the current depth, or on its surface
        at = T.inverse().apply(present)
        return T.apply((at[0], at[1], min(at[2], 0.0)))
    center, half = local_bounds(shape)
    for _ in range(TRIES):
        at = center + rng.uniform(-half, half)
        if distance_to_shape(shape, at) == 0.0:
            return T.apply(at)
    return T.apply(center)
