"""Which link pairs need no checking: adjacent, always touching, never touching (by sampling the meshes)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from armcell.collision.exact import ExactChecker
from armcell.model import RobotModel
from armcell.scene import PlanningScene

ALWAYS_FRACTION = 0.95
"""MoveIt's figure: pairs that touch in at least this share of the samples are "always" in collision."""


def disabled_collision_pairs(
    model: RobotModel, samples: int = 10_000, seed: int = 0, progress: Callable[[int], None] | None = None
) -> dict[frozenset[str], str]:
    """Pairs of links with the reason ("Adjacent", "Default", "Always", "Never") to ignore their contact.

    "Default": touching in the model's default state. Samples are uniform within the joint limits.
    """
    adjacent = {frozenset((j.parent, j.child)) for j in model.joints.values()}
    # Links joined by fixed links without geometry are neighbours as well (panda_link7 and panda_hand).
    solid_parent: dict[str, str] = {}
    for joint in model.joints.values():
        parent = joint.parent
        if not model.links[parent].collisions and parent in solid_parent:
            parent = solid_parent[parent]
        solid_parent[joint.child] = parent
        if model.links[joint.child].collisions:
            adjacent.add(frozenset((parent, joint.child)))
    bare = replace(model, disabled_collisions=dict.fromkeys(adjacent, "Adjacent"))
    checker = ExactChecker(PlanningScene.of(bare))
    bodies = [link.name for link in model.links.values() if link.collisions]
    default = {frozenset((c.body_a, c.body_b)) for c in checker.contacts(model.default_positions())}
    rng = np.random.default_rng(seed)
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    high = np.where(np.isfinite(model.upper), model.upper, np.pi)
    touched: Counter[frozenset[str]] = Counter()
    for i in range(samples):
        for contact in checker.contacts(rng.uniform(low, high)):
            touched[frozenset((contact.body_a, contact.body_b))] += 1
        if progress and i % 100 == 99:
            progress(i + 1)
    result = {}
    for i, a in enumerate(bodies):
        for b in bodies[i + 1 :]:
            pair = frozenset((a, b))
            if pair in adjacent:
                result[pair] = "Adjacent"
            elif pair in default:
                result[pair] = "Default"
            elif touched[pair] >= ALWAYS_FRACTION * samples:
                result[pair] = "Always"
            elif touched[pair] == 0:
                result[pair] = "Never"
    return result
