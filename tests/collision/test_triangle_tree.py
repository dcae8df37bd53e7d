"""The tree of triangles gives the distances of a search through all triangles."""

from __future__ import annotations

import coal
import numpy as np
import pytest
import trimesh

from armcell.collision.coal_shapes import triangle_model
from armcell.collision.kernel.triangle_tree import TriangleTree, distances

SURFACES = {
    "torus": trimesh.creation.torus(0.1, 0.03, 32, 32),
    "long triangles": trimesh.creation.cylinder(0.02, 2.0, sections=60),
    "one triangle": trimesh.Trimesh(np.eye(3), [[0, 1, 2]], process=False),
}


@pytest.mark.parametrize("name", SURFACES)
def test_distances_are_coals(name):
    mesh = SURFACES[name]
    low, high = mesh.bounds
    points = np.random.default_rng(1).uniform(low - 0.1, high + 0.1, (300, 3))
    found = distances(points, TriangleTree.of(mesh.vertices[mesh.faces]))
    model, point = triangle_model(mesh.vertices, mesh.faces), coal.Sphere(1e-6)
    for p, distance in zip(points, found, strict=True):
        at = coal.Transform3s(np.eye(3), p)
        expected = coal.distance(
            model, coal.Transform3s(), point, at, coal.DistanceRequest(), coal.DistanceResult()
        )
        assert distance == pytest.approx(expected + 1e-6, abs=2e-6)


@pytest.mark.parametrize("corners", [(0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 2)])
def test_triangles_without_area_come_first(corners):
    """The search begins with the first triangle of the tree; its distance must be a number."""
    along = np.array([[-1.0, -1.0, -1.0], [-1.0, -1.0, 0.0], [-1.0, -1.0, 1.0]])[list(corners)]
    tree = TriangleTree.of(np.concatenate([along[None], trimesh.creation.box((0.5, 0.5, 0.5)).triangles + 9]))
    assert tree.order[0] == 0
    low, high = along[:, 2].min(), along[:, 2].max()
    points = np.array([[-1.5, -1.0, -0.3], [-1.0, -1.4, -2.0], [-1.0, -1.0, 1.5], [-1.3, -1.4, -0.5]])
    nearest = np.column_stack([points[:, 0] * 0 - 1, points[:, 1] * 0 - 1, np.clip(points[:, 2], low, high)])
    assert distances(points, tree) == pytest.approx(np.linalg.norm(points - nearest, axis=1))


def test_a_degenerate_triangle_is_an_edge():
    needle = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 0, 5], [0, 0, 5], [0, 0, 5]]])
    points = np.array([[1.5, 1.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 4.0]])
    assert distances(points, TriangleTree.of(needle)) == pytest.approx([1.0, 1.0, 1.0])
