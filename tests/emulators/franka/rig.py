"""An emulated Franka arm in lock-step, without network: for tests of its motions and reflexes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from armcell.drivers.franka.settings import FR3
from armcell.drivers.franka.wire.commands import MoveController, MoveGenerator, MoveRequest, MoveStatus
from armcell.drivers.franka.wire.state import RobotCommand, RobotMode, RobotState, read_state
from armcell.emulators.franka import FrankaPlant, scene_without_cell, torque_world
from armcell.emulators.franka.command_server import StateWriter
from armcell.emulators.franka.robot import Robot
from armcell.emulators.rack import SharedWorld
from armcell.scene import PlanningScene

Answer = Callable[[RobotState, float], RobotCommand | None]


class Rig:
    """One arm and a client that answers every state, or not."""

    def __init__(self, scene: PlanningScene | None = None):
        self.plant = FrankaPlant(SharedWorld(torque_world(scene or scene_without_cell())), "arm")
        self.robot = Robot(FR3, self.plant)
        self._writer = StateWriter(self.robot)
        self.answers: list[MoveStatus] = []
        self.texts: list[str] = []
        self.robot.listeners.append(self.texts.append)

    @property
    def state(self) -> RobotState:
        return read_state(self._writer.write())

    def idle(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.robot.step([])

    def start(
        self, generator: MoveGenerator, controller: MoveController = MoveController.JOINT_IMPEDANCE, **more
    ) -> None:
        self.answers.clear()
        self.robot.move(MoveRequest(controller, generator, **more), self.answers.append)

    def run(self, answer: Answer, milliseconds: int) -> np.ndarray:
        """Answer states until the motion ends; return the measured positions (k, 7) [rad]."""
        q = []
        for k in range(milliseconds):
            command = answer(self.state, k * 0.001)
            self.robot.step([] if command is None else [command])
            q.append(self.robot.q)
            if self.robot.mode is not RobotMode.MOVE:
                break
        return np.array(q)
