"""Every shape of the table through every format: back comes the shape, or what the table says it becomes."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import trimesh
import yaml
from lxml import etree
from tests.scene.helpers import panda

from armcell.cell import load_objects, save_objects
from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    Format,
    InputError,
    Mesh,
    Plane,
    SizedMesh,
    UnknownNameError,
    make_shape,
    named_shapes,
    register_shape,
    shape_kind,
    shape_name,
    shapes,
    simpler_parts,
)
from armcell.model.urdf import parse_urdf
from armcell.model.urdf_writer import urdf_of
from armcell.records.mcap_writer import object_data, object_of
from armcell.ros.moveit_convert.objects import ShapeMessages, primitive_shape, primitive_type
from armcell.ros.schema import schema
from armcell.ros.unity.export import _shapes as unity_shapes
from armcell.ros.unity.export import write_urdf
from armcell.scene import CollisionObject, load_scene_file, save_scene_file, shape_volume
from armcell.scene.sdf import load_sdf

WEDGE = "test_wedge"
T = SE3.from_xyz_rpy((0.3, -0.2, 0.5), (0.4, -0.3, 1.2))


@pytest.fixture(autouse=True, scope="module")
def wedge():
    """A shape that a package adds: half of a box, cut along its diagonal."""

    @register_shape(WEDGE)
    def make(x: float, y: float, z: float):
        corners = np.array([(-x, -y, -z), (x, -y, -z), (-x, -y, z), (-x, y, -z), (x, y, -z), (-x, y, z)]) / 2
        faces = [(0, 1, 2), (3, 5, 4), (0, 3, 4), (0, 4, 1), (0, 2, 5), (0, 5, 3), (1, 4, 5), (1, 5, 2)]
        return corners, faces

    yield
    del shapes._items[WEDGE]


each = pytest.mark.parametrize("name", [*shapes.imported(), WEDGE])


def made(name: str):
    return make_shape(name, [0.11, 0.23, 0.37][: len(shapes[name].sizes)])


def assert_same(mine, theirs) -> None:
    assert shape_name(mine) == shape_name(theirs)
    assert shape_kind(mine).values(mine) == pytest.approx(shape_kind(theirs).values(theirs), rel=1e-12)


def assert_same_solid(mine: list, theirs: list) -> None:
    """Lists of (shape, pose) are the same solid: volumes and extents agree."""
    a, b = (CollisionObject("x", tuple(each)) for each in (mine, theirs))
    assert sum(shape_volume(s) for s, _ in mine) == pytest.approx(sum(shape_volume(s) for s, _ in theirs))
    np.testing.assert_allclose(a.bounds(), b.bounds(), atol=1e-9)


@each
def test_sizes_make_the_shape(name):
    shape, kind = made(name), shapes[name]
    assert shape_name(shape) == name and shape_kind(shape) is kind
    assert make_shape(name, kind.values(shape)) is not None
    assert len(kind.values(shape)) == len(kind.sizes)
    with pytest.raises(InputError, match=f"{name} has {len(kind.sizes) + 1} sizes"):
        make_shape(name, [0.1] * (len(kind.sizes) + 1))
    for wrong in (0.0, -1.0, math.nan, math.inf) if kind.sizes else ():
        with pytest.raises(InputError):
            make_shape(name, [wrong] * len(kind.sizes))
    with pytest.raises(UnknownNameError, match="box"):
        make_shape("bix", [1.0, 1.0, 1.0])


@each
def test_cell_files(name, tmp_path):
    shape = made(name)
    save_objects([CollisionObject("o", ((shape, T),))], tmp_path / "o.yaml")
    ((back, T_back),) = load_objects(tmp_path / "o.yaml")[0].shapes
    assert_same(back, shape)
    assert T_back.isclose(T, 1e-12, 1e-7)
    value = yaml.safe_load((tmp_path / "o.yaml").read_text())["objects"]["o"]["shapes"][0][name]
    sizes = shapes[name].values(shape)
    assert value == (True if not sizes else sizes[0] if len(sizes) == 1 else sizes)


@each
def test_a_wrong_number_of_sizes_in_a_cell_file_names_the_object(name, tmp_path):
    (tmp_path / "o.yaml").write_text(f"objects:\n  thing: {{{name}: [0.1, 0.1, 0.1, 0.1]}}\n")
    with pytest.raises(InputError, match="objects/thing"):
        load_objects(tmp_path / "o.yaml")


def test_an_object_has_one_shape(tmp_path):
    text = f"objects:\n  thing: {{{WEDGE}: [0.1, 0.1, 0.1], sphere: 0.1}}\n"
    (tmp_path / "o.yaml").write_text(text)
    with pytest.raises(InputError, match=f"has sphere, {WEDGE}"):
        load_objects(tmp_path / "o.yaml")
    (tmp_path / "o.yaml").write_text("objects:\n  thing: {test_wegde: [0.1, 0.1, 0.1]}\n")
    with pytest.raises(InputError, match=f"did you mean '{WEDGE}'"):
        load_objects(tmp_path / "o.yaml")


@each
def test_records(name):
    shape = made(name)
    data = json.loads(json.dumps(object_data(CollisionObject("o", ((shape, T),)))))
    ((back, T_back),) = object_of("o", data).shapes
    assert_same(back, shape)
    assert T_back.isclose(T, 1e-12, 1e-7)


@each
def test_scene_files(name, tmp_path):
    shape, file = made(name), tmp_path / "o.scene"
    if shapes[name].parts is not None and Format.SCENE_FILE not in shapes[name].formats:
        with pytest.raises(InputError, match=name):
            save_scene_file([CollisionObject("o", ((shape, T),))], file)
        return
    save_scene_file([CollisionObject("o", ((shape, T),))], file)
    ((back, T_back),) = load_scene_file(file)[0].shapes
    if name in named_shapes(Format.SCENE_FILE):
        assert_same(back, shape)
    assert_same_solid([(back, T_back)], [(shape, T)])


@each
def test_ros_messages(name):
    shape = made(name)
    messages = ShapeMessages(schema())
    messages.add(shape, T)
    primitive = shapes[name].primitive
    if primitive is not None:
        ((message, _),) = messages.primitives
        assert message.type == primitive_type(name) == primitive.type
        assert_same(primitive_shape(message), shape)
        message.dimensions = message.dimensions[:-1]
        with pytest.raises(InputError, match=f"a {name} has {len(primitive.dimensions) - 1} dimensions"):
            primitive_shape(message)
    elif messages.primitives:
        back = [(primitive_shape(m), U) for m, U in messages.primitives]
        for (mine, U), (theirs, V) in zip(back, simpler_parts(shape, T), strict=True):
            assert_same(mine, theirs)
            assert U.isclose(V)
    else:
        assert (len(messages.planes), len(messages.meshes)) == (
            (1, 0) if isinstance(shape, Plane) else (0, 1)
        )


@each
def test_unity(name, tmp_path):
    """Unity's side (ShapeBuilder.cs) reads the sizes by name."""
    (data,) = unity_shapes(made(name), "o", tmp_path)
    if name in named_shapes(Format.UNITY):
        assert data == {"type": name, **shapes[name].named(made(name))}
    else:
        assert data["type"] == "mesh" and (tmp_path / data["visual"]).is_file() and data["hulls"]


