"""Diagnosis of contacts: the smallest shift of an object that frees the robot.

The diagnosis also suggests to remove the object.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision import ExactChecker
from armcell.collision.exact_checker import overlaps
from armcell.core import Contact
from armcell.planning.diagnosis import text_format
from armcell.planning.diagnosis.changes import move_object, moved, remove_objects
from armcell.planning.diagnosis.diagnosis import Diagnosis
from armcell.planning.diagnosis.nearest_free import DIRECTIONS
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

SHIFTS = 0.002 * 2.0 ** np.arange(10)  # [m], up to 1
FINE = 5e-4  # [m]
SPARE = 1e-3  # [m] added to the smallest shift


def pairs_of(contacts: Iterable[Contact]) -> list[tuple[str, str]]:
    """List the names of both bodies in each contact of a diagnosis."""
    return [(c.body_a, c.body_b) for c in contacts]


def objects_in(scene: PlanningScene, contacts: Iterable[Contact]) -> list[str]:
    """List the names of the world's objects in the contacts of a diagnosis, in the order of the contacts."""
    return list(dict.fromkeys(n for pair in pairs_of(contacts) for n in pair if n in scene.objects))


def least_freeing_shift(
    scene: PlanningScene, name: str, joint_names: tuple[str, ...], qs: list[Array], padded: bool = True
) -> Array | None:
    """Find the smallest shift (3,) [m] of an object that ends its contacts with the robot in all
    configurations qs (n,).

    The shift does not push the object into others. Return None if no shift up to a meter frees the object.
    """
    alone = replace(scene, objects={name: scene.objects[name]})
    inside = sum(depth for _, depth in overlaps(scene, name))

    def free(offset: Array) -> bool:
        checker = ExactChecker(moved(alone, name, offset), joint_names)
        if any(name in (c.body_a, c.body_b) for q in qs for c in checker.contacts(q, padded=padded)):
            return False
        return sum(depth for _, depth in overlaps(moved(scene, name, offset), name)) <= inside + FINE

    before = 0.0
    for size in SHIFTS:
        found = [d for d in DIRECTIONS if free(size * d)]
        if found:
            return min(
                (_least(free, d, before, size) * d for d in found), key=lambda v: float(np.linalg.norm(v))
            )
        before = size
    return None


def _least(free, direction: Array, low: float, high: float) -> float:
    while high - low > FINE:
        middle = (low + high) / 2
        low, high = (low, middle) if free(middle * direction) else (middle, high)
    return high + SPARE if free((high + SPARE) * direction) else high


def suggest_freeing_objects(
    diagnosis: Diagnosis, qs: list[Array], contacts: list[Contact], padded: bool
) -> None:
    """Suggest how to end contacts with the robot: move the objects in contact, or remove them.

    Args:
        qs: configurations of the group (n,) at which the objects must be free.
    """
    names = objects_in(diagnosis.start_scene, contacts)
    for name in names[:3]:
        if diagnosis.time_left <= 0 or diagnosis.start_scene.objects[name].has_cloud:
            continue
        offset = least_freeing_shift(diagnosis.start_scene, name, diagnosis.joint_names, qs, padded)
        if offset is None:
            continue
        diagnosis.add_finding(
            f"{name} would be free of the robot {text_format.offset(offset)} from where it is"
        )
        diagnosis.data.setdefault("way_out", {})[name] = offset.tolist()
        diagnosis.suggest(
            f"move {name} {text_format.offset(offset)}",
            move_object,
            {"name": name, "offset": offset},
            effort=float(np.linalg.norm(offset)),
        )
    if names:
        diagnosis.suggest(f"take {' and '.join(names)} away", remove_objects, {"names": names}, effort=np.inf)
