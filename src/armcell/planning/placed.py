"""Links and what is fixed to them: where a name is when the group's joints are somewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, InputError, UnknownNameError
from armcell.kinematics import kinematic_tree
from armcell.scene import PlanningScene

Array = NDArray[np.float64]


class Placed:
    """A link, or something attached to one, that a group moves.

    Attributes:
        link: the robot's link that carries it (itself where it is a link).
        T_link_point: from that link to it.
    Raises:
        UnknownNameError: no such link or attached object (or frame of one, `object/frame`).
        InputError: none is named, and the group has no tip.
    """

    def __init__(self, scene: PlanningScene, group: str, name: str | None = None):
        name = name or scene.model.group(group).tip_link
        if name is None:
            raise InputError(
                f"group {group!r} is not a chain, so it has no tip", cure="name the link to place"
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
            self.T_link_point = scene.frame_pose(self.link).inv() @ scene.frame_pose(name)

    def full(self, q: ArrayLike) -> Array:
        """Positions (dof,) of all joints, the group's at q (n,)."""
        positions = self.scene.positions.copy()
        positions[self.scene.model.columns(self.joint_names)] = q
        return positions

    def pose(self, q: ArrayLike) -> SE3:
        """T_world_name at positions q (n,) of the group."""
        return self.tree.link_pose(self.full(q), self.link) @ self.T_link_point

    def link_target(self, T_world_name: SE3) -> SE3:
        """Where the carrying link has to be for a pose of this."""
        return T_world_name @ self.T_link_point.inv()

    def velocity(self, q: ArrayLike, qd: ArrayLike) -> Array:
        """Velocity (3,) [m/s] of its origin, in the world."""
        full = self.full(q)
        twist = self.tree.jacobian(full, self.link, self.joint_names) @ np.asarray(qd)
        arm = self.tree.link_pose(full, self.link).rotation.matrix @ self.T_link_point.translation
        return twist[:3] + np.cross(twist[3:], arm)


def positioned(scene: PlanningScene, joint_names: tuple[str, ...], q: ArrayLike) -> PlanningScene:
    """The scene with some joints at q (n,), unchecked."""
    positions = scene.positions.copy()
    positions[scene.model.columns(joint_names)] = q
    return replace(scene, positions=positions)
