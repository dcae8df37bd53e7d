"""Objects to YAML and back; clouds, subframes and types in cell files; what is wrong with them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import yaml
from tests.scene.helpers import box, mesh_of, open_bin

import armcell
from armcell.cell import load_objects, save_objects
from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cone,
    Cylinder,
    InputError,
    Mesh,
    Octree,
    Plane,
    PointCloud,
    Sphere,
)
from armcell.scene import CollisionObject, Material, ObjectType, ScrewThread


def test_round_trip(tmp_path):
    rng = np.random.default_rng(0)

    def pose():
        return SE3.from_xyz_rpy(rng.normal(size=3), rng.uniform(-3, 3, 3))

    solids = (Box(0.1, 0.2, 1 / 3), Sphere(0.1), Cylinder(0.1, 0.3), Capsule(0.1, 0.2), Cone(0.1, 0.3),
              Plane(), mesh_of(open_bin()))  # fmt: skip
    cells = Octree(rng.normal(size=(20, 3)), rng.uniform(0.01, 0.1, 20))
    items = [
        CollisionObject("many", tuple((s, pose()) for s in solids), pose(), (0.1, 0.2, 0.3, 0.4),
                        subframes={"a": pose(), "b": SE3.identity()}),
        box("cup", (0.1, 0.1, 0.2), movable=True, mass=0.25, material=Material(0.5),
            type=ObjectType("cup", "kitchen")),
        CollisionObject("seen", ((PointCloud(rng.normal(size=(30, 3)), 0.01), pose()), (cells, pose()))),
    ]  # fmt: skip
    save_objects(items, tmp_path / "things.yaml")
    back = load_objects(tmp_path / "things.yaml")
    for old, new in zip(items, back, strict=True):
        for name in ("name", "color", "movable", "mass", "material", "type"):
            assert getattr(old, name) == getattr(new, name)
        assert new.T_world_object.isclose(old.T_world_object, 1e-12, 1e-7)
        assert list(new.subframes) == list(old.subframes)
        for name, T in old.subframes.items():
            assert new.subframes[name].isclose(T, 1e-12, 1e-7)
        for (a, T_a), (b, T_b) in zip(old.shapes, new.shapes, strict=True):
            assert T_a.isclose(T_b, 1e-12, 1e-7)
            match a, b:
                case Mesh(), Mesh():  # in whatever order
                    assert sorted(a.vertices.tolist()) == sorted(b.vertices.tolist())
                    volumes = [trimesh.Trimesh(m.vertices, m.faces).volume for m in (a, b)]
                    assert volumes[0] == pytest.approx(volumes[1], rel=1e-12)
                case PointCloud(), PointCloud():
                    assert np.array_equal(a.points, b.points) and a.radius == b.radius
                case Octree(), Octree():
                    assert np.array_equal(a.centers, b.centers) and np.array_equal(a.sizes, b.sizes)
                case _:
                    assert a == b
    text = yaml.safe_load((tmp_path / "things.yaml").read_text())
    assert text["objects"]["cup"]["box"] == [0.1, 0.1, 0.2]  # one shape: as one writes it by hand


def test_what_is_screwed_in_and_names_that_are_alike(tmp_path):
    bolt = box("bolt", (0.02, 0.02, 0.1), (0.5, 0.1, 0.2), (0.3, 0, 1.0), movable=True)
    at = bolt.T_world_object @ SE3.from_xyz(0, 0, 0.04)
    nut = box("nut", (0.03, 0.03, 0.01), movable=True, thread=ScrewThread("bolt", 0.001, 0.02, 0.3)).at(at)
    meshes = [CollisionObject.single(name, mesh_of(open_bin(size)), SE3.identity())
              for name, size in (("a b", 0.1), ("a_b", 0.2))]  # fmt: skip
    save_objects([nut, bolt, *meshes], tmp_path / "things.yaml")
    back = {item.name: item for item in load_objects(tmp_path / "things.yaml")}
    assert back["nut"].thread == nut.thread and back["nut"].T_world_object.isclose(at, 1e-9, 1e-7)
    for item in meshes:
        assert np.allclose(back[item.name].bounds(), item.bounds())
    with pytest.raises(InputError, match="screwed into 'bolt', which is not among"):
        save_objects([nut], tmp_path / "nut.yaml")


def cell(tmp_path, objects: str):
    (tmp_path / "cell.yaml").write_text(f"robot: panda\nobjects: {objects}\n")
    return armcell.load(tmp_path)


def test_in_a_cell_file(tmp_path):
    np.save(tmp_path / "seen.npy", np.zeros((5, 3)))
    scene = cell(
        tmp_path,
        "{seen: {cloud: seen.npy, radius: 0.02}, "
        "cup: {box: [0.1, 0.1, 0.1], pose: [1, 0, 0], subframes: {rim: [0, 0, 0.05]}, type: {key: cup}}}",
    ).scene()
    shape = scene.object("seen").shapes[0][0]
    assert isinstance(shape, PointCloud) and shape.points.shape == (5, 3) and shape.radius == 0.02
    assert scene.frame_pose("cup/rim").translation.tolist() == [1, 0, 0.05]
    assert scene.object("cup").type == ObjectType("cup")


BAD = {
    "{seen: {cloud: seen.npy}}": r"seen\.npy: a point cloud needs a radius",
    "{seen: {cloud: none.npy, radius: 0.1}}": "objects/seen: .*none.npy not found",
    "{seen: {cloud: cell.yaml, radius: 0.1}}": "unknown point cloud format '.yaml'",
    "{seen: {cloud: seen.npy, radius: -1}}": "objects/seen/radius",
    "{seen: {cloud: seen.npy, radius: 0.1, movable: true}}": "objects/seen: .*cannot move",
    "{cup: {sphere: 1, subframes: {rim: 7}}}": "objects/cup: subframes/rim: 7 is not a pose",
    "{cup: {sphere: 1, type: {name: cup}}}": "objects/cup/type/name",
    "{cup: {sphere: 1, cloud: seen.npy}}": "exactly one of",
}


@pytest.mark.parametrize("objects", BAD)
def test_bad_entries(objects, tmp_path):
    np.save(tmp_path / "seen.npy", np.zeros((5, 3)))
    with pytest.raises(InputError, match=BAD[objects]):
        cell(tmp_path, objects)


@pytest.mark.parametrize(
    ("text", "reason"),
    [("robot: panda", "only 'objects'"), ("objects: {a: {sphere: -1}}", "objects/a: .*positive"),
     ("objects: {a: {}}", "objects/a"), ("objects: [1]", "objects"), ("- 1", "things.yaml")],
)  # fmt: skip
def test_bad_files(text, reason, tmp_path):
    (tmp_path / "things.yaml").write_text(text)
    with pytest.raises(InputError, match=reason) as error:
        load_objects(tmp_path / "things.yaml")
    assert "things.yaml" in str(error.value)


def test_bad_cells(tmp_path):
    np.savez(tmp_path / "seen.npz", centers=np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"seen\.npz.*sizes"):
        cell(tmp_path, "{seen: {cloud: seen.npz}}")
    np.savez(tmp_path / "seen.npz", centers=np.zeros((2, 3)), sizes=[0.1, -1])
    with pytest.raises(InputError, match=r"seen\.npz.*not a positive"):
        cell(tmp_path, "{seen: {cloud: seen.npz}}")
    (tmp_path / "seen.npz").write_bytes((tmp_path / "seen.npz").read_bytes()[:100])
    with pytest.raises(InputError, match=r"seen\.npz"):
        cell(tmp_path, "{seen: {cloud: seen.npz}}")
