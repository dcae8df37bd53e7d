"""Injected faults of an emulated UR arm: unknown payload, joint offset, blocked joint."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.emulators.ur.plant import Plant

Array = NDArray[np.float64]

WORDS = "armcell fault payload <kg> | offset <0-5> <rad> | block <0-5> | arm none"


class FaultyPlant:
    """Plant that wraps another emulated UR plant to inject faults.
    Without a fault, it forwards every call.
    """

    def __init__(self, plant: Plant):
        self._plant = plant
        self._offset = np.zeros(6)
        self._blocked: dict[int, float] = {}  # joint -> blocked position [rad]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def command(self, q: Array, v: Array, *more: Any) -> None:
        q, v = np.array(q, dtype=float) + self._offset, np.array(v, dtype=float)
        if not hasattr(self._plant, "world"):  # physics blocks the joint itself
            for joint, at in self._blocked.items():
                q[joint], v[joint] = at, 0.0
        self._plant.command(q, v, *more)

    def offset(self, joint: int, angle: float) -> None:
        """Inject a fault into the UR plant: a constant error [rad] in the commanded position of one joint."""
        self._offset[joint] = angle

    def block(self, joint: int) -> None:
        """Inject a fault into an emulated UR arm: block a joint at its present position, whatever its motor
        does.
        """
        self._blocked[joint] = float(self._plant.read()[0][joint])
        if hasattr(self._plant, "world"):
            world: Any = self._plant
            world.world.block(world.world.robot.joint_names[world._columns[joint]])

    def payload(self, mass: float) -> None:
        """Inject a fault into the UR plant: a mass [kg] is attached to
        the last link without informing the controller.

        Raises:
            ValueError: the arm has no physics, so the mass would have no effect.
        """
        if not hasattr(self._plant, "world"):
            raise ValueError("no physics")
        plant: Any = self._plant
        plant.world.add_load(plant.tool_link, mass)


def set_fault(plant: Any, words: list[str]) -> Any:
    """Inject the fault that a command describes into an emulated UR plant, and return the faulty plant.
    For the command "arm none", return the original plant.

    Raises:
        ValueError: the words name no fault.
    """
    if words == ["arm", "none"]:
        return plant._plant if isinstance(plant, FaultyPlant) else plant  # masses and blocks stay
    faulty = plant if isinstance(plant, FaultyPlant) else FaultyPlant(plant)
    match words:
        case ["payload", mass]:
            faulty.payload(float(mass))
        case ["offset", joint, angle]:
            faulty.offset(int(joint), float(angle))
        case ["block", joint]:
            faulty.block(int(joint))
        case _:
            raise ValueError
    return faulty
