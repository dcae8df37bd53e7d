"""The state of a simulated world, read from MuJoCo's data: joints, links, objects and contacts."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any, Self, cast

import mujoco
import numpy as np

from armcell.core import SE3, ArmcellError, JointState, UnknownNameError
from armcell.model import RobotModel
from armcell.scene import PlanningScene
from armcell.sim.contacts import PhysicsContact, read_contacts
from armcell.sim.model_pool import ModelLease
from armcell.sim.mujoco_model import BuiltModel, body_pose
from armcell.sim.objects import Array, FixedBodyPoses

CLOSED = "the simulation is closed: read its results inside the 'with' block"


class Closed:
    """Placeholder for the model and data of a closed simulated world. Any access raises an error."""

    def __getattr__(self, name: str) -> Any:
        raise ArmcellError(CLOSED)


class WorldState:
    """State of a simulated world: a leased MuJoCo model with its data. All poses are in the world frame.

    Attributes:
        robot: the scene's `RobotModel`.
        built: the model with the indices of its joints and bodies.
        lock: hold it to read the state while another thread steps the world.
        mj_model, mj_data: MuJoCo's model and data.
    """

    robot: RobotModel
    built: BuiltModel

    def __init__(self) -> None:
        self.lock = threading.RLock()

    def _open(self, lease: ModelLease) -> None:
        self._lease = lease
        self.built, self._data = lease.built, lease.data
        self.robot = lease.built.scene.model
        self._mj: mujoco.MjModel | None = self.built.mj
        self._fixed = FixedBodyPoses(self.mj_model)
        self._behind = False  # whether the body poses in `_data` are those before the last step

    def close(self) -> None:
        """Return the compiled model of the simulated world to the model pool; all later reads fail."""
        with self.lock:
            self._mj = None
            self._data = self.built = self._fixed = cast(Any, Closed())
            self._behind = False
            self._lease.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @property
    def mj_model(self) -> mujoco.MjModel:
        if self._mj is None:
            raise ArmcellError(CLOSED)
        return self._mj

    @property
    def mj_data(self) -> mujoco.MjData:
        if self._behind:
            with self.lock:
                mujoco.mj_kinematics(self.mj_model, self._data)
                self._behind = False
        return self._data

    @property
    def mj_state(self) -> mujoco.MjData:
        """Return MuJoCo's data (`MjData`) as the last step left them: joint states and forces are current,
        but body poses may be one step old. Use `mj_data` for current body poses.
        """
        return self._data

    @property
    def time(self) -> float:
        """Return the time [s] in the simulated world since the last reset."""
        return self._data.time

    def joint_state(self) -> JointState:
        """Return the state of the robot's actuated joints in the simulated world, in model order.

        Efforts include the gravity compensation of the arm.
        """
        data, built = self._data, self.built
        return JointState.unchecked(
            self.robot.joint_names,
            data.qpos[built.qpos],
            data.qvel[built.dofs],
            data.qfrc_actuator[built.dofs] + data.qfrc_gravcomp[built.dofs],
            data.time,
        )

    def link_pose(self, link: str) -> SE3:
        """Return the pose T_world_link of a robot link in the simulated world."""
        self.robot.link(link)
        return body_pose(self.mj_data, self.built.body[link])

    def object_pose(self, name: str) -> SE3:
        """Return the pose T_world_object of an object in the simulated world."""
        self._object(name)
        return body_pose(self.mj_data, self.built.body[name])

    def object_poses(self) -> dict[str, SE3]:
        """Return the poses T_world_object of all movable objects in the simulated world, by name."""
        return {name: self.object_pose(name) for name in self.built.moving}

    def object_twist(self, name: str) -> Array:
        """Return the twist (6,) of an object in the simulated world: linear [m/s], angular [rad/s].

        The linear velocity is that of the object's origin.
        """
        self._object(name)
        start = self.built.object_dof.get(name)
        if start is None:
            return np.zeros(6)
        velocity = self.mj_data.qvel[start : start + 6].copy()
        velocity[3:] = self.object_pose(name).rotation.matrix @ velocity[3:]  # qvel has the body frame here
        return velocity

    def _object(self, name: str) -> None:
        if name not in self.built.objects:
            raise UnknownNameError("object", name, self.built.objects)

    def contacts(self) -> list[PhysicsContact]:
        """Return the contacts of the last step of the simulated world with body names, deepest first."""
        return read_contacts(self.built, self.mj_data)

    def scene(self) -> PlanningScene:
        """Return the current state of the simulated world as a planning scene.

        The scene's positions are clipped to the joint limits, which physics treats as soft. Objects that were
        attached in the initial scene are ordinary objects in the returned scene.
        """
        scene, moving, body, fixed = self.built.scene, self.built.moving, self.built.body, self._fixed
        q = np.clip(self.mj_data.qpos[self.built.qpos], self.robot.lower, self.robot.upper)
        objects = {
            name: item.at(self.object_pose(name)) if name in moving or fixed.has_moved(body[name]) else item
            for name, item in self.built.objects.items()
        }
        return replace(scene, positions=q, objects=objects, attached={})
