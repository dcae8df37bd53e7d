"""Detection of the links that touch a held object."""

from __future__ import annotations

import numpy as np

from armcell.collision.exact_checker import ExactChecker
from armcell.core import InputError
from armcell.scene import PlanningScene

NEAR = 0.002
"""[m] Distance up to which a finger counts as touching: tolerance of its model and of the measured pose."""


def touching_links(scene: PlanningScene, name: str, within: float = NEAR) -> tuple[str, ...]:
    """Return the links within a distance [m] of a held object, nearest first. The planning scene should allow
    their contact with the object (touch links).

    Allowed contacts of the scene do not affect the result.

    Raises:
        InputError: `within` is negative or not finite.
    """
    if not np.isfinite(within) or within < 0:
        raise InputError(f"within is {within:g}, it must be a number of meters >= 0")
    scene.object(name)
    checker = ExactChecker(scene)
    checker.set_configuration(scene.positions)
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
    """Attach an object to a link and return the scene. The object keeps its pose, and the links that touch
    the object become its touch links.

    The touch links are the links that currently touch the object (see `touching_links`).
    """
    return scene.with_attached(name, link, touching_links(scene, name, within))
