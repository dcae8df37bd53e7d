"""For each kind of real robot, an emulated robot to run the contract tests against."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from typing import Any

from tests.drivers.franka.emulated import emulator as fci_emulator
from tests.drivers.franka.emulated import operate
from tests.drivers.toy_kind import ROBOTS, ToyKind, ToyRobot
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts, free_port

from armcell.drivers.real import robot_kinds
from armcell.emulators.franka import scene_without_cell
from armcell.model import RobotModel, load_robot

if "toy" not in robot_kinds:
    robot_kinds.register("toy")(ToyKind())


@dataclass
class Rig:
    """A robot that can be driven in mode `real`.

    Attributes:
        model: robot model of the cell; the arm is its group "arm".
        block: the arm's block in the cell file.
        stop, unlock: stop the robot as its safety functions do, and let an operator undo that.
    """

    model: RobotModel
    block: dict[str, Any]
    stop: Callable[[], object]
    unlock: Callable[[], object] = field(default=lambda: None)


@contextmanager
def ur() -> Iterator[Rig]:
    (host,) = free_hosts(1)
    with emulator("--model", "UR10", hosts=[host]):
        yield Rig(
            load_robot("ur10"), {"host": host, "port": free_port(), "model": "UR10"},
            lambda: dashboard(host, "armcell protective stop"),
            lambda: dashboard(host, "unlock protective stop"),
        )  # fmt: skip


@contextmanager
def toy() -> Iterator[Rig]:
    model, robot = load_robot("panda"), ToyRobot(7)
    ROBOTS["toy"] = robot
    robot.q = model.named_state("arm", "home").reindexed(model.group("arm").joint_names).positions.copy()
    yield Rig(
        model, {"host": "toy"}, lambda: setattr(robot, "stopped", True),
        lambda: setattr(robot, "stopped", False),
    )  # fmt: skip
    del ROBOTS["toy"]


@contextmanager
def franka() -> Iterator[Rig]:
    with fci_emulator() as host:
        yield Rig(
            scene_without_cell().model, {"host": host}, lambda: operate(host, "user stop on"),
            lambda: operate(host, "user stop off"),
        )  # fmt: skip


RIGS: dict[str, Callable[[], AbstractContextManager[Rig]]] = {"ur": ur, "toy": toy, "franka": franka}
