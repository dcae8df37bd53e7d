"""`armcell export unity` and `armcell export urdf`: what is written is the cell."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from lxml import etree

from armcell.cell import load
from armcell.cli.main import main
from armcell.core import SE3, Box, Capsule, Cone, Cylinder, Mesh, Sphere
from armcell.kinematics import kinematic_tree
from armcell.model import Collision, load_urdf
from armcell.ros.unity import write_urdf
from armcell.ros.unity.export import scene_json, small_hull, write_stl


@pytest.mark.slow
@pytest.mark.cases("panda_table")
@pytest.mark.parametrize("name", ["panda_table", "dual_ur10"])
def test_the_flat_urdf_is_the_same_robot(name, tmp_path):
    model = load(name).model
    flat = load_urdf(write_urdf(model, tmp_path))
    assert flat.joint_names == model.joint_names and list(flat.links) == list(model.links)
    rng = np.random.default_rng(1)
    for _ in range(3):
        q = rng.uniform(np.maximum(model.lower, -3), np.minimum(model.upper, 3))
        for link in model.links:
            ours, theirs = (kinematic_tree(m).link_pose(q, link).matrix for m in (model, flat))
            np.testing.assert_allclose(theirs, ours, atol=1e-12)
    assert set(flat.joints) == set(model.joints)
    for own in model.joints.values():
        joint = flat.joints[own.name]
        assert (joint.type, joint.mimic) == (own.type, own.mimic)
        for field in ("lower", "upper", "effort", "velocity"):
            if own.movable:
                assert getattr(joint.limits, field) == getattr(own.limits, field)
    for own in model.links.values():
        inertial = flat.links[own.name].inertial
        assert inertial is not None and inertial.mass > 0 and np.all(np.linalg.eigvalsh(inertial.inertia) > 0)
        assert np.count_nonzero(inertial.inertia - np.diag(np.diag(inertial.inertia))) == 0
        if own.inertial is not None and own.inertial.mass > 0:
            assert inertial.mass == own.inertial.mass
            R, R_own = (i.T_link_com.rotation.matrix for i in (inertial, own.inertial))
            wanted = R_own @ own.inertial.inertia @ R_own.T
            np.testing.assert_allclose(R @ inertial.inertia @ R.T, wanted, atol=2e-7)


@pytest.mark.slow
def test_meshes_are_files_of_their_own(tmp_path):
    """Relative, distinct, there; and no collision mesh is more than Unity's physics takes."""
    root = etree.parse(write_urdf(load("panda_table").model, tmp_path)).getroot()
    files = [e.get("filename") for e in root.iter("mesh")]
    assert len(files) == len(set(files)) > 20
    for file in files:
        mesh = trimesh.load(tmp_path / file)
        assert len(mesh.faces) > 0
        if "collision" in file:
            assert len(mesh.faces) <= 255
            merged = mesh.copy()
            merged.merge_vertices()
            assert merged.is_watertight and merged.volume > 0


@pytest.mark.slow
def test_capsules_become_a_cylinder_and_balls(tmp_path):
    model = load("panda_table").model
    T = SE3.from_xyz_rpy((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))
    link = replace(model.links["panda_hand"], collisions=(Collision(Capsule(0.02, 0.1), T),))
    flat = load_urdf(write_urdf(replace(model, links={**model.links, "panda_hand": link}), tmp_path))
    shapes = flat.links["panda_hand"].collisions
    assert [type(c.shape) for c in shapes] == [Cylinder, Sphere, Sphere]
    middle, low, high = (c.T_link_shape for c in shapes)
    np.testing.assert_allclose(middle.inverse().apply(high.translation), [0, 0, 0.05], atol=1e-12)
    np.testing.assert_allclose(middle.inverse().apply(low.translation), [0, 0, -0.05], atol=1e-12)


