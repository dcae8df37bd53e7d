"""What would undo a contact: the least shift of an object, or the object away."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision import ExactChecker
from armcell.collision.exact import overlaps
from armcell.core import Contact
from armcell.planning.explanation import words
from armcell.planning.explanation.case import Case
from armcell.planning.explanation.changes import move_object, moved, remove_objects
from armcell.planning.explanation.nearest import DIRECTIONS
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

SHIFTS = 0.002 * 2.0 ** np.arange(10)  # [m], up to 1
FINE = 5e-4  # [m]
SPARE = 1e-3  # [m] more than the least


def pairs_of(contacts: Iterable[Contact]) -> list[tuple[str, str]]:
    return [(c.body_a, c.body_b) for c in contacts]


def objects_in(scene: PlanningScene, contacts: Iterable[Contact]) -> list[str]:
    """Objects of the world among what touches, in the order of the contacts."""
    return list(dict.fromkeys(n for pair in pairs_of(contacts) for n in pair if n in scene.objects))


def way_out(
    scene: PlanningScene, name: str, joint_names: tuple[str, ...], qs: list[Array], padded: bool = True
) -> Array | None:
    """The least shift (3,) [m], of 26 directions, that frees an object from the robot at each of qs (n,).

    It does not push the object into others. None where a metre does not free it.
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


def free_objects(case: Case, qs: list[Array], contacts: list[Contact], padded: bool) -> None:
    """Suggest to shift the objects that touch, or to take them away.

    Args:
        qs: of the group (n,), at all of which the objects must be free.
    """
    names = objects_in(case.started, contacts)
    for name in names[:3]:
        if case.time_left <= 0 or case.started.objects[name].has_cloud:
            continue
        offset = way_out(case.started, name, case.joint_names, qs, padded)
        if offset is None:
            continue
        case.say(f"{name} would be free of the robot {words.offset(offset)} from where it is")
        case.data.setdefault("way_out", {})[name] = offset.tolist()
        case.suggest(
            f"move {name} {words.offset(offset)}",
            move_object,
            {"name": name, "offset": offset},
            effort=float(np.linalg.norm(offset)),
        )
    if names:
        case.suggest(f"take {' and '.join(names)} away", remove_objects, {"names": names}, effort=np.inf)
