"""Physics world that the arms of several emulated controllers share, also of different vendors."""

from __future__ import annotations

from typing import Protocol

from armcell.sim import SimWorld


class SharedPlant(Protocol):
    """Interface of an emulated arm in a shared world."""

    def set_joint_targets(self, time: float) -> None:
        """Set an emulated arm's commands for the physics step of the shared world that ends at a world time
        [s].
        """
        ...

    def follow_reset(self) -> None:
        """Let an emulated arm continue from its initial state after the shared world was reset."""
        ...


class SharedWorld:
    """Physics world that the plants of one or several emulated arms share.

    Each plant is driven by its own emulated controller. The plants with the shortest control period advance
    the world, each by an equal part of the period.
    """

    def __init__(self, world: SimWorld):
        self.world = world
        self._plants: list[SharedPlant] = []
        self._periods: list[float] = []
        self._owed = 0.0  # [s]

    def join(self, plant: SharedPlant, period: float) -> None:
        """Add an emulated arm to the shared world. Its controller calls `advance` once per period [s]."""
        self._plants.append(plant)
        self._periods.append(period)

    def reset(self) -> None:
        """Reset all emulated arms and all objects in the shared world to their initial state."""
        self.world.reset()
        for plant in self._plants:
            plant.follow_reset()

    def advance(self, period: float) -> None:
        """Advance the shared world by one arm's share of its control period [s]. Each of the n arms with the
        shortest period contributes 1/n of the period.

        A remainder of less than one time step is kept for later.
        """
        shortest = min(self._periods)
        if period > shortest:
            return
        self._owed += period / self._periods.count(shortest)
        step = self.world.timestep
        while self._owed >= step - 1e-9:
            for plant in self._plants:
                plant.set_joint_targets(self.world.time + step)
            self.world.step()
            self._owed -= step
