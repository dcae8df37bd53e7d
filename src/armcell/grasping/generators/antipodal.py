"""Antipodal grasps of any closed surface: contact pairs whose normals oppose each other.

Points are sampled on the surface in batches; a few rays go inwards from each point within the friction cone.
Where a ray leaves the solid is the second contact: the first exit grips a wall or rim, the last exit the
whole object. The hand may approach from all directions around the line through a pair (condition: Chen and
Burdick 1993).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from armcell.grasping import hand_fit_kernel
from armcell.grasping.candidates import Proposals, generators
from armcell.grasping.grasp import directions_around, tcp_pose
from armcell.grasping.hand import Hand
from armcell.grasping.surface import Surface
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

SAMPLES = 350  # surface points of a batch
PAIRS = 90  # maximum number of contact pairs of a batch
TURNS = 8  # approach directions around a pair; those of every second batch are between the others
CONE = 0.35  # minimum tan of the angle between ray and normal; an object of more friction has wider cones
DEPTHS = (0.0, 0.6)  # offsets of the contact towards the fingertips, as fractions of the pads' reach
MOST_TRIANGLES = 40_000

Pair = tuple[Array, Array, float]  # middle (3,) [m], direction (3,), sum of the cosines at both contacts


@generators.register("antipodal")
def antipodal_grasps(item: CollisionObject, surface: Surface, hand: Hand, up: Array) -> Iterator[Proposals]:
    """Propose antipodal grasps, whose two contacts are on opposite triangles of an object's surface.

    Each batch tries other points of the surface. The result is deterministic.
    """
    rng = np.random.default_rng(0)
    order = rng.permutation(len(surface.points))
    triangles = surface.triangles
    if len(triangles) > MOST_TRIANGLES:
        triangles = triangles[rng.permutation(len(triangles))[:MOST_TRIANGLES]]
    cone = max(CONE, item.material.friction)
    chosen: list[Pair] = []
    for batch, first in enumerate(range(0, len(order), SAMPLES)):
        tried = order[first : first + SAMPLES]
        pairs = _pairs(surface.points[tried], surface.normals[tried], triangles, cone, hand, rng)
        found = Proposals(covered=min((first + SAMPLES) / len(order), 1.0))
        for pair in _spread(pairs, chosen):
            _come_in(found, len(chosen), pair, 0.5 * (batch % 2), hand, up)
            chosen.append(pair)
        yield found


def _pairs(
    start: Array, normal: Array, triangles: Array, cone: float, hand: Hand, rng: np.random.Generator
) -> list[Pair]:
    """Return the antipodal contact pairs of surface points (n, 3) with their normals (n, 3)."""
    rays = [-normal]
    for _ in range(2):  # two more rays per point within the cone
        aside = np.cross(normal, rng.normal(size=normal.shape))
        aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
        ray = -normal + cone * np.sqrt(rng.uniform(size=(len(normal), 1))) * aside
        rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True))
    start, direction, normal = np.tile(start, (3, 1)), np.concatenate(rays), np.tile(normal, (3, 1))
    distance, where = hand_fit_kernel.cast(
        start + 1e-6 * direction, direction, np.ascontiguousarray(triangles)
    )
    a, b, c = (triangles[:, k] for k in range(3))
    outward = np.cross(b - a, c - a)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-18)
    found: list[Pair] = []
    for exit in range(2):
        ok = where[:, exit] >= 0
        if exit == 1:
            ok &= where[:, 1] != where[:, 0]
        ok &= (distance[:, exit] > hand.thinnest) & (distance[:, exit] < hand.gripper.max_width)
        facing = np.einsum("ij,ij->i", outward[where[:, exit]], direction)
        ok &= facing > 1 / np.hypot(1.0, cone)
        square = facing - np.einsum("ij,ij->i", direction, normal)
        middle = start + direction * distance[:, exit, None] / 2
        found += [(middle[i], direction[i], float(square[i])) for i in np.flatnonzero(ok)]
    return found


def _spread(pairs: list[Pair], before: list[Pair]) -> list[Pair]:
    """Select at most `PAIRS` antipodal pairs of contacts that are well distributed over an object.

    The pair with the best-opposed normals comes first, then always the pair farthest from those chosen and
    from the pairs `before`.
    """
    if len(pairs) <= PAIRS:
        return pairs
    at, square = _places(pairs), np.array([s for _, _, s in pairs])
    far = np.full(len(pairs), np.inf)
    for place in _places(before):
        far = np.minimum(far, _apart(at, place))
    chosen = [int(np.argmax(far * (square - 1.5) if before else square))]
    while len(chosen) < PAIRS:
        far = np.minimum(far, _apart(at, at[chosen[-1]]))
        chosen.append(int(np.argmax(far * (square - 1.5))))
    return [pairs[i] for i in chosen]


def _places(pairs: list[Pair]) -> Array:
    """Represent the contact pairs of antipodal grasps as vectors (n, 6), to compare the pairs: the midpoint
    [m] divided by 0.02 m, then the unit direction between the contacts.
    """
    return np.array([np.concatenate([m / 0.02, c]) for m, c, _ in pairs]).reshape(-1, 6)


def _apart(at: Array, place: Array) -> Array:
    """Return the squared distances (n,) between the contact pairs (n, 6) of antipodal grasps and one given
    contact pair (6,). The order of the two contacts in a pair does not matter.
    """
    swapped = place * np.array([1, 1, 1, -1, -1, -1])
    return np.minimum(((at - place) ** 2).sum(1), ((at - swapped) ** 2).sum(1))


def _come_in(found: Proposals, n: int, pair: Pair, shift: float, hand: Hand, up: Array) -> None:
    """Propose grasp poses with all approach directions around one antipodal pair of contacts.

    Args:
        shift: rotates the directions about the pair, in steps.
    """
    middle, closing, _ = pair
    first = directions_around(closing, 2 * TURNS, -up)[int(2 * shift)]
    for k, approach in enumerate(directions_around(closing, TURNS, first)):
        for d, share in enumerate(DEPTHS):
            point = middle - approach * share * hand.pad[1, 1]
            degrees = 360 / TURNS * (k + shift)
            found.add(f"pair {n} at {degrees:.0f} deg{'' if d == 0 else ' at the tips'}",
                      tcp_pose(closing, approach, point))  # fmt: skip
