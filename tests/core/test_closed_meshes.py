"""Small holes of a mesh are filled; an open surface stays open."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from armcell.core import Mesh, is_closed, open_edges, with_small_holes_filled
from armcell.scene import shape_volume


def mesh_of(solid: trimesh.Trimesh, without: list[int] | None = None) -> Mesh:
    faces = np.delete(solid.faces, without or [], axis=0)
    return Mesh(np.array(solid.vertices), faces.astype(np.int32))


@pytest.fixture
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=0.05)


def test_a_closed_mesh_stays_as_it_was(ball):
    mesh = mesh_of(ball)
    assert is_closed(mesh)
    assert with_small_holes_filled(mesh) is mesh


@pytest.mark.parametrize("without", [[0], [0, 5, 17], list(range(12))])
def test_holes_are_filled_and_the_volume_returns(ball, without):
    holed = mesh_of(ball, without)
    assert len(open_edges(holed)) >= 3
    filled = with_small_holes_filled(holed)
    assert is_closed(filled)
    assert shape_volume(filled) == pytest.approx(ball.volume, rel=0.01)
    assert shape_volume(filled) < ball.volume + 1e-12


def test_a_wall_with_a_slit_keeps_its_cavity():
    """An open mesh counts as its convex hull: a cup with a slit must not become a solid lump."""
    cup = trimesh.creation.annulus(r_min=0.035, r_max=0.04, height=0.1)
    filled = with_small_holes_filled(mesh_of(cup, [3]))
    assert shape_volume(filled) == pytest.approx(cup.volume, rel=0.01)


def test_an_open_surface_stays_open(ball):
    half = mesh_of(ball, np.flatnonzero(ball.triangles_center[:, 2] > 0).tolist())
    assert with_small_holes_filled(half) is half
    assert not is_closed(half)


def test_repeated_vertices_and_bodies_that_share_an_edge_are_closed():
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    soup = Mesh(np.array(box.triangles.reshape(-1, 3)), np.arange(36, dtype=np.int32).reshape(-1, 3))
    assert is_closed(soup)
    other = box.copy().apply_translation((0.1, 0.1, 0.0))
    both = trimesh.Trimesh(
        np.vstack([box.vertices, other.vertices]), np.vstack([box.faces, other.faces + 8]), process=True
    )
    assert not both.is_watertight
    assert is_closed(mesh_of(both))
    assert shape_volume(mesh_of(both)) == pytest.approx(2e-3)


def test_a_mesh_with_triangles_turned_over_is_closed(ball):
    faces = np.array(ball.faces)
    faces[4] = faces[4, ::-1]
    assert is_closed(Mesh(np.array(ball.vertices), faces.astype(np.int32)))
