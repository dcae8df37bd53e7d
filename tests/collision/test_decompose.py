"""Convex pieces of objects: they contain the mesh, hardly exceed its volume, and leave its openings free."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from armcell.collision import convex_decomposition, object_decomposition
from armcell.collision.winding import WindingNumbers
from armcell.core import Mesh


def cup(radius: float = 0.04, height: float = 0.1, wall: float = 0.003) -> trimesh.Trimesh:
    inner = radius - wall
    profile = [(0, 0), (radius, 0), (radius, height), (inner, height), (inner, wall), (0, wall)]
    return trimesh.creation.revolve(np.array(profile), sections=32)


def bin_of(x: float = 0.3, y: float = 0.2, z: float = 0.12, wall: float = 0.004) -> trimesh.Trimesh:
    def loop(a: float, b: float, height: float) -> list[tuple[float, float, float]]:
        return [(-a, -b, height), (a, -b, height), (a, b, height), (-a, b, height)]

    a, b = x / 2, y / 2
    vertices = [*loop(a, b, 0), *loop(a, b, z), *loop(a - wall, b - wall, z), *loop(a - wall, b - wall, wall)]
    quads = [(3, 2, 1, 0), (12, 13, 14, 15)]
    for i in range(4):
        j = (i + 1) % 4
        quads += [(k + i, k + j, k + 4 + j, k + 4 + i) for k in (0, 4, 8)]
    faces = [t for p, q, r, s in quads for t in ((p, q, r), (p, r, s))]
    return trimesh.Trimesh(vertices, faces, process=False)


def bracket() -> trimesh.Trimesh:
    """A block with two steps, turned so that no face is parallel to an axis."""
    outline = np.array(
        [(0, 0), (0.1, 0), (0.1, 0.02), (0.04, 0.02), (0.04, 0.05), (0.02, 0.05), (0.02, 0.1), (0, 0.1)]
    )
    triangles = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5), (0, 5, 6), (0, 6, 7)]
    solid = trimesh.creation.extrude_triangulation(outline, np.array(triangles), 0.03)
    solid.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1.0, 0.4, 0.2]))
    return solid


SOLIDS = {
    "cup": cup(),
    "bin": bin_of(),
    "bracket": bracket(),
    "torus": trimesh.creation.torus(0.04, 0.01, major_sections=24, minor_sections=12),
    "tube": trimesh.creation.annulus(0.03, 0.035, 0.05),
}


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(solid.vertices), np.array(solid.faces, np.int32))


def volume(pieces) -> float:
    solids = [trimesh.Trimesh(p.vertices, p.faces, process=False) for p in pieces]
    assert all(s.is_watertight and s.is_convex for s in solids)
    return float(sum(s.volume for s in solids))


def covered(pieces, points: np.ndarray) -> np.ndarray:
    """How many pieces contain each point."""
    count = np.zeros(len(points), int)
    for piece in pieces:
        planes = ConvexHull(piece.vertices).equations
        count += (points @ planes[:, :3].T + planes[:, 3] < 1e-7).all(1)
    return count


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path))
    object_decomposition.object_pieces.cache_clear()


@pytest.mark.slow
@pytest.mark.cases("tube", "torus", "bin", "bracket")
@pytest.mark.parametrize("name", SOLIDS)
def test_pieces_hold_the_mesh_and_little_more(name):
    solid = SOLIDS[name]
    assert solid.is_watertight
    pieces = object_decomposition.object_pieces(mesh_of(solid))
    assert abs(solid.volume) * 0.9999 < volume(pieces) < abs(solid.volume) * 1.1
    points = np.random.default_rng(1).uniform(solid.bounds[0], solid.bounds[1], (3000, 3))
    inside = np.abs(WindingNumbers(solid.vertices, solid.faces)(points)) > 0.5
    count = covered(pieces, points)
    assert inside.sum() > 100 and (count[inside] > 0).all() and (count <= 1).all()


def test_a_bin_of_plane_walls_is_exact():
    pieces = object_decomposition.object_pieces(mesh_of(bin_of()))
    assert len(pieces) <= 6
    assert volume(pieces) == pytest.approx(bin_of().volume, rel=1e-6)


@pytest.mark.slow
def test_cavities_stay_free():
    grid = np.array(
        [
            (r * np.cos(a), r * np.sin(a), z)
            for r in (0, 0.02, 0.035)
            for a in range(6)
            for z in (0.005, 0.05, 0.099)
        ]
    )
    assert not covered(object_decomposition.object_pieces(mesh_of(cup())), grid).any()


def test_a_convex_mesh_stays_one():
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    assert len(object_decomposition.object_pieces(mesh_of(box))) == 1


def test_a_mesh_with_repeated_vertices_is_closed():
    """STL files list three vertices per triangle."""
    solid = bin_of()
    soup = Mesh(
        solid.triangles.reshape(-1, 3), np.arange(3 * len(solid.faces), dtype=np.int32).reshape(-1, 3)
    )
    assert volume(object_decomposition.object_pieces(soup)) == pytest.approx(solid.volume, rel=1e-6)


def test_an_open_mesh_is_divided_by_axis_aligned_cuts():
    solid = cup()
    open_mesh = Mesh(np.array(solid.vertices), np.array(solid.faces[:-4], np.int32))
    assert 1 <= len(object_decomposition.object_pieces(open_mesh)) <= 12


@pytest.mark.slow
def test_the_pieces_come_from_the_disk_the_second_time(monkeypatch):
    first = object_decomposition.object_pieces(mesh_of(cup()))
    object_decomposition.object_pieces.cache_clear()
    monkeypatch.setattr(object_decomposition, "cut", lambda *_: pytest.fail("cut again"))
    again = object_decomposition.object_pieces(mesh_of(cup()))
    assert [p.vertices.tolist() for p in again] == [p.vertices.tolist() for p in first]


@pytest.mark.slow
def test_the_budget_counts_work_and_its_end_is_reported(monkeypatch, caplog):
    solid = cup()
    vertices, faces = np.array(solid.vertices, float), np.array(solid.faces, np.int32)
    few = [object_decomposition.cut(vertices, faces, budget=60_000)[0] for _ in range(2)]
    assert 1 < len(few[0]) < len(object_decomposition.cut(vertices, faces)[0])
    assert all((a == b).all() for a, b in zip(*few, strict=True))
    monkeypatch.setattr(object_decomposition, "WORK", 60_000)
    object_decomposition.object_pieces(mesh_of(solid))
    assert "the mesh" in caplog.text and "cm3" in caplog.text


@pytest.mark.slow
def test_solids_of_one_mesh_share_the_budget(monkeypatch):
    budgets = []
    cut = object_decomposition.cut

    def counted(vertices, faces, budget):
        found, rest = cut(vertices, faces, budget)
        budgets.append((budget, rest))
        return found, rest

    monkeypatch.setattr(object_decomposition, "WORK", 400_000)
    monkeypatch.setattr(object_decomposition, "cut", counted)
    small, large = bin_of(), cup()
    small.apply_translation((1.0, 0.0, 0.0))
    pieces = object_decomposition.object_pieces(mesh_of(trimesh.util.concatenate([large, small])))
    (first, rest), (second, _) = budgets
    assert first == 400_000 * len(small.faces) // (len(small.faces) + len(large.faces))
    assert second == 400_000 - first + rest
    assert volume([p for p in pieces if p.vertices[:, 0].min() > 0.5]) == pytest.approx(small.volume)


@pytest.mark.slow
def test_a_dimple_stays_free_however_small_its_volume():
    """The stem cavity of an apple: 2 % of the volume, but a finger fits in."""
    turn = np.linspace(-np.pi / 2, 1.25, 24)
    profile = [*zip(0.04 * np.cos(turn), 0.04 * np.sin(turn), strict=True), (0.004, 0.02), (0.0, 0.018)]
    apple = trimesh.creation.revolve(np.array(profile), sections=24)
    assert apple.volume > (1 - object_decomposition.EXCESS) * apple.convex_hull.volume
    pieces = object_decomposition.object_pieces(mesh_of(apple))
    assert not covered(pieces, np.array([[0.0, 0.0, z] for z in (0.022, 0.03, 0.037)])).any()
    for piece in pieces:
        planes = ConvexHull(piece.vertices).equations
        height = (apple.vertices @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        assert -height.min() <= object_decomposition.DEPTH + 1e-6


def test_overlapping_solids_of_one_mesh_stay_what_they_are():
    """The mesh's volume counts their overlap twice: as one solid, their pieces would fill the corner."""
    foot = trimesh.creation.box((0.08, 0.04, 0.01))
    T = trimesh.transformations.translation_matrix((-0.035, 0, 0.025))
    wall = trimesh.creation.box((0.01, 0.04, 0.06), T)
    pieces = object_decomposition.object_pieces(mesh_of(trimesh.util.concatenate([foot, wall])))
    assert sorted(volume([piece]) for piece in pieces) == pytest.approx([foot.volume * 0.75, foot.volume])


