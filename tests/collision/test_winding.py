"""Winding numbers by columns or a tree are those of the plain sum over all triangles."""

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
def test_columns_and_a_tree_give_the_sum_over_all_triangles(mesh, monkeypatch):
    points = np.random.default_rng(1).uniform(-0.15, 0.15, (1000, 3))
    sums, columns, trees = (WindingNumbers(mesh.vertices, mesh.faces) for _ in range(3))
    monkeypatch.setattr(winding, "FEW", np.inf)
    plain = sums(points)
    assert 0.02 < (plain > 0.5).mean() < 0.5
    monkeypatch.setattr(winding, "FEW", 0)
    monkeypatch.setattr(winding, "SHORT", np.inf)
    assert np.allclose(columns(points), plain, atol=1e-12)
    monkeypatch.setattr(winding, "SHORT", -1)
    monkeypatch.setattr(winding, "TREE", 0)
    assert np.allclose(trees(points), plain, atol=1e-12)
    assert columns._tree is None and trees._tree is not None


def test_rays_through_corners_and_edges_of_a_grid():
    box = trimesh.creation.box((2.0, 2.0, 2.0)).subdivide().subdivide()  # corners every 0.5
    axis = np.arange(-1.25, 1.5, 0.25)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    points = points[(np.abs(points) != 1.0).all(axis=1)]  # not on the surface
    found = WindingNumbers(box.vertices, box.faces)(points)
    assert np.array_equal(found, (np.abs(points) < 1.0).all(axis=1))


def test_triangles_that_share_no_vertices(monkeypatch):
    soup = trimesh.creation.icosphere(3).triangles.reshape(-1, 3)
    faces = np.arange(len(soup)).reshape(-1, 3)
    monkeypatch.setattr(winding, "FEW", 0)
    monkeypatch.setattr(winding, "TREE", 0)
    numbers = WindingNumbers(soup, faces)
    assert np.allclose(numbers([[0, 0, 0], [2, 0, 0], [0.9, 0, 0]]), [1, 0, 1])
    assert numbers._tree is not None and len(numbers._tree.border) == 0  # no border saves time
