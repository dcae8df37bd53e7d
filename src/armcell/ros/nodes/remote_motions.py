"""Motions of a cell whose robot or simulator another program runs."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from armcell.cell import LiveCell
from armcell.core import InputError, JointTrajectory
from armcell.drivers import Driver, DriverProxy, ExecutionHandle
from armcell.model import Gripper
from armcell.ros.nodes.cell_motions import CellMotions
from armcell.ros.nodes.gripper_node import GripperMotions
from armcell.ros.nodes.motion_queue import MotionHandle
from armcell.ros.nodes.remote_driver import PATIENCE, RemoteDriver
from armcell.scene import PlanningScene

logger = logging.getLogger(__name__)


class RemoteMotions(CellMotions):
    """Motions of a cell whose robot is connected by a remote driver.

    Clients wait until the robot is there. Only one motion runs at a time, even with several arms, because the
    simulator's status messages do not identify their motion.
    """

    def __init__(self, live: LiveCell, driver: RemoteDriver):
        super().__init__(live, driver.controllers)
        self._driver = driver
        self.grippers = GripperMotions(live, self.conductor, PATIENCE)

    def _after_step(self) -> None:
        with suppress(InputError):  # the robot's state is unknown
            super()._after_step()

    def say(self, text: str) -> None:
        if text.startswith(("refused", "failed")):
            logger.warning("trajectory %s", text)
        else:
            super().say(text)

    def scene(self) -> PlanningScene:
        self._driver.wait_for_state()
        self._driver.wait_for_fingers()
        return super().scene()

    def queue_trajectory(self, *args: Any, **kwargs: Any) -> MotionHandle:
        self._driver.wait_for_state()
        return super().queue_trajectory(*args, **kwargs)

    def drive(self, gripper: Gripper, width: float, force: float) -> MotionHandle:
        self._driver.wait_for_state()
        if any(gripper.joint_name in joints for joints in self.controllers.values()):
            self._find((gripper.joint_name,), ())
        return super().drive(gripper, width, force)

    def _find(self, joints: Sequence[str], controllers: Sequence[str]) -> None:
        if controllers or self.controllers:
            super()._find(joints, controllers or tuple(self.controllers))
            self._driver.wait_for_controllers(joints, controllers)

    def _restricted(self, driver: Driver, controllers: Sequence[str]) -> Driver:
        return _Restricted(driver, self._driver, controllers)

    def _temporary_conflict(self, others: list[MotionHandle], new: JointTrajectory) -> str:
        return "one motion at a time" if any(not w.is_over for w in others) else ""


class _Restricted(DriverProxy):
    """Driver proxy for one of the remote motions. It moves the robot only with the named ROS controllers."""

    def __init__(self, driver: Driver, remote: RemoteDriver, controllers: Sequence[str]):
        super().__init__(driver)
        self._remote, self._names = remote, controllers

    def follow(self, trajectory: JointTrajectory) -> ExecutionHandle:
        return self._remote.follow(trajectory, self._names)
