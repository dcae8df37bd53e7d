"""Convex pieces of objects: convex, no larger than needed, the same again, and without CoACD too."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from armcell.collision import decompose
from armcell.core import Mesh


def ring(segments: int) -> tuple[Mesh, trimesh.Trimesh]:
    torus = trimesh.creation.torus(0.04, 0.01, major_sections=segments, minor_sections=12)
    return Mesh(torus.vertices, torus.faces.astype(np.int32)), torus


def volumes(pieces) -> list[float]:
    solids = [trimesh.Trimesh(p.vertices, p.faces, process=False) for p in pieces]
    assert all(s.is_watertight and s.is_convex for s in solids)
    return [float(s.volume) for s in solids]


def test_a_convex_mesh_stays_one():
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    assert len(decompose.object_pieces(Mesh(box.vertices, box.faces.astype(np.int32)))) == 1


def test_a_ring_keeps_its_hole_and_is_kept_on_disk(tmp_path, monkeypatch):
    pytest.importorskip("coacd", reason="extra 'decompose'")
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path))
    mesh, torus = ring(24)
    first = decompose.object_pieces(mesh)
    assert sum(volumes(first)) < 1.3 * torus.volume
    inside = [np.all(p.vertices.min(0) < 0) and np.all(p.vertices.max(0) > 0) for p in first]
    assert not any(inside)  # no piece's box spans the hole
    decompose.object_pieces.cache_clear()
    monkeypatch.setattr(decompose, "_coacd", lambda *_: pytest.fail("made again"))
    again = decompose.object_pieces(mesh)
    assert [p.vertices.tolist() for p in again] == [p.vertices.tolist() for p in first]


def test_without_coacd_our_own_cuts_hold_the_mesh(monkeypatch):
    monkeypatch.setattr(decompose, "can_decompose", lambda: False)
    mesh, torus = ring(20)
    assert sum(volumes(decompose.object_pieces(mesh))) > torus.volume


def test_where_coacd_crashes_our_own_cuts_are_taken(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(decompose, "can_decompose", lambda: True)
    monkeypatch.setattr(decompose, "_PROGRAM", "import os; os.kill(os.getpid(), 11)")
    mesh, torus = ring(16)
    assert sum(volumes(decompose.object_pieces(mesh))) > torus.volume
    assert "CoACD failed on this mesh" in caplog.text
