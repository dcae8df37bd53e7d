"""What may touch, said for a whole body instead of for a pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from armcell.scene.scene import PlanningScene


def expanded(scene: PlanningScene) -> Mapping[frozenset[str], bool]:
    """The pairs that a scene allows or forbids by name, and those it allows by a body's default.

    Pairs come before defaults; of two defaults "not allowed" wins (MoveIt's AllowedCollisionMatrix).
    """
    pairs = dict(scene.allowed_pairs)
    bodies = [*scene.model.links, *scene.objects, *scene.attached]
    for name, allow in scene.allowed_defaults.items():
        for other in bodies:
            if allow and other != name and scene.allowed_defaults.get(other, True):
                pairs.setdefault(frozenset((name, other)), True)
    return pairs


def forgotten(scene: PlanningScene, name: str) -> PlanningScene:
    """A scene in which nothing is said about the contacts of a body."""
    return replace(
        scene,
        allowed_pairs={pair: allow for pair, allow in scene.allowed_pairs.items() if name not in pair},
        allowed_defaults={k: allow for k, allow in scene.allowed_defaults.items() if k != name},
    )
