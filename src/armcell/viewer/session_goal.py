"""Goal and settings of a planning session, and the reachability check of the goal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    SO3,
    CartesianRequest,
    Constraints,
    Contact,
    Goal,
    InputError,
    JointGoal,
    JointState,
    OrientationConstraint,
    PlanRequest,
    PoseGoal,
)
from armcell.kinematics import ik_solver, kinematic_tree
from armcell.planning import find_planner, sampling_bounds
from armcell.scene import PlanningScene
from armcell.timing import check_scaling

Array = NDArray[np.float64]

FREE, UPRIGHT, LINE = "free", "keep upright", "straight line"
MOTIONS = (FREE, UPRIGHT, LINE)
TILT = float(np.deg2rad(10.0))  # [rad] tolerance of an upright tip
TRIES = 2000  # random samples tested for a collision-free state


@dataclass(frozen=True)
class PlanSettings:
    """Settings with which a session plans to its goal: pipeline, planner, speeds and type of motion. The user
    selects them in the panel.
    """

    pipeline: str = "native"
    planner: str = "RRTConnect"
    planning_time: float = 5.0  # [s]
    attempts: int = 1
    velocity_scaling: float = 1.0  # (0, 1]
    acceleration_scaling: float = 1.0  # (0, 1]
    motion: str = FREE  # one of MOTIONS

    def check(self) -> None:
        """Raise InputError if a setting for planning to the session's goal is invalid."""
        find_planner(self.pipeline, self.planner)
        check_scaling(self.velocity_scaling, "velocity scaling")
        check_scaling(self.acceleration_scaling, "acceleration scaling")
        if not (np.isfinite(self.planning_time) and self.planning_time > 0):
            raise InputError(f"planning time is {self.planning_time:g} s, it must be positive")
        if self.attempts < 1:
            raise InputError(f"attempts is {self.attempts}, it must be at least 1")
        if self.motion not in MOTIONS:
            raise InputError(f"motion is {self.motion!r}", hint=f"choose one of {', '.join(MOTIONS)}")

    def with_request_values(self, request: PlanRequest | CartesianRequest) -> PlanSettings:
        """Return a copy of the settings for planning to the session's goal, updated with the values of a
        planning request (planner, speeds, type of motion).
        """
        speeds: dict[str, Any] = {
            "velocity_scaling": request.velocity_scaling,
            "acceleration_scaling": request.acceleration_scaling,
        }
        if isinstance(request, CartesianRequest):
            return replace(self, motion=LINE, **speeds)
        return replace(
            self,
            pipeline=request.pipeline_id or "native",
            planner=request.planner_id,
            planning_time=request.planning_time,
            attempts=request.attempts,
            motion=UPRIGHT if request.path_constraints else FREE,
            **speeds,
        )


@dataclass(frozen=True, eq=False)
class GoalView:
    """Goal state of the robot in a planning session, as shown in the panel.

    Attributes:
        positions: positions (dof,) of all joints; for an unreachable pose the nearest state found.
        status: "free", "collision" or "out of reach".
        text: the status as text, with the colliding pair or the distance.
        T_world_tip: requested pose of the group's tip link; None if the group has no tip link.
        by_pose: True if the goal was given as a pose instead of joint positions.
    """

    positions: Array
    status: str
    text: str
    contacts: tuple[Contact, ...] = ()
    T_world_tip: SE3 | None = None
    by_pose: bool = False


def check_goal_positions(scene: PlanningScene, group: str, positions: Array, start: Array) -> GoalView:
    """Check the goal positions (dof,) of a session for collisions. Where the state `start` (dof,) already
    violates the padding of an obstacle, the padding is reduced.
    """
    names = scene.model.group(group).joint_names
    checker = KernelChecker(replace(scene, positions=positions), names)
    columns = checker.columns
    checker.relax_margins(start[columns])
    tip = scene.model.group(group).tip_link
    T = None if tip is None else kinematic_tree(scene.model).link_pose(positions, tip)
    if checker.is_free(positions[columns]):
        return GoalView(positions, "free", "free", T_world_tip=T)
    return _touching(checker, positions, T, by_pose=False)


