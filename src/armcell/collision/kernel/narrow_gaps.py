"""Choice of the base links that need a finer sphere cover, since an arm link passes them at a small distance.

The upper arm of a UR5 is 16 mm from its base in most states: covers of 10 mm each overlap there, and the
kernel would test the convex pieces of both links in each of these states. A base link is never tested against
the world, so its finer cover costs no time elsewhere.
"""

from __future__ import annotations

import coal
import numpy as np

from armcell._array_store import keep, key_of, recall
from armcell.collision.coal_shapes import solid
from armcell.collision.kernel.bodies import FINE_OVERSHOOT, LINK_OVERSHOOT
from armcell.core import Mesh
from armcell.kinematics import kinematic_tree
from armcell.kinematics.tree import FIXED
from armcell.model import Link, RobotModel

VERSION = 1  # increase when the results change, to invalidate the disk cache
STATES = 32  # random states in which distances are computed
SHARE = 0.3  # share of the states in which only the finer cover leaves a gap
JOINTS = 2  # between the base and the other link; links with more joints between them are rarely that close


def narrow_gaps(model: RobotModel) -> frozenset[str]:
    """Return the base links that need a finer sphere cover, because their gap to another link is often too
    narrow for the normal cover.

    The distances are cached on disk.
    """
    tree = kinematic_tree(model)
    joints_above = {0: 0}
    for j, parent in enumerate(tree.parent.tolist()):
        joints_above[j + 1] = joints_above[parent] + int(tree.kind[j] != FIXED)
    links = [model.links[name] for name in tree.link_names]
    bases = [k for k, link in enumerate(links) if not joints_above[k] and _is_mesh(link)]
    pairs = [
        (base, k)
        for base in bases
        for k, link in enumerate(links)
        if joints_above[k] == JOINTS
        and _is_mesh(link)
        and frozenset((links[base].name, link.name)) not in model.disabled_collisions
    ]
    if not pairs:
        return frozenset()
    low, high = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    states = np.random.default_rng(0).uniform(low, high, (STATES, model.dof))
    poses = np.array([tree.link_transforms(q) for q in states])
    used = sorted({k for pair in pairs for k in pair})
    meshes = [a for k in used for a in _content(links[k])]
    key = key_of(repr((VERSION, pairs, FINE_OVERSHOOT, LINK_OVERSHOOT)), poses[:, used], *meshes)
    stored = recall("gaps", key)
    if stored is None:
        share = [
            np.mean([_needs_fine_cover(links[base], T[base], links[k], T[k]) for T in poses])
            for base, k in pairs
        ]
        stored = {"share": np.array(share)}
        keep("gaps", key, **stored)
    return frozenset(
        links[base].name for (base, _), share in zip(pairs, stored["share"], strict=True) if share >= SHARE
    )


def _is_mesh(link: Link) -> bool:
    return len(link.collisions) == 1 and isinstance(link.collisions[0].shape, Mesh)


def _content(link: Link) -> tuple[np.ndarray, ...]:
    (collision,) = link.collisions
    assert isinstance(collision.shape, Mesh)
    return collision.shape.vertices, collision.shape.faces.astype(np.int64), collision.T_link_shape.matrix


def _needs_fine_cover(base: Link, T_base: np.ndarray, other: Link, T_other: np.ndarray) -> bool:
    """Return whether the gap between a base and another link is too narrow for normal sphere covers of both,
    but wide enough with a finer cover of the base.
    """
    arguments = []
    for link, T in ((base, T_base), (other, T_other)):
        (collision,) = link.collisions
        T = T @ collision.T_link_shape.matrix
        arguments += [solid(collision.shape).exact, coal.Transform3s(T[:3, :3], T[:3, 3])]
    gap = coal.distance(*arguments, coal.DistanceRequest(), coal.DistanceResult())
    return FINE_OVERSHOOT + LINK_OVERSHOOT < gap < 2 * LINK_OVERSHOOT
