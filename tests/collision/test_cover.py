"""The balls of a sphere cover are those of the plain greedy choice."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.collision.kernel.cover import _greedy, interior_points, small_triangles, triangulated
from armcell.collision.kernel.triangle_tree import TriangleTree, distances
from armcell.core import Box, Cone, Cylinder

OVERSHOOT = 0.01


def chosen_plainly(elements, centers, reach2):
    """Choose balls as `_greedy` does, with all pairs of balls and elements in one table."""
    squared = ((elements[None] - centers[:, None, None]) ** 2).sum(axis=3)  # (m, n, 3)
    holds = (squared <= reach2[:, None, None]).all(axis=2)
    held, chosen = np.zeros(len(elements), dtype=bool), []
    while (gain := (holds & ~held).sum(axis=1)).max() > 0:
        chosen.append(int(gain.argmax()))
        held |= holds[chosen[-1]]
    return chosen, held


@pytest.mark.parametrize("shape", [Box(0.12, 0.09, 0.05), Cylinder(0.04, 0.08), Cone(0.05, 0.1)])
def test_balls_are_those_of_the_plain_greedy_choice(shape):
    vertices, faces, _ = triangulated(shape)
    skin = small_triangles(vertices, faces, 0.7 * OVERSHOOT)
    inside = interior_points(vertices, faces, 0.8 * OVERSHOOT)
    elements = np.concatenate([skin, np.repeat(inside[:, None, :], 3, axis=1)])
    # Balls at the surface, and one outside of everything: it contains no element.
    centers = np.concatenate([inside, skin.mean(axis=1)[::40], [[9.0, 9.0, 9.0]]])
    depth = np.concatenate([distances(inside, TriangleTree.of(skin)), np.zeros(len(centers) - len(inside))])
    reach2 = (depth + OVERSHOOT) ** 2
    balls, held = _greedy(elements, centers, reach2)
    expected, expected_held = chosen_plainly(elements, centers, reach2)
    assert balls.tolist() == expected
    assert np.array_equal(held, expected_held)
