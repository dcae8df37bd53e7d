"""The world that tasks plan in: one value, which several threads may change."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from armcell.core import InputError
from armcell.scene import PlanningScene


class World:
    """The planning scene with nothing of it measured.

    Attributes:
        scene: read it at any time. It is replaced, while `editing` is held, never changed.
        news: what was changed and nobody has told yet, oldest first.
        telling: held by who tells them.
    """

    def __init__(self, scene: PlanningScene):
        self.scene = scene
        self.editing = threading.RLock()
        self.news: deque[dict[str, Any]] = deque()
        self.telling = threading.Lock()


def without_measured(
    base: PlanningScene, now: PlanningScene, after: PlanningScene, held: Iterable[str]
) -> PlanningScene:
    """The world after a change: what of it was only measured stays as it was.

    Args:
        base: the world before. now: the same as measured, which was changed into `after`.
        held: names of what hands hold, as they tell: to be attached again when it is measured.
    Raises:
        InputError: something that is held is gone.
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
