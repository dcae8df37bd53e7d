"""Where a mesh URI is looked for, and what a mesh file must be."""

from __future__ import annotations

import re

import numpy as np
import pytest
import trimesh
from tests.model.helpers import MBM, collision, link, mbm_file, mbm_robot, robot

from armcell.core import InputError
from armcell.model import load_robot, load_urdf
from armcell.model.assets import load_mesh, load_visual_parts, resolve_uri

needs_mbm = pytest.mark.skipif(not MBM.is_dir(), reason="needs the MotionBenchMaker robots")


@pytest.fixture
def package(tmp_path):
    """arm_description/{urdf/arm.urdf, meshes/part.stl}"""
    root = tmp_path / "src" / "arm_description"
    for folder in ("urdf", "meshes"):
        (root / folder).mkdir(parents=True)
    (root / "meshes" / "part.stl").write_bytes(trimesh.creation.box((1, 1, 1)).export(file_type="stl"))
    mesh = collision('<mesh filename="package://arm_description/meshes/part.stl"/>')
    (root / "urdf" / "arm.urdf").write_text(robot(link("a", mesh)))
    return root


def test_a_package_is_found_above_the_urdf(package):
    assert len(load_urdf(package / "urdf" / "arm.urdf").links["a"].collisions) == 1


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"])
@pytest.mark.parametrize("layout", ["parent", "package itself", "install space"])
def test_a_package_is_found_in_the_environment(package, tmp_path, monkeypatch, variable, layout):
    away = tmp_path / "away"
    away.mkdir()
    with pytest.raises(InputError):
        resolve_uri("package://arm_description/meshes/part.stl", away)
    entry = {"parent": package.parent, "package itself": package, "install space": tmp_path / "install"}[
        layout
    ]
    if layout == "install space":
        (entry / "share").mkdir(parents=True)
        (entry / "share" / "arm_description").symlink_to(package)
    monkeypatch.setenv(variable, f"/nowhere:{entry}")
    found = resolve_uri("package://arm_description/meshes/part.stl", away)
    assert found.samefile(package / "meshes" / "part.stl")


@pytest.mark.parametrize("beside", ["in the workspace", "on ROS_PACKAGE_PATH"])
def test_a_package_of_another_repository_is_found_by_its_own_name(package, tmp_path, monkeypatch, beside):
    """src/repository/group/package, whose folder is not named as the package is."""
    (package / "package.xml").write_text("<package><name>arm_description</name></package>")
    there = (
        tmp_path / ("src" if beside == "in the workspace" else "other") / "repository" / "group" / "meshes-2"
    )
    there.mkdir(parents=True)
    (there / "package.xml").write_text("<package><name>arm_meshes</name></package>")
    (there / "part.stl").write_bytes((package / "meshes" / "part.stl").read_bytes())
    if beside == "on ROS_PACKAGE_PATH":
        with pytest.raises(InputError, match="not found above"):
            resolve_uri("package://arm_meshes/part.stl", package / "urdf")
        monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "other"))
    assert resolve_uri("package://arm_meshes/part.stl", package / "urdf").samefile(there / "part.stl")


def test_plain_and_file_uris(package):
    part = package / "meshes" / "part.stl"
    for uri in ("../meshes/part.stl", f"file://{part}", str(part)):
        assert resolve_uri(uri, package / "urdf").samefile(part)


def test_a_missing_package_says_where_it_was_looked_for(tmp_path):
    with pytest.raises(InputError, match=r"ROS_PACKAGE_PATH.*put package 'nope' beside the URDF"):
        resolve_uri("package://nope/a.stl", tmp_path)
    with pytest.raises(InputError, match="only package:// and file://"):
        resolve_uri("https://example.org/a.stl", tmp_path)


@needs_mbm
@pytest.mark.parametrize("name", ["panda", "ur5", "baxter"])
def test_package_meshes_beside_the_urdf(name):
    """package://meshes/... with meshes/ in the URDF's own folder."""
    model = mbm_robot(name)
    files = [c.shape.file for k in model.links.values() for c in k.collisions if hasattr(c.shape, "file")]
    assert files and all(f.is_relative_to(mbm_file(name).parent) for f in files)


@needs_mbm
@pytest.mark.parametrize("name", ["panda", "ur5", "baxter"])
def test_robots_without_their_visual_meshes_load(name):
    assert load_robot(mbm_file(name)).dof == mbm_robot(name).dof


