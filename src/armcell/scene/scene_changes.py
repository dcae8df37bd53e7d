"""Differences between two scenes of one robot, for records and for replanning."""

from __future__ import annotations

from typing import Any

from armcell.scene.scene import PlanningScene


def scene_changes(before: PlanningScene, after: PlanningScene) -> dict[str, Any]:
    """Return what has changed between two scenes: the objects and the allowed collision pairs that differ.

    Joint positions and attached objects are not compared.

    Returns:
        Non-empty entries only: `added` and `changed` {name: CollisionObject}, `moved` {name: T_world_object},
        `removed` [name], and `allowed` [[a, b, allowed]], where `allowed` is None if the pair has no entry
            any more.
    """
    olds, news = before.objects, after.objects
    held = {*before.attached, *after.attached}
    both = [n for n in news if n in olds]
    shapes = {
        n: news[n] for n in both if news[n].shapes is not olds[n].shapes or news[n].color != olds[n].color
    }
    found = {
        "added": {n: o for n, o in news.items() if n not in olds and n not in held},
        "changed": shapes,
        "moved": {
            n: news[n].T_world_object
            for n in both
            if n not in shapes and not news[n].T_world_object.isclose(olds[n].T_world_object, 0.0, 0.0)
        },
        "removed": [n for n in olds if n not in news and n not in held],
        "allowed": [
            [*sorted(pair), after.allowed_pairs.get(pair)]
            for pair in sorted({*before.allowed_pairs, *after.allowed_pairs}, key=sorted)
            if before.allowed_pairs.get(pair) != after.allowed_pairs.get(pair)
        ],
    }
    return {kind: what for kind, what in found.items() if what}


def new_obstacles(before: PlanningScene, now: PlanningScene) -> list[str]:
    """Return the world objects that are new, moved or reshaped in a changed scene.
    They can make replanning necessary.
    """
    found = []
    for name, item in now.objects.items():
        was = before.objects.get(name)
        if was is item:
            continue
        held = before.attached.get(name)
        known = held.object if was is None and held is not None else was
        same = known is not None and known.shapes is item.shapes
        if not (same and (was is None or was.T_world_object.isclose(item.T_world_object))):
            found.append(name)
    return found
