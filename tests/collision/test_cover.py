"""The balls of a sphere cover are those of the plain greedy choice."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from armcell.collision.kernel.cover import _greedy, fit, interior_points, small_triangles, triangulated
from armcell.collision.kernel.triangle_tree import TriangleTree, distances
from armcell.core import Box, Cone, Cylinder, Mesh

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


def test_triangles_without_area_leave_no_gap():
    """Vendors' meshes contain triangles without area. One of them, the first in the tree, once gave all balls
    the radius NaN, and the planner did not see the link.
    """
    box = trimesh.creation.box((0.3, 0.2, 0.1))
    low = box.bounds[0]
    vertices = np.vstack([box.vertices, low - 1e-3, low])
    faces = np.vstack([[[8, 8, 9]], box.faces])
    cover = fit(Mesh(vertices, faces), OVERSHOOT)
    points = box.sample(3000, seed=1)
    apart = np.linalg.norm(points[:, None] - cover.centers[None], axis=2)
    assert np.all((apart <= cover.outer).any(axis=1))
    assert np.all(cover.inner <= 0.05 + 1e-9) and len(cover.centers) > 10
