"""Thread-safe holder of the planning scene that tasks share."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from armcell.core import InputError
from armcell.scene import PlanningScene


class World:
    """Planning scene without measurements.

    Attributes:
        scene: may be read at any time. It is replaced while `editing` is held, never mutated.
        news: changes that have not been reported yet, oldest first.
        telling: lock of the thread that reports changes.
    """

    def __init__(self, scene: PlanningScene):
        self.scene = scene
        self.editing = threading.RLock()
        self.news: deque[dict[str, Any]] = deque()
        self.telling = threading.Lock()


def without_measured(
    base: PlanningScene, now: PlanningScene, after: PlanningScene, held: Iterable[str]
) -> PlanningScene:
    """Return the changed scene with measured values reset to those of the base scene.

    Args:
        base: the scene before the change.
        now: the base scene with measurements, from which `after` was made.
        held: names of objects that the hands report as held; they are attached again at the next measurement.
    Raises:
        InputError: a held object was removed.
    """
    objects = {n: base.objects[n] if o is now.objects.get(n) else o for n, o in after.objects.items()}
    attached = dict(after.attached)
    for name in held:
        if name not in now.attached:
            continue
        body = attached.pop(name, None)
        if body is None and name not in objects:
            raise InputError(
                f"object {name!r} is held by {now.attached[name].link}: it cannot be taken out of the scene",
                cure="let go of it first",
            )
        if body is now.attached[name]:
            objects[name] = base.objects[name]
        elif body is not None:
            objects[name] = after.object(name)
    return replace(after, objects=objects, attached=attached, positions=base.positions)