@pytest.mark.parametrize("format", ["stl", "obj", "ply", "off", "glb", "dae"])
def test_mesh_formats(tmp_path, format):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    data = ball.export(file_type=format)
    file = tmp_path / f"ball.{format}"
    file.write_bytes(data if isinstance(data, bytes) else data.encode())
    mesh = load_mesh(file, (2.0, 1.0, 1.0))
    assert len(mesh.faces) == len(ball.faces)
    assert len(mesh.vertices) == len(ball.vertices)  # corners that STL repeats are merged
    np.testing.assert_allclose(
        np.ptp(mesh.vertices, axis=0), np.ptp(ball.vertices, axis=0) * (2, 1, 1), atol=1e-6
    )


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "lol">'
    + "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij"))
    + "]><COLLADA>&j;</COLLADA>"
)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("cut.stl", trimesh.creation.box().export(file_type="stl")[:300]),
        ("noise.stl", bytes(range(256)) * 10),
        ("noise.obj", b"\x00\x01\x02 v v v"),
        ("noise.dae", b"<COLLADA"),
        ("noise.glb", b"glTF nonsense"),
        ("noise.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n"),
        ("empty.stl", b""),
        ("empty.obj", b""),
        ("nofaces.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("nan.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("bomb.dae", BOMB.encode()),
        ("part.step", b"ISO-10303-21;"),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)
def test_a_broken_mesh_is_one_clear_line(tmp_path, within, name, data):
    file = tmp_path / name
    file.write_bytes(data)
    (tmp_path / "r.urdf").write_text(robot(link("a", collision(f'<mesh filename="{name}"/>'))))
    with within(5.0), pytest.raises(InputError) as error:
        load_urdf(tmp_path / "r.urdf")
    text = str(error.value)
    assert "r.urdf:2: <mesh>: " in text and name in text and "\n" not in text


def test_visual_meshes_are_parsed_once_per_content(tmp_path, monkeypatch):
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path / "cache"))
    parts = [trimesh.creation.box((0.1, 0.2, 0.3)), trimesh.creation.icosphere(radius=0.1)]
    for part, rgba in zip(parts, ([200, 10, 10, 255], [10, 10, 200, 255]), strict=True):
        part.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.PBRMaterial(baseColorFactor=rgba)
        )
    first, copy = tmp_path / "first.glb", tmp_path / "copy.glb"
    first.write_bytes(trimesh.Scene(parts).export(file_type="glb"))
    copy.write_bytes(first.read_bytes())
    parsed = load_visual_parts(first, (1.0, 2.0, 1.0))
    with monkeypatch.context() as patch:
        patch.setattr(trimesh, "load", None)
        stored = load_visual_parts(copy, (1.0, 2.0, 1.0))
    assert len(stored) == len(parsed) == 2
    for (mesh, color), (other, same) in zip(stored, parsed, strict=True):
        assert color == same and np.array_equal(mesh.faces, other.faces)
        assert np.array_equal(mesh.vertices, other.vertices)
    assert {color for _, color in stored} == {(0.784, 0.039, 0.039, 1.0), (0.039, 0.039, 0.784, 1.0)}


def test_an_obj_file_gets_the_present_colors_of_its_material_file(tmp_path, monkeypatch):
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "part.obj"
    path.write_text("mtllib part.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl paint\nf 1 2 3\n")
    for rgb in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
        (tmp_path / "part.mtl").write_text("newmtl paint\nKd {} {} {}\n".format(*rgb))
        load_visual_parts.cache_clear()
        assert load_visual_parts(path)[0][1] == (*rgb, 1.0)


@pytest.mark.parametrize("load", [load_mesh, lambda path: load_visual_parts(path)[0][0]])
def test_a_collada_file_has_a_unit_as_in_rviz(tmp_path, load):
    data = trimesh.exchange.dae.export_collada(trimesh.creation.box((100, 200, 300))).decode()
    head, tail = data.split("</asset>", 1)
    for unit, size in (("0.001", [0.1, 0.2, 0.3]), ("0.01", [1.0, 2.0, 3.0])):
        path = tmp_path / f"in_{unit}.dae"
        path.write_text(re.sub(r"<unit[^>]*/>", "", head) + f'<unit meter="{unit}"/></asset>{tail}')
        np.testing.assert_allclose(np.ptp(load(path).vertices, axis=0), size, rtol=1e-6)
    bad = tmp_path / "bad.dae"
    bad.write_text(f'<unit meter="0"/>{data}')
    with pytest.raises(InputError, match="unit is 0 m"):
        load(bad)


def test_a_mesh_that_is_on_disk_already_is_the_mesh_of_the_file(tmp_path, monkeypatch):
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path / "cache"))
    file = tmp_path / "box.stl"

    def loaded(size: float) -> tuple[np.ndarray, np.ndarray]:
        trimesh.creation.box((size, size, size)).export(file)
        load_mesh.cache_clear()
        mesh = load_mesh(file, (2.0, 1.0, 1.0))
        return mesh.vertices, mesh.faces

    vertices, faces = loaded(1.0)
    assert len(list((tmp_path / "cache" / "meshes").iterdir())) == 1
    monkeypatch.setattr(trimesh, "load", lambda *a, **k: pytest.fail("read the file again"))
    again, same = loaded(1.0)
    assert again.tobytes() == vertices.tobytes() and same.tobytes() == faces.tobytes()
    monkeypatch.undo()
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path / "cache"))
    assert loaded(3.0)[0].max() == pytest.approx(3.0)
