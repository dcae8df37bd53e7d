"""Emulated Franka controllers with all their network ports, and the emulated robot kind `franka`."""

from __future__ import annotations

import selectors
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, BinaryIO

from armcell.core import InputError
from armcell.core.checks import checked
from armcell.drivers.franka.settings import FrankaArmSettings, limits_of
from armcell.drivers.franka.wire.commands import PROTOCOLS
from armcell.emulators.franka.command_server import CommandServer
from armcell.emulators.franka.hand import Hand, HandServer
from armcell.emulators.franka.kinematics import urdf
from armcell.emulators.franka.operator_server import OperatorServer
from armcell.emulators.franka.plant import PERIOD, FrankaPlant
from armcell.emulators.franka.robot import Robot
from armcell.emulators.network import Network
from armcell.emulators.rack import Rack, SharedWorld, emulated_kinds, selector
from armcell.model import load_robot
from armcell.scene import PlanningScene
from armcell.sim import PhysicsSettings, SimWorld

TRACE, _TRACE_RECORD = struct.Struct("<B16d"), struct.Struct("<16d")
"""Trace record: arm index, monotonic time and robot time [s], actual and desired positions (7,) [rad]."""

TORQUE_PHYSICS = {"timestep": PERIOD, "arm_control": "torque"}  # settings for drives at 1 kHz
ANSWER_TIME = 0.0005  # [s] in which a client must be able to answer a state


@dataclass(frozen=True)
@checked()
class ControllerSettings:
    """Settings of one emulated Franka controller.

    Attributes:
        protocol: version of Franka's protocol; None: 5 for a Panda, 10 for an FR3.
    """

    model: str = "fr3"
    host: str = "127.0.0.3"
    locked: bool = False  # brakes locked
    active: bool = True  # the Franka Control Interface is active
    homed: bool = True  # the hand
    protocol: int | None = None

    @property
    def version(self) -> int:
        if self.protocol is not None:
            return self.protocol
        return 5 if self.model == "panda" else 10


def scene_without_cell() -> PlanningScene:
    """Return the scene for an emulated Franka controller without a cell. It contains an arm with a hand at
    its home position, but no objects.
    """
    model = load_robot("panda")
    home = {**model.named_states["arm"]["home"], **model.named_states["hand"]["open"]}
    return PlanningScene.of(model, [home[name] for name in model.joint_names])


def torque_world(scene: PlanningScene, physics: PhysicsSettings | None = None) -> SimWorld:
    """Return the physics world in which an emulated Franka controller drives the joints by torques at 1 kHz,
    for a scene.
    """
    return SimWorld(scene, replace(physics or PhysicsSettings(), **TORQUE_PHYSICS))


class FrankaController:
    """Emulated Franka controller with its robot, hand and ports. One control cycle takes 1 ms."""

    def __init__(self, settings: ControllerSettings, selector: selectors.BaseSelector, plant: FrankaPlant,
                 group: str):  # fmt: skip
        self.settings, self.plant = settings, plant
        self.network = Network(selector)
        self.period, self.answer_time = PERIOD, ANSWER_TIME
        self._resets = plant.resets
        limits = limits_of(settings.model)
        self.robot = Robot(limits, plant)
        if settings.locked:
            self.robot.brakes(True)
        self.hand = Hand(plant)
        self.hand.homed = settings.homed
        host = settings.host
        if settings.version not in PROTOCOLS:
            raise InputError(
                f"no version {settings.version} of Franka's protocol", hint=f"use one of {sorted(PROTOCOLS)}"
            )
        try:
            self.commands = CommandServer(
                self.robot, self.network, host, urdf(plant.world.robot, group, limits),
                PROTOCOLS[settings.version],
            )  # fmt: skip
            self.commands.set_active(settings.active)
            self._hand_server = HandServer(self.hand, self.network, host)
            self.operator = OperatorServer(self.robot, self.hand, self.commands, self, self.network, host)
        except BaseException:
            self.network.close()
            raise

    @property
    def in_use(self) -> bool:
        """Return whether a client uses the emulated Franka controller.
        A client that an injected fault has disconnected still counts.
        """
        return self.commands.connected or self.network.faults.refusing or self.network.faults.frozen

    def step(self) -> None:
        """Run one control cycle of the emulated Franka controller: the robot, the hand and the ports."""
        if self.plant.resets != self._resets:
            self._follow_reset()
        self.robot.step(self.commands.commands())
        self.commands.send_state()
        self._hand_server.step()
        self.network.flush()

    def reset(self) -> None:
        """Reset the arm, the hand and all objects of the emulated
        Franka controller to their initial state.
        """
        self.plant.reset()
        self._follow_reset()

    def _follow_reset(self) -> None:
        """Let the emulated Franka controller continue after the physics world was reset, by this controller
        or by one that shares the world.
        """
        self._resets = self.plant.resets
        self.hand.follow_reset()
        self.robot.follow_reset()
        self.robot.announce("the arm and its world are back at their start")

    def trace(self) -> bytes:
        r = self.robot
        return _TRACE_RECORD.pack(time.monotonic(), r.time * PERIOD, *r.q, *r.reference.q)

    def close(self) -> None:
        self.network.close()


class FrankaRack(Rack[FrankaController]):
    """Several emulated Franka controllers, each with its own plant, that run in one thread as a rack.

    Args:
        groups: planning group of each plant's arm.
        trace: file for records in the format `TRACE`.
        reset_between_runs: reset arms and objects to their start once all clients have disconnected.
    """

    def __init__(
        self,
        settings: Sequence[ControllerSettings],
        plants: Sequence[FrankaPlant],
        groups: Sequence[str],
        trace: BinaryIO | None = None,
        reset_between_runs: bool = False,
    ):
        super().__init__([], selector(), trace, reset_between_runs)
        try:
            for each, plant, group in zip(settings, plants, groups, strict=True):
                self.controllers.append(FrankaController(each, self._selector, plant, group))
        except BaseException:
            self.close()
            raise


class EmulatedFranka:
    """Factory of the robot kind `franka`: it creates an emulated Franka controller with all its ports for an
    arm in the cell's physics world.
    """

    physics: Mapping[str, Any] = TORQUE_PHYSICS

    def make(
        self, group: str, arm: FrankaArmSettings, shared: SharedWorld, io: selectors.BaseSelector,
        say: Callable[[str], None],
    ) -> FrankaController:  # fmt: skip
        plant = FrankaPlant(shared, group)
        made = FrankaController(ControllerSettings(arm.model, arm.host), io, plant, group)
        made.robot.listeners.append(say)
        return made


emulated_kinds.register("franka")(EmulatedFranka())