@pytest.mark.filterwarnings("error")
def test_a_sheet_beside_a_solid_is_decomposed_without_a_warning():
    """Scans and exports contain sheets with two faces, which enclose no volume."""
    box = trimesh.creation.box((0.04, 0.03, 0.02))
    corners = np.array([[0.1, 0, 0], [0.12, 0, 0], [0.1, 0.02, 0]])
    sheet = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 1]], process=False)
    both = trimesh.util.concatenate([box, sheet])
    pieces = object_decomposition.object_pieces(Mesh(both.vertices, both.faces.astype(np.int32)))
    assert sum(ConvexHull(p.vertices).volume for p in pieces) == pytest.approx(box.volume, rel=1e-3)


def test_a_piece_without_surface_has_no_depth():
    """A cut can leave a cell that is entirely inside the solid: only its corners are left."""
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    vertices, faces = np.array(box.vertices), np.array(box.faces, np.int32)
    none = np.empty((0, 3, 3))
    piece = object_decomposition._Piece(
        none, none, object_decomposition._reflex_edges(vertices, faces), np.empty((0, 4)), vertices, 1e-3
    )
    object_decomposition._Work(1000, vertices, faces).measure_depth(piece)
    assert piece.depth == 0.0


def area(part: convex_decomposition.MeshPart) -> float:
    a, b, c = (part.points[part.triangles[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("name", SOLIDS)
def test_no_cut_saves_more_than_its_bound(name):
    part = convex_decomposition.MeshPart(SOLIDS[name].vertices, SOLIDS[name].faces)
    low, high = part.points.min(0), part.points.max(0)
    planes = low[:, None] + np.linspace(0.2, 0.8, 4) * (high - low)[:, None]
    whole = part.hull_volume
    bounds = convex_decomposition._largest_savings(part, planes, whole)
    for axis in range(3):
        for k, at in enumerate(planes[axis]):
            halves = [part.clipped(axis, at, side) for side in (1.0, -1.0)]
            assert sum(area(half) for half in halves) == pytest.approx(area(part))
            for half in halves:
                assert np.array_equal(np.unique(half.triangles), np.arange(len(half.points)))
            saving = whole - sum(half.hull_volume for half in halves)
            assert saving - 1e-9 * whole <= bounds[axis, k] <= saving + 0.1 * whole
