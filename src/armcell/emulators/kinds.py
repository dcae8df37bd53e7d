"""Emulated controllers for all real arms of a cell, of one or several vendors, in one physics world."""

from __future__ import annotations

import selectors
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, BinaryIO, Protocol

from armcell.core import InputError, Registry
from armcell.drivers.real import RealSettings
from armcell.emulators.rack import EmulatedController, Rack, selector
from armcell.emulators.shared_world import SharedWorld
from armcell.scene import PlanningScene
from armcell.sim import PhysicsSettings, SimWorld


class EmulatedKind(Protocol):
    """Interface of one robot kind's emulator, which creates an emulated controller for each arm of this kind
    in a cell.

    Attributes:
        physics: physics settings that the emulated drives need.
    """

    physics: Mapping[str, Any]

    def make(
        self, group: str, arm: Any, shared: SharedWorld, io: selectors.BaseSelector,
        say: Callable[[str], None],
    ) -> EmulatedController:  # fmt: skip
        """Return an emulated controller of this kind, whose ports are still closed.

        Args:
            group: planning group of the arm.
            arm: settings of the arm in the block `real`.
            io: I/O selector of the rack.
            say: receives a line for each event that the operator would see.
        """
        ...


emulated_kinds: Registry[EmulatedKind] = Registry("emulated kind of robot", "armcell.emulators")
"""Emulated robot kinds by the name that a cell file states in `real: {kind: ...}`."""


def cell_rack(
    settings: RealSettings, scene: PlanningScene, physics: PhysicsSettings, say: Callable[[str], None],
    trace: BinaryIO | None = None, reset_between_runs: bool = False,
) -> Rack[EmulatedController]:  # fmt: skip
    """Return emulated controllers for all real arms of a cell, which share one physics world.

    The addresses, models and kinds are those of the cell's block `real`.

    Args:
        scene: the cell's scene at the start.
        say: receives a line for each event that an operator would see at a robot.
        trace, reset_between_runs: see `Rack`.
    Raises:
        InputError: a robot kind has no emulator, or a port is in use.
    """
    kinds = {arm.kind: emulated_kinds[arm.kind] for arm in settings.arms.values()}
    needs: dict[str, Any] = {}
    for name, kind in kinds.items():
        if any(needs.get(key, value) != value for key, value in kind.physics.items()):
            raise InputError(f"the emulated {name} needs other physics settings than the other arms")
        needs |= kind.physics
    shared, io = SharedWorld(SimWorld(scene, replace(physics, **needs))), selector()
    rack: Rack[EmulatedController] = Rack([], io, trace, reset_between_runs)
    try:
        for group, arm in settings.arms.items():
            rack.controllers.append(kinds[arm.kind].make(group, arm, shared, io, say))
    except BaseException:
        rack.close()
        raise
    return rack
