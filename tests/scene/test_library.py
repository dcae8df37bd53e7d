"""The objects made by us and those from mesh files, against trimesh and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from armcell.core import SE3, Box, Cylinder, InputError, Mesh, UnknownNameError
from armcell.scene import library, library_object, mesh_object, object_names, solid_inertia


def as_trimesh(shape) -> trimesh.Trimesh:
    match shape:
        case Box():
            return trimesh.creation.box((shape.x, shape.y, shape.z))
        case Cylinder():
            return trimesh.creation.cylinder(shape.radius, shape.length, sections=720)
        case Mesh():
            return trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    raise TypeError(shape)


def parts(item) -> list[trimesh.Trimesh]:
    return [as_trimesh(shape).apply_transform(T.matrix) for shape, T in item.shapes]


def test_all_that_were_asked_for_are_there():
    assert set(object_names()) == {
        "box", "can", "bottle", "mug", "l_bracket", "rod", "bolt", "tray", "bin"
    }  # fmt: skip


@pytest.mark.parametrize("kind", object_names())
def test_each_stands_on_its_origin_with_the_inertia_of_its_solids(kind):
    item = library_object(kind, pose=SE3.from_xyz(1.0, 2.0, 3.0), scale=1.5)
    low, high = item.bounds()
    assert low[2] == pytest.approx(0.0, abs=1e-9) and high[2] > 0.01
    pieces = parts(item)
    assert all(p.is_watertight and p.volume > 0 for p in pieces)
    masses = np.array([p.volume for p in pieces]) * library[kind].density
    assert item.mass_kg == pytest.approx(masses.sum(), rel=1e-3)
    center, inertia = solid_inertia(item.shapes, item.mass_kg)
    about = masses @ np.array([p.center_mass for p in pieces]) / masses.sum()
    np.testing.assert_allclose(center, about, atol=2e-5)
    expected = np.zeros((3, 3))
    for piece, mass in zip(pieces, masses, strict=True):
        d = piece.center_mass - about
        expected += piece.moment_inertia / piece.volume * mass
        expected += mass * (d @ d * np.eye(3) - np.outer(d, d))
    np.testing.assert_allclose(inertia, expected, atol=2e-3 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.cases("bottle", "bolt", "rod", "tray", "bin")
@pytest.mark.parametrize("kind", object_names())
def test_solids_of_one_object_do_not_overlap(kind):
    """Else volume and mass would count twice: points inside one solid are in no other."""
    pieces, rng = parts(library_object(kind)), np.random.default_rng(0)
    hulls = [(p.face_normals, np.einsum("ij,ij->i", p.face_normals, p.triangles[:, 0])) for p in pieces]
    points = np.vstack([p.convex_hull.sample(300, seed=int(rng.integers(1 << 30))) for p in pieces])
    inside = np.array([np.all(points @ n.T < d - 2e-4, axis=1) for n, d in hulls])
    assert inside.sum(0).max() <= 1


def test_sizes_and_their_errors():
    can = library_object("can", "cola", sizes={"radius": 0.03}, mass=0.1, movable=False)
    assert can.name == "cola" and can.mass == 0.1 and not can.movable
    assert can.extent(np.array([1.0, 0, 0])) == pytest.approx(0.06)
    with pytest.raises(UnknownNameError, match="did you mean 'mug'"):
        library_object("mugg")
    with pytest.raises(InputError, match="has no size 'diameter'; it has: radius, height"):
        library_object("can", sizes={"diameter": 0.1})
    with pytest.raises(InputError, match="must be positive"):
        library_object("can", scale=-1.0)
    with pytest.raises(InputError, match="wall is too thick"):
        library_object("mug", sizes={"wall": 0.05})


# --- meshes ---
@pytest.mark.parametrize("suffix", ["obj", "stl", "glb", "ply"])
def test_a_mesh_file_of_each_format(suffix, tmp_path):
    torus = trimesh.creation.torus(0.04, 0.01)
    torus.export(tmp_path / f"ring.{suffix}")
    item = mesh_object("ring", tmp_path / f"ring.{suffix}", density=1000.0)
    assert item.mass_kg == pytest.approx(torus.volume * 1000, rel=1e-4)
    np.testing.assert_allclose(
        solid_inertia(item.shapes, item.mass_kg)[1], torus.moment_inertia * 1000, rtol=1e-3, atol=1e-10
    )


def test_a_mesh_in_millimeters_is_told_with_the_cure(tmp_path):
    trimesh.creation.torus(40.0, 10.0).export(tmp_path / "ring.stl")
    with pytest.raises(InputError, match=r"100 m large.*millimeters.*scale: 0.001"):
        mesh_object("ring", tmp_path / "ring.stl")
    assert max(mesh_object("ring", tmp_path / "ring.stl", scale=0.001).bounds()[1]) == pytest.approx(0.05)
    with pytest.raises(InputError, match="scale: 1000"):
        mesh_object("ring", tmp_path / "ring.stl", scale=1e-6)


def test_a_mesh_that_is_not_closed_is_told_once(tmp_path, caplog):
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.update_faces(np.arange(len(box.faces)) != 0)
    box.export(tmp_path / "open.ply")
    for _ in range(2):
        item = mesh_object("open", tmp_path / "open.ply", density=100.0)
    assert caplog.text.count("not closed (3 open edges)") == 1 and item.mass_kg == pytest.approx(0.1)


def test_a_flat_mesh_is_refused(tmp_path):
    flat = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]])
    flat.export(tmp_path / "flat.ply")
    with pytest.raises(InputError, match="flat"):
        mesh_object("flat", tmp_path / "flat.ply")
