"""Allowed collisions of a planning scene: per-body defaults in addition to body pairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from armcell.scene.scene import PlanningScene


def explicit_allowed_pairs(scene: PlanningScene) -> Mapping[frozenset[str], bool]:
    """Return the allowed collision pairs of a scene.
    Defaults for single bodies are expanded to pairs of bodies.

    An entry for a pair takes precedence over defaults. If the defaults of two bodies disagree, their contact
    is not allowed, as in MoveIt's AllowedCollisionMatrix.

    Returns:
        Pair of body names -> whether their contact is allowed.
    """
    pairs = dict(scene.allowed_pairs)
    bodies = [*scene.model.links, *scene.objects, *scene.attached]
    for name, allow in scene.allowed_defaults.items():
        for other in bodies:
            if allow and other != name and scene.allowed_defaults.get(other, True):
                pairs.setdefault(frozenset((name, other)), True)
    return pairs


def without_allowed_entries(scene: PlanningScene, name: str) -> PlanningScene:
    """Return the scene without any allowed-collision entries for a given body."""
    return replace(
        scene,
        allowed_pairs={pair: allow for pair, allow in scene.allowed_pairs.items() if name not in pair},
        allowed_defaults={k: allow for k, allow in scene.allowed_defaults.items() if k != name},
    )
