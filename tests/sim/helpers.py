"""Scenes and moves for the tests of the sim room."""

from __future__ import annotations

import numpy as np

from armcell.core import SE3, SO3, Box
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.scene import CollisionObject, Material, PlanningScene
from armcell.sim import PhysicsSettings, SimWorld

CUBE = 0.05
PLACES = {"panda": (0.5, 0.0), "ur10_gripper": (0.7, 0.15)}


def solve_ik(model, joint_names, link, T, q):
    """Damped least squares from a seed; enough for a reachable pose near it."""
    tree, q = kinematic_tree(model), np.array(q, dtype=float)
    columns = model.columns(joint_names)
    for _ in range(300):
        now = tree.link_pose(q, link)
        error = np.r_[T.translation - now.translation, (T.rotation @ now.rotation.inverse()).log()]
        if np.linalg.norm(error) < 1e-9:
            return q
        J = tree.jacobian(q, link, joint_names)
        q[columns] += np.clip(J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(6), error), -0.2, 0.2)
    raise AssertionError(f"no IK for {link}")


def down(x: float, y: float, z: float) -> SE3:
    """A tcp pose that points down."""
    return SE3(SO3.from_rpy((np.pi, 0.0, 0.0)), np.array([x, y, z]))


class Grasping:
    """A robot whose open fingers are around a cube on a table."""

    def __init__(
        self,
        robot: str = "panda",
        mass: float = 0.1,
        friction: float = 0.8,
        settings: PhysicsSettings | None = None,
        material: Material | None = None,
    ):
        self.model = load_robot(robot)
        self.gripper = self.model.gripper()
        self.arm = self.model.group(self.gripper.arm_group).joint_names
        x, y = PLACES[robot]
        tcp = self.gripper.tcp_link
        material = material or Material(friction=friction)
        table = CollisionObject.single("table", Box(1.0, 1.0, 0.1), SE3.from_xyz(0.8, 0.0, -0.05))
        cube = CollisionObject.single(
            "cube",
            Box(CUBE, CUBE, CUBE),
            SE3.from_xyz(x, y, CUBE / 2),
            movable=True,
            mass=mass,
            material=material,
        )
        scene = PlanningScene.of(self.model, objects=[table, cube])
        self.low = solve_ik(self.model, self.arm, tcp, down(x, y, CUBE / 2), scene.positions)
        self.high = solve_ik(self.model, self.arm, tcp, down(x, y, CUBE / 2 + 0.15), self.low)
        self.world = SimWorld(scene.with_positions(self.low), settings)
        for finger in self.gripper.finger_links:
            self.world.monitor.allow(finger, "cube")

    def close(self, force: float = 32.0, seconds: float = 1.0) -> None:
        self.world.set_gripper_target(self.gripper.name, 0.0, force)
        self.world.step(round(seconds / self.world.timestep))

    def open(self, seconds: float = 1.0) -> None:
        self.world.set_gripper_target(self.gripper.name, self.gripper.max_width)
        self.world.step(round(seconds / self.world.timestep))

    def lift(self, seconds: float = 1.5, settle: float = 0.2) -> None:
        """Raise the hand by 0.15 m along a quintic in joint space, then wait."""
        world, columns = self.world, self.model.columns(self.arm)
        low, way = self.low[columns], (self.high - self.low)[columns]
        n = round(seconds / world.timestep)
        for i in range(1, n + 1):
            u = i / n
            s, ds = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2 / seconds
            world.set_arm_target(self.arm, low + s * way, ds * way)
            world.step()
        world.step(round(settle / world.timestep))