def _touching(checker: KernelChecker, positions: Array, T: SE3 | None, by_pose: bool) -> GoalView:
    contacts = tuple(checker.exact.contacts(positions[checker.columns]))
    text = "; ".join(c.describe() for c in contacts[:3]) or "in collision"
    return GoalView(positions, "collision", text, contacts, T, by_pose)


def solve_goal_pose(scene: PlanningScene, group: str, T_world_tip: SE3, near: Array, seed: int) -> GoalView:
    """Solve IK for the goal pose of a session and return the collision-free solution that is nearest to
    `near` (dof,).

    If all solutions collide, the nearest of them is returned; for an unreachable pose, the closest state.

    Raises:
        InputError: the group has no tip link, or the pose is not finite.
    """
    ik = ik_solver(scene.model, group)
    checker = KernelChecker(scene, ik.joint_names)
    checker.relax_margins(scene.positions[ik.columns])
    found = ik.solve(T_world_tip, near, checker.is_free, np.random.default_rng(seed))
    positions = near.copy()
    if found.positions is not None:
        positions[ik.columns] = found.positions
    if found.ok:
        return GoalView(positions, "free", "free", T_world_tip=T_world_tip, by_pose=True)
    if "invalid" in found.evidence:
        return _touching(checker, positions, T_world_tip, by_pose=True)
    text = (
        f"out of reach: the closest is {found.position_error * 1000:.0f} mm and "
        f"{np.rad2deg(found.rotation_error):.0f} deg away"
    )
    return GoalView(positions, "out of reach", text, T_world_tip=T_world_tip, by_pose=True)


def random_positions(scene: PlanningScene, group: str, rng: np.random.Generator) -> Array:
    """Sample a random collision-free goal (n,) of a group for the session, uniformly within the joint limits.

    Joints without limits are sampled within one turn around their current position.

    Raises:
        InputError: none of `TRIES` samples was collision-free.
    """
    names = scene.model.group(group).joint_names
    checker = KernelChecker(scene, names)
    here = scene.positions[checker.columns]
    lower, upper = sampling_bounds(scene.model, names, here, [here])
    for _ in range(TRIES):
        q = rng.uniform(lower, upper)
        if checker.is_free(q):
            return q
    raise InputError(f"none of {TRIES} random states of group {group!r} is free", hint="clear the scene")


def keep_upright(scene: PlanningScene, group: str) -> Constraints:
    """Return a path constraint that keeps the tip upright during the motion to the goal of a planning
    session. The tip may still rotate about the vertical.

    The tip axis that is nearest to the vertical at the start may tilt by at most `TILT`. Tolerances are
    rotation vectors in the axes of the target orientation; the component about the vertical axis is free.
    """
    tip = scene.model.group(group).tip_link
    R = scene.frame_pose(str(tip)).rotation
    axis = int(np.argmax(np.abs(R.matrix[2])))  # world z components of the tip's axes
    vertical = np.array([0.0, 0.0, np.sign(R.matrix[2, axis])])
    wanted = SO3.between(R.matrix[:, axis], vertical) @ R
    tolerance = [TILT, TILT, TILT]
    tolerance[axis] = np.pi
    x, y, z = tolerance
    return Constraints(orientations=(OrientationConstraint(wanted, (x, y, z)),), name="upright")


def first_group(scene: PlanningScene) -> str:
    """Return the group of the robot whose goal a new planning session shows by default.

    Prefer a gripper's arm group, then the first chain, then the first group with joints.

    Raises:
        InputError: the robot has no group with joints.
    """
    model = scene.model
    names = [g.arm_group for g in model.grippers.values()]
    names += [g.name for g in model.groups.values() if g.tip_link and g.joint_names]
    names += [g.name for g in model.groups.values() if g.joint_names]
    if not names:
        raise InputError(
            f"robot {model.name!r} has no planning group with joints", hint="run armcell setup on its URDF"
        )
    return names[0]


def requested_goal(scene: PlanningScene, group: str, goal: GoalView) -> Goal:
    """Return the planning session's joint goal, or the requested pose if the joint goal is invalid.

    Planning to the pose then fails with an explanation of the invalid goal.
    """
    if goal.by_pose and goal.status != "free":
        assert goal.T_world_tip is not None
        return PoseGoal(goal.T_world_tip)
    names = scene.model.group(group).joint_names
    return JointGoal(JointState(scene.model.joint_names, goal.positions).reindexed(names))
