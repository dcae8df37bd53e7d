"""Faults of an emulated arm, on demand: a payload nobody told of, a joint that is off, or blocked."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.control.ur_controller.plant import Plant

Array = NDArray[np.float64]

WORDS = "armcell fault payload <kg> | offset <0-5> <rad> | block <0-5> | arm none"


class FaultyPlant:
    """A plant with something wrong; without any fault it passes everything on."""

    def __init__(self, plant: Plant):
        self._plant = plant
        self._offset = np.zeros(6)
        self._blocked: dict[int, float] = {}  # joint -> where it stands [rad]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def command(self, q: Array, v: Array, *more: Any) -> None:
        q, v = np.array(q, dtype=float) + self._offset, np.array(v, dtype=float)
        if not hasattr(self._plant, "world"):  # without physics it simply stays; physics knows how to block
            for joint, at in self._blocked.items():
                q[joint], v[joint] = at, 0.0
        self._plant.command(q, v, *more)

    def offset(self, joint: int, angle: float) -> None:
        """A joint is an angle [rad] from where it is told to be."""
        self._offset[joint] = angle

    def block(self, joint: int) -> None:
        """A joint does not move any more, whatever its motor does."""
        self._blocked[joint] = float(self._plant.read()[0][joint])
        if hasattr(self._plant, "world"):
            world: Any = self._plant
            world.world.block(world.world.robot.joint_names[world._columns[joint]])

    def payload(self, mass: float) -> None:
        """A mass [kg] hangs on the last link, which the controller knows nothing of.

        Raises:
            ValueError: this arm has no physics that would feel it.
        """
        if not hasattr(self._plant, "world"):
            raise ValueError("no physics")
        plant: Any = self._plant
        plant.world.add_load(plant.tool_link, mass)


def set_fault(plant: Any, words: list[str]) -> Any:
    """The plant (a `Plant`) with a fault more; "arm none" gives the one without.

    Raises:
        ValueError: no such fault.
    """
    if words == ["arm", "none"]:
        return plant._plant if isinstance(plant, FaultyPlant) else plant  # what was hung on or blocked stays
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
