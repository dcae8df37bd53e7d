"""A robot, alone or with a cube between its fingers; motions for it; drivers that misbehave."""

from __future__ import annotations

from functools import cache

import numpy as np

from armcell.core import SE3, Box, JointState, JointTrajectory
from armcell.drivers import DriverOptions, DriverProxy, drivers
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

CUBE = 0.05  # [m]
ROBOT = load_robot("panda")
GRIPPER = ROBOT.gripper()
ARM = ROBOT.group(GRIPPER.arm_group).joint_names


@cache
def alone() -> PlanningScene:
    """The arm at home in an empty world."""
    return PlanningScene.of(ROBOT)


@cache
def scene() -> PlanningScene:
    """The arm at home, its open fingers around a cube that stands on a post."""
    bare = alone()
    tcp = bare.frame_pose(GRIPPER.tcp_link).translation
    cube = Box(CUBE, CUBE, CUBE)
    stand = CollisionObject.single("stand", cube, SE3.from_xyz(tcp[0], tcp[1], tcp[2] - CUBE))
    return bare.with_object(stand).with_object(
        CollisionObject.single("cube", cube, SE3.from_xyz(*tcp), movable=True, mass=0.1)
    )


def make(name: str, world: PlanningScene | None = None, **options):
    """A driver of that name, by default with the cube; connect it with `with`."""
    return drivers[name](world or scene(), DriverOptions(**options))


def motion(goal: dict[str, float], duration: float = 1.5, start: JointState | None = None) -> JointTrajectory:
    """From the scene's state to other positions of some joints, at rest at both ends (a quintic)."""
    names = tuple(goal)
    q0 = (start or scene().state).reindexed(names).positions
    way = np.array(list(goal.values())) - q0
    u = np.linspace(0.0, 1.0, 16)
    s, ds = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2 / duration
    dds = (60 * u - 180 * u**2 + 120 * u**3) / duration**2
    return JointTrajectory(names, u * duration, q0 + np.outer(s, way), np.outer(ds, way), np.outer(dds, way))


def swing(angle: float = 0.5, duration: float = 1.5) -> JointTrajectory:
    """The whole arm, joint 1 by an angle [rad] and joint 4 by half of it back."""
    goal = scene().state.reindexed(ARM).as_dict()
    goal[ARM[0]] += angle
    goal[ARM[3]] -= angle / 2
    return motion(goal, duration)


class StuckJoint(DriverProxy):
    """One joint follows its commands no farther than to a limit, as if it ran against something."""

    def __init__(self, driver, joint: str, upper: float):
        super().__init__(driver)
        self.joint, self.upper = joint, upper

    def command(self, joint_names, positions, velocities):
        positions, velocities = np.array(positions, float), np.array(velocities, float)
        if self.joint in joint_names:
            i = joint_names.index(self.joint)
            if positions[i] > self.upper:
                positions[i], velocities[i] = self.upper, 0.0
        return self._driver.command(joint_names, positions, velocities)