def urdf_with(name: str) -> str:
    named = {k: " ".join(map(str, np.atleast_1d(v))) for k, v in shapes[name].named(made(name)).items()}
    values = " ".join(f'{k}="{v}"' for k, v in named.items())
    collision = f"<collision><geometry><{name} {values}/></geometry></collision>"
    return f'<robot name="r"><link name="a">{collision}</link></robot>'


@pytest.mark.parametrize("name", [n for n, k in shapes.imported().items() if Format.URDF_READ in k.formats])
def test_urdf(name, tmp_path):
    """Read, and written for Unity and for /robot_description; a shape beyond the standard is in parts."""
    model = parse_urdf(urdf_with(name), tmp_path / "r.urdf")
    (collision,) = model.links["a"].collisions
    assert_same(collision.shape, made(name))
    write_urdf(model, tmp_path)
    back = parse_urdf((tmp_path / "robot.urdf").read_text(), tmp_path / "robot.urdf").links["a"].collisions
    for mine, (shape, _) in zip(back, simpler_parts(made(name), T), strict=True):
        assert_same(mine.shape, shape)
    described = etree.fromstring(urdf_of(model).encode()).findall(".//collision/geometry/*")
    assert [e.tag for e in described] == ([name] if Format.URDF in shapes[name].formats else [])


@pytest.mark.parametrize("name", [n for n, k in shapes.imported().items() if Format.SDF in k.formats])
def test_sdf(name, tmp_path):
    named = shapes[name].named(made(name))
    values = "".join(f"<{k}>{' '.join(map(str, np.atleast_1d(v)))}</{k}>" for k, v in named.items())
    collision = f'<collision name="c"><geometry><{name}>{values}</{name}></geometry></collision>'
    (tmp_path / "w.sdf").write_text(
        f'<sdf version="1.7"><model name="m"><link name="l">{collision}</link></model></sdf>'
    )
    ((shape, _),) = load_sdf(tmp_path / "w.sdf").objects[0].shapes
    assert_same(shape, made(name))


@pytest.mark.long
def test_a_package_s_shape_collides_like_its_mesh():
    shape = make_shape(WEDGE, (0.2, 0.1, 0.1))
    assert isinstance(shape, SizedMesh) and trimesh.Trimesh(shape.vertices, shape.faces).is_watertight
    assert shape_volume(shape) == pytest.approx(0.2 * 0.1 * 0.1 / 2)
    mesh, free = Mesh(shape.vertices, shape.faces), set()
    for z in np.linspace(0.2, 0.9, 15):
        pose = SE3.from_xyz(0.35, 0.0, z)
        found = {
            checker(panda().with_object(CollisionObject.single("o", solid, pose))).is_free(panda().positions)
            for solid in (shape, mesh) for checker in (ExactChecker, KernelChecker)
        }  # fmt: skip
        assert len(found) == 1
        free |= found
    assert free == {True, False}
