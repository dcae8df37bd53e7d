"""Simulated twin that guards a cell's real arms, with the thresholds that `twin_learning.py` learns."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from armcell.cell.cell_hashes import HashedCell, content_hashes
from armcell.core import InputError
from armcell.scene import PlanningScene
from armcell.twin import UNWATCHED, ResidualThresholds, TwinGuard, TwinSimulation

logger = logging.getLogger(__name__)

DECIDING = ("robot", "physics", "real")
"""Parts of a cell that influence the thresholds: model, gains and drive settings."""


def thresholds_file(cell: HashedCell) -> Path:
    """Return the path of the file with a cell's twin thresholds: limits for the normal deviation between the
    real arms and their simulated twin.
    """
    return cell.file.with_name(f"{cell.file.stem}.twin.json")


def twin_identity(cell: HashedCell) -> dict[str, str]:
    hashes = content_hashes(cell)
    return {part: hashes[part] for part in DECIDING}


def twin_guard(cell: HashedCell, scene: PlanningScene, watch: bool) -> TwinGuard:
    """Return the twin guard of a cell, which compares the cell's real arms with their simulated twin.

    It compares only with `watch` and if thresholds were learned; with `watch` alone it logs a hint.

    Raises:
        InputError: the cell has changed since the thresholds were learned; the error names the changed parts.
    """
    file, bands = thresholds_file(cell), None
    if watch and os.path.isfile(file):
        bands = ResidualThresholds.load(file)
        now = twin_identity(cell)
        changed = [part for part in DECIDING if bands.identity.get(part) != now[part]]
        if changed:
            raise InputError(
                f"changed since the twin's bands were learned: {', '.join(changed)}", file=file,
                hint=f"learn them again, which begins with a slow loop: armcell twin {cell.file}",
            )  # fmt: skip
    elif watch:
        logger.info("%s; hint: armcell twin %s", UNWATCHED, cell.file)
    return TwinGuard(TwinSimulation(scene, cell.physics), bands, learning=not watch)
