"""MoveIt's .scene files: as MoveIt writes them, in both forms, and what is wrong with a file."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tests.scene.helpers import box, mesh_of, open_bin

from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cone,
    Cylinder,
    InputError,
    Mesh,
    Plane,
    PointCloud,
    Sphere,
)
from armcell.core.geometry import extent
from armcell.scene import CollisionObject, load_scene_file, save_scene_file

NEW = """foobar_scene
* foo
0 0 0
0 0 0 1
1
box
.77 0.39 0.05
0 0 0.025
0 0 0 1
0.82 0.75 0.60 1
0
* bar
0.5 -0.5 0.1
0 0 0.70710678 0.70710678
2
cylinder
0.02 0.0001
0.453709 0.499136 0.355051
0 0 0 1
1 0 0 1
mesh
4 4
0 0 0
0.1 0 0
0 0.1 0
0 0 0.1
0 2 1
0 1 3
0 3 2
1 2 3
0 0 1
0 0 0 1
1 0 0 1
1
tip
0 0 0.3
0 0 0 1
.
"""
OLD = """foobar_scene
* foo bar
1
box
2.58 1.36 0.31
1.49257 1.00222 0.170051
0 0 4.16377e-05 1
0 0 1 0.3
* ball
1
sphere
0.1
0 0 1
0 0 0 1
0 0 0 0
.
"""


def write(tmp_path, text):
    path = tmp_path / "a.scene"
    path.write_text(text)
    return path


def test_the_new_form(tmp_path):
    foo, bar = load_scene_file(write(tmp_path, NEW))
    assert foo.name == "foo" and foo.shapes[0][0] == Box(0.77, 0.39, 0.05)
    assert foo.color == (0.82, 0.75, 0.6, 1) and foo.shapes[0][1].translation[2] == 0.025
    cylinder, solid = bar.shapes[0][0], bar.shapes[1][0]
    assert cylinder == Cylinder(0.02, 0.0001)
    assert trimesh.Trimesh(solid.vertices, solid.faces).volume == pytest.approx(0.1**3 / 6)
    np.testing.assert_allclose(bar.T_world_object.apply((1, 0, 0)), [0.5, 0.5, 0.1], atol=1e-7)
    np.testing.assert_allclose(bar.subframes["tip"].translation, [0, 0, 0.3])


def test_the_old_form(tmp_path):
    foo, ball = load_scene_file(write(tmp_path, OLD))
    assert foo.name == "foo bar" and foo.T_world_object.isclose(SE3.identity())
    np.testing.assert_allclose(foo.shapes[0][1].translation, [1.49257, 1.00222, 0.170051])
    assert foo.color == (0, 0, 1, 0.3)
    assert ball.shapes[0][0] == Sphere(0.1) and ball.color == box("a", (1, 1, 1)).color  # none given


def test_round_trip(tmp_path):
    rng = np.random.default_rng(0)

    def pose():
        return SE3.from_xyz_rpy(rng.normal(size=3), rng.uniform(-3, 3, 3))

    shapes = (
        Box(0.1, 0.2, 1 / 3), Sphere(0.1), Cylinder(0.1, 0.3), Cone(0.1, 0.3), mesh_of(open_bin()), Plane()
    )  # fmt: skip
    items = [
        CollisionObject("all of them", tuple((s, pose()) for s in shapes), pose(), (0.1, 0.2, 0.3, 0.4),
                        subframes={"a": pose(), "b/c": pose()}),
        CollisionObject("bare", ((Sphere(0.1), pose()),)),
    ]  # fmt: skip
    path = tmp_path / "a.scene"
    cloud = CollisionObject.single("seen", PointCloud(np.zeros((1, 3)), 0.01))
    assert save_scene_file([*items, cloud], path) == ["seen"]
    back = load_scene_file(path)
    assert [b.name for b in back] == [i.name for i in items]
    for old, new in zip(items, back, strict=True):
        assert new.color == old.color and list(new.subframes) == list(old.subframes)
        assert new.T_world_object.isclose(old.T_world_object, 1e-12, 1e-7)
        for name, T in old.subframes.items():
            assert new.subframes[name].isclose(T, 1e-12, 1e-7)
        for (a, T_a), (b, T_b) in zip(old.shapes, new.shapes, strict=True):
            assert T_a.isclose(T_b, 1e-12, 1e-7)
            if isinstance(a, Mesh):
                assert np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces)
            else:
                assert a == b


def test_a_plane_by_its_equation(tmp_path):
    """2x + 0y + 0z - 1 = 0: solid behind x = 0.5."""
    text = "s\n* p\n1\nplane\n2 0 0 -1\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n"
    (item,) = load_scene_file(write(tmp_path, text))
    shape, T = item.shapes[0]
    assert isinstance(shape, Plane)
    np.testing.assert_allclose(T.translation, [0.5, 0, 0])
    np.testing.assert_allclose(T.rotation.matrix @ (0, 0, 1), [1, 0, 0], atol=1e-12)
    assert extent(Box(1, 1, 1), np.array([1.0, 0, 0])) == (-0.5, 0.5)


BAD = {
    "empty": ("", "is empty"),
    "blank": ("\n \n", "is empty"),
    "name only": ("name\n", "cut off"),
    "no end": (OLD.rsplit(".\n", 1)[0], "cut off"),
    "cut in a number": (NEW[: NEW.index("0.02 0.0001") + 4], "cut off"),
    "unknown shape": (OLD.replace("sphere", "torus"), r":11: shape 0 of object 'ball' is a 'torus'"),
    "word for a number": (OLD.replace("1.36", "wide"), r":5: 'wide' stands where the size"),
    "not finite": (OLD.replace("1.36", "nan"), r":5: .*finite"),
    "negative size": (OLD.replace("1.36", "-1.36"), r":5: .*positive"),
    "no rotation": (OLD.replace("0 0 4.16377e-05 1", "0 0 0 0"), r":7: .*norm"),
    "color": (OLD.replace("0 0 1 0.3", "0 0 7 1"), "color"),
    "count": (OLD.replace("* ball\n1", "* ball\n-1"), r":10: '-1' stands where the number of shapes"),
    "huge count": (OLD.replace("* ball\n1", "* ball\n999999999999"), "number of shapes"),
    "marker": (OLD.replace("* ball", "+ ball"), r":9: '\+' stands where"),
    "no name": (OLD.replace("* ball", "*"), "name after"),
    "mesh corner": (NEW.replace("1 2 3\n", "1 2 9\n"), "vertex it does not have"),
    "no plane": ("s\n* p\n1\nplane\n0 0 0 1\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n", "normal"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files(name, tmp_path):
    text, reason = BAD[name]
    with pytest.raises(InputError, match=reason) as error:
        load_scene_file(write(tmp_path, text))
    assert "a.scene" in str(error.value)


@pytest.mark.parametrize("cut", range(1, len(NEW) - 2, 7))
def test_cut_off_anywhere_is_an_error(cut, tmp_path):
    with pytest.raises(InputError):
        load_scene_file(write(tmp_path, NEW[:cut]))


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(InputError, match="not found"):
        load_scene_file(tmp_path / "none.scene")
    (tmp_path / "a.scene").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(InputError, match="UTF-8"):
        load_scene_file(tmp_path / "a.scene")


def test_what_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match="capsule"):
        save_scene_file([CollisionObject.single("a", Capsule(0.1, 0.1))], tmp_path / "a.scene")
    with pytest.raises(InputError, match="name"):
        save_scene_file([box("a", (1, 1, 1), subframes={"b c": SE3.identity()})], tmp_path / "a.scene")
