"""Pose, velocity and Cartesian speed limits of a frame that a planning group moves.

The frame is a link or a frame attached to a link.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, InputError, JointTrajectory, UnknownNameError
from armcell.kinematics import kinematic_tree
from armcell.scene import PlanningScene
from armcell.timing import slow_down

Array = NDArray[np.float64]


class MovedFrame:
    """Frame that the joints of a planning group move: a link, or a frame attached to a link.

    Attributes:
        link: the robot link that carries the frame (the link itself if `name` is a link).
        T_link_point: pose of the frame in that link.
    Raises:
        UnknownNameError: no such link or attached object (or frame of one, `object/frame`).
        InputError: no name is given, and the group has no tip.
    """

    def __init__(self, scene: PlanningScene, group: str, name: str | None = None):
        name = name or scene.model.group(group).tip_link
        if name is None:
            raise InputError(
                f"group {group!r} is not a chain, so it has no tip", hint="name the link to place"
            )
        self.scene, self.name, self.tree = scene, name, kinematic_tree(scene.model)
        self.joint_names = scene.model.group(group).joint_names
        self.link, self.T_link_point = name, SE3.identity()
        if name not in scene.model.links:
            body = name.split("/")[0]
            if body not in scene.attached:
                known = [*scene.model.links, *scene.attached]
                raise UnknownNameError("link", name, known)
            self.link = scene.attached[body].link
            self.T_link_point = scene.frame_pose(self.link).inverse() @ scene.frame_pose(name)

    def full(self, q: ArrayLike) -> Array:
        """Return the joint positions (dof,) from which a moved frame's pose is computed: those of the robot
        in the scene, with the planning group at q (n,).
        """
        positions = self.scene.positions.copy()
        positions[self.scene.model.columns(self.joint_names)] = q
        return positions

    def pose(self, q: ArrayLike) -> SE3:
        """Compute the pose of the moved frame in the world for joint positions q (n,) of its planning
        group.
        """
        return self.tree.link_pose(self.full(q), self.link) @ self.T_link_point

    def link_target(self, T_world_name: SE3) -> SE3:
        """Convert a target pose of the moved frame to the target pose of the robot link to which the frame is
        attached.
        """
        return T_world_name @ self.T_link_point.inverse()

    def velocity(self, q: ArrayLike, qd: ArrayLike) -> Array:
        """Compute the linear velocity (3,) [m/s, world] of the moved frame's origin from the positions q (n,)
        and velocities qd (n,) of the planning group's joints.
        """
        full = self.full(q)
        twist = self.tree.jacobian(full, self.link, self.joint_names) @ np.asarray(qd)
        arm = self.tree.link_pose(full, self.link).rotation.matrix @ self.T_link_point.translation
        return twist[:3] + np.cross(twist[3:], arm)


def with_joint_positions(scene: PlanningScene, joint_names: tuple[str, ...], q: ArrayLike) -> PlanningScene:
    """Return a copy of the scene with the named joints at positions q (n,), to compute the pose of a moved
    frame. Joint limits are not checked.
    """
    positions = scene.positions.copy()
    positions[scene.model.columns(joint_names)] = q
    return replace(scene, positions=positions)


BETWEEN = 4  # speed samples between two points of a trajectory


def check_cartesian_speed(speed: float | None) -> None:
    """Check the Cartesian speed limit [m/s] of a moved frame. Raise an InputError unless the limit is a
    positive number or None.
    """
    if speed is not None and not (np.isfinite(speed) and speed > 0):
        raise InputError(f"max_cartesian_speed is {speed:g} m/s, it must be positive")


def limit_cartesian_speed(
    trajectory: JointTrajectory, moved_frame: MovedFrame, speed: float
) -> JointTrajectory:
    """Slow down a trajectory so that the Cartesian speed of a moved frame's origin never exceeds `speed`
    [m/s]. The planning group's joints move this frame.
    """
    return slow_down(trajectory, max(1.0, peak_cartesian_speed(trajectory, moved_frame) / speed))


def peak_cartesian_speed(trajectory: JointTrajectory, moved_frame: MovedFrame) -> float:
    """Compute the highest Cartesian speed [m/s] of a moved frame's origin along a trajectory. The frame is a
    robot link or attached to one.
    """
    times = trajectory.times
    fractions = np.arange(BETWEEN) / BETWEEN
    moments = np.append((times[:-1, None] + np.diff(times)[:, None] * fractions).ravel(), times[-1:])
    states = (trajectory.sample(float(t)) for t in moments)
    return max((float(np.linalg.norm(moved_frame.velocity(q, qd))) for q, qd, _ in states), default=0.0)
