"""Which links hold an object: those that touch it, or nearly do."""

from __future__ import annotations

import numpy as np

from armcell.collision.exact import ExactChecker
from armcell.core import InputError
from armcell.scene import PlanningScene

NEAR = 0.002
"""[m] Fingers that hold an object are modelled or measured that far off it."""


def touching_links(scene: PlanningScene, name: str, within: float = NEAR) -> tuple[str, ...]:
    """Links whose surface is at most `within` [m] from an object where both now are, nearest first.

    What the scene allows to touch does not matter.
    """
    if not np.isfinite(within) or within < 0:
        raise InputError(f"within is {within:g}, it must be a number of metres >= 0")
    scene.object(name)
    checker = ExactChecker(scene)
    checker.place(scene.positions)
    of_object = [i for i, g in enumerate(checker.geometries) if g.body == name]
    of_links = [i for i, g in enumerate(checker.geometries) if g.body in scene.model.links]
    pairs = np.array([(i, j) for i in of_links for j in of_object], dtype=np.int64).reshape(-1, 2)
    found: dict[str, float] = {}
    for a, b in pairs[checker.pair_gaps(pairs) <= within]:
        distance = checker.pair_distance(int(a), int(b))
        link = checker.geometries[int(a)].body
        if distance <= within:
            found[link] = min(distance, found.get(link, np.inf))
    return tuple(sorted(found, key=lambda link: found[link]))


def attached_by_contact(scene: PlanningScene, name: str, link: str, within: float = NEAR) -> PlanningScene:
    """An object fixed to a link where it is; it may touch the links that it touches now, and no other."""
    return scene.with_attached(name, link, touching_links(scene, name, within))
