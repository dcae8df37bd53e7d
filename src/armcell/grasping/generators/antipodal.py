"""Antipodal grasps of any closed surface: contact pairs whose normals oppose each other.

Points are sampled on the surface; a few rays go inwards from each point within the friction cone. Where a ray
leaves the solid is the second contact: the first exit grips a wall or rim, the last exit the whole object.
The hand may approach from all directions around the line through a pair (condition: Chen and Burdick 1993).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.grasping import hand_fit_kernel
from armcell.grasping.candidates import Proposals, generators
from armcell.grasping.generators.frames import directions_around, tcp_pose
from armcell.grasping.hand import Hand
from armcell.grasping.surface import Surface
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

SAMPLES = 350
PAIRS = 90  # maximum number of contact pairs
TURNS = 8  # approach directions around a pair
# tan of the angle between ray and normal, for friction 0.35; the object's friction is checked later
CONE = 0.35
DEPTHS = (0.0, 0.6)  # offsets of the contact towards the fingertips, as fractions of the pads' reach
THINNEST = 0.002  # [m]
MOST_TRIANGLES = 40_000


@generators.register("antipodal")
def antipodal_grasps(item: CollisionObject, surface: Surface, hand: Hand, up: Array) -> Proposals:
    """Propose antipodal grasps, whose two contacts are on opposite triangles of an object's surface.

    The result is deterministic.
    """
    rng = np.random.default_rng(0)
    found = Proposals()
    chosen = rng.permutation(len(surface.points))[:SAMPLES]
    start, normal = surface.points[chosen], surface.normals[chosen]
    rays = [-normal]
    for _ in range(2):  # two more rays per point within the cone
        aside = np.cross(normal, rng.normal(size=normal.shape))
        aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
        ray = -normal + CONE * np.sqrt(rng.uniform(size=(len(normal), 1))) * aside
        rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True))
    start, direction = np.tile(start, (3, 1)), np.concatenate(rays)
    normal = np.tile(normal, (3, 1))
    triangles = surface.triangles
    if len(triangles) > MOST_TRIANGLES:
        triangles = triangles[rng.permutation(len(triangles))[:MOST_TRIANGLES]]
    origin = start + 1e-6 * direction
    distance, where = hand_fit_kernel.cast(origin, direction, np.ascontiguousarray(triangles))
    a, b, c = (triangles[:, k] for k in range(3))
    outward = np.cross(b - a, c - a)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-18)
    pairs = []
    for exit in range(2):
        ok = where[:, exit] >= 0
        if exit == 1:
            ok &= where[:, 1] != where[:, 0]
        ok &= (distance[:, exit] > THINNEST) & (distance[:, exit] < hand.gripper.max_width)
        facing = np.einsum("ij,ij->i", outward[where[:, exit]], direction)
        ok &= facing > 1 / np.hypot(1.0, CONE)
        square = facing - np.einsum("ij,ij->i", direction, normal)
        middle = start + direction * distance[:, exit, None] / 2
        pairs += [(middle[i], direction[i], square[i]) for i in np.flatnonzero(ok)]
    for n, (middle, closing, _) in enumerate(_spread(pairs)):
        _come_in(found, n, middle, closing, hand, up)
    return found


def _spread(pairs: list[tuple]) -> list[tuple]:
    """Select at most `PAIRS` antipodal pairs of contacts that are well distributed over an object.

    The pair with the best-opposed normals comes first, then always the pair farthest from those chosen.
    """
    if len(pairs) <= PAIRS:
        return pairs
    at = np.array([np.concatenate([m / 0.02, c]) for m, c, _ in pairs])
    other = at * np.array([1, 1, 1, -1, -1, -1])  # the same pair with swapped contacts
    square = np.array([s for _, _, s in pairs])
    chosen = [int(np.argmax(square))]
    far = np.full(len(pairs), np.inf)
    while len(chosen) < PAIRS:
        last = at[chosen[-1]]
        far = np.minimum(far, np.minimum(((at - last) ** 2).sum(1), ((other - last) ** 2).sum(1)))
        chosen.append(int(np.argmax(far * (square - 1.5))))
    return [pairs[i] for i in chosen]


def _come_in(found: Proposals, n: int, middle: Array, closing: Array, hand: Hand, up: Array) -> None:
    """Propose grasp poses with all approach directions around one antipodal pair of contacts."""
    for k, approach in enumerate(directions_around(closing, TURNS, -up)):
        for d, share in enumerate(DEPTHS):
            point = middle - approach * share * hand.pad[1, 1]
            found.add(f"pair {n} at {360 // TURNS * k} deg{'' if d == 0 else ' at the tips'}",
                      tcp_pose(closing, approach, point))  # fmt: skip
