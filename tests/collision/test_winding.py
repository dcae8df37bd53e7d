"""Winding numbers by a tree are those of the plain sum over all triangles."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from armcell.collision import winding
from armcell.collision.winding import WindingNumbers


def bowl() -> trimesh.Trimesh:
    """Two nested spheres without their caps, overlapped by a box: open, and with a part inside another."""
    parts = []
    for radius in (0.1, 0.09):
        sphere = trimesh.creation.icosphere(4, radius)
        sphere.update_faces(sphere.triangles_center[:, 2] < 0.05)
        parts.append(sphere)
    parts[1].invert()
    parts.append(trimesh.creation.box((0.05, 0.05, 0.05)))
    vertices, faces = trimesh.util.append_faces([p.vertices for p in parts], [p.faces for p in parts])
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("mesh", [bowl(), trimesh.creation.torus(0.1, 0.03, 64, 64)], ids=["open", "closed"])
def test_a_tree_gives_the_sum_over_all_triangles(mesh, monkeypatch):
    points = np.random.default_rng(1).uniform(-0.15, 0.15, (1000, 3))
    sums, trees = (WindingNumbers(mesh.vertices, mesh.faces) for _ in range(2))
    monkeypatch.setattr(winding, "TREE", np.inf)
    plain = sums(points)
    monkeypatch.setattr(winding, "TREE", 0)
    assert np.allclose(trees(points), plain, atol=1e-12)
    assert sums._tree is None and trees._tree is not None
    assert 0.02 < (plain > 0.5).mean() < 0.5


def test_triangles_that_share_no_vertices(monkeypatch):
    soup = trimesh.creation.icosphere(3).triangles.reshape(-1, 3)
    faces = np.arange(len(soup)).reshape(-1, 3)
    monkeypatch.setattr(winding, "TREE", 0)
    numbers = WindingNumbers(soup, faces)
    assert np.allclose(numbers([[0, 0, 0], [2, 0, 0], [0.9, 0, 0]]), [1, 0, 1])
    assert numbers._tree is not None and len(numbers._tree.border) == 0  # no border saves time