def test_small_hulls_lie_inside_and_say_by_how_much(tmp_path):
    ball = trimesh.creation.icosphere(3, 0.1)
    hull, gap = small_hull(Mesh(ball.vertices, ball.faces.astype(np.int32)))
    assert len(hull.vertices) <= 128 and len(hull.faces) <= 252
    solid = trimesh.Trimesh(hull.vertices, hull.faces)
    assert solid.is_watertight and solid.volume > 0.93 * ball.volume
    offsets = ball.vertices[:, None] - solid.triangles_center  # beyond each face's plane
    outside = np.einsum("ijk,jk->ij", offsets, solid.face_normals).max(1)
    assert outside.max() == pytest.approx(gap, abs=1e-9) and 0 < gap < 0.004
    box, gap = small_hull(
        Mesh(trimesh.creation.box((1, 2, 3)).vertices, trimesh.creation.box((1, 2, 3)).faces)
    )
    assert len(box.vertices) == 8 and gap < 1e-9
    write_stl(box, tmp_path / "box.stl")
    assert trimesh.load(tmp_path / "box.stl").volume == pytest.approx(6.0)


@pytest.mark.slow
def test_the_scene_file(exported):
    cell, export = exported
    data = json.loads((export.cell / "scene.json").read_text())
    scene = cell.scene()
    cube = next(o for o in data["objects"] if o["name"] == "cube")
    assert (cube["mass"], cube["friction"], cube["movable"], cube["topic"]) == (
        0.1,
        0.8,
        True,
        "/object_pose",
    )
    assert cube["pose"]["position"] == [0.40, 0.10, 0.025]
    assert cube["shapes"][0] == {
        "type": "box",
        "size": [0.05] * 3,
        "pose": {"position": [0, 0, 0], "quat_xyzw": [0, 0, 0, 1]},
    }
    assert data["robot"]["start"] == scene.state.as_dict()
    (gripper,) = data["robot"]["grippers"]
    assert gripper["topic"] == "/gripper_command" and gripper["max_force"] == 70.0
    drives = data["robot"]["drives"]
    assert drives["panda_joint1"]["force_limit"] == 87 and drives["panda_finger_joint2"]["force_limit"] == 70
    assert drives["panda_joint1"] == {"stiffness": 5000, "damping": 250, "force_limit": 87}
    assert drives["panda_joint7"]["stiffness"] == 5000 * 12 / 50  # 12 Nm: gains in proportion
    assert ["panda_hand", "panda_leftfinger"] in data["robot"]["may_touch"]
    assert (export.package / "Messages" / "Moveit" / "msg" / "CollisionObjectMsg.cs").is_file()
    assert (export.package / "package.json").is_file() and not export.is_project and not export.left_out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dual_ur10_rod", "six_axis_table"])
def test_other_cells_are_written(name, tmp_path):
    """Two grippers have topics of their own; every shape has its size; meshes have convex pieces."""
    cell = load(name)
    data, _ = scene_json(cell, 0, tmp_path, "robot.urdf")
    json.dumps(data, allow_nan=False)
    topics = [g["topic"] for g in data["robot"]["grippers"]]
    assert len(set(topics)) == len(cell.model.grippers)
    kinds = {
        Box: "box",
        Sphere: "sphere",
        Cylinder: "cylinder",
        Capsule: "capsule",
        Cone: "cone",
        Mesh: "mesh",
    }
    for item in data["objects"]:
        shapes = cell.scene(0).object(item["name"]).shapes
        assert [s["type"] for s in item["shapes"]] == [kinds.get(type(s), "plane") for s, _ in shapes]
        for shape in item["shapes"]:
            for file in [shape["visual"], *shape["hulls"]] if shape["type"] == "mesh" else []:
                assert (tmp_path / file).is_file()


@pytest.mark.slow
def test_the_command(tmp_path, capsys):
    """Into a project; again over it, own files are left alone."""
    (tmp_path / "ProjectSettings").mkdir()
    assert main(["export", "unity", "panda_table", "-o", str(tmp_path)]) == 0
    out = capsys.readouterr()
    assert "Packages/com.armcell.unity" in out.out and "no Unity project" not in out.err
    own = tmp_path / "Packages" / "com.armcell.unity" / "package.json.meta"
    own.write_text("mine")
    assert main(["export", "unity", "panda_table", "-o", str(tmp_path), "--seed", "3"]) == 0
    data = json.loads((tmp_path / "Assets" / "Armcell" / "panda_table" / "scene.json").read_text())
    assert data["objects"][1]["pose"]["position"] != [0.40, 0.10, 0.025] and own.read_text() == "mine"


def test_where_it_cannot_be_written(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for kind in ("unity", "urdf"):
        assert main(["export", kind, "panda_table", "-o", str(tmp_path / "file")]) == 1
        assert "cannot write there" in capsys.readouterr().err
