"""SDF worlds as objects: shapes, groups of links, masses, frictions, colors; what is listed; errors."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from armcell.core import Box, Capsule, Cone, Cylinder, InputError, Mesh, Plane, Sphere
from armcell.model.assets import load_mesh
from armcell.scene import Material
from armcell.scene.sdf import SdfWorld, load_sdf

SEED = Path(__file__).parents[2] / "fuzz/seeds/cell.world"
BOX = "<geometry><box><size>0.1 0.2 0.3</size></box></geometry>"


def solid(geometry: str, name: str = "c", more: str = "") -> str:
    return f'<collision name="{name}"><geometry>{geometry}</geometry>{more}</collision>'


def body(name: str = "l", inside: str = solid("<box><size>0.1 0.2 0.3</size></box>")) -> str:
    return f'<link name="{name}">{inside}</link>'


def model(inside: str, name: str = "m") -> str:
    return f'<model name="{name}">{inside}</model>'


def world(folder: Path, inside: str, **options) -> SdfWorld:
    file = folder / "w.world"
    file.write_text(
        f'<sdf version="1.7" xmlns:drake="drake.mit.edu"><world name="w">\n{inside}</world></sdf>'
    )
    return load_sdf(file, **options)


def by_name(found: SdfWorld):
    return {item.name: item for item in found.objects}


def test_a_whole_world():
    found = load_sdf(SEED)
    objects = by_name(found)
    assert list(objects) == ["ground_plane", "table", "crate_1", "shelf_post", "shelf_board_plank", "ball"]
    table, crate, ball = objects["table"], objects["crate_1"], objects["ball"]
    assert not table.movable and len(table.shapes) == 2 and table.color == (0.6, 0.45, 0.3, 1.0)
    # The include puts the crate's bottom, 0.1 m below its origin, on the table, 0.2 m along the table's x,
    # which the bench turns to the world's y.
    np.testing.assert_allclose(crate.T_world_object.translation, [1.0, 0.2, 0.82], atol=1e-9)
    assert crate.T_world_object.rotation.rpy[2] == pytest.approx(np.deg2rad(135), abs=1e-6)
    assert (crate.movable, crate.mass, crate.material.friction) == (True, 2.5, 0.6)
    assert crate.color == (0.8, 0.5, 0.2, 1.0)
    assert ball.mass == pytest.approx(500 * 4 / 3 * np.pi * 0.05**3)  # from its density
    assert ball.material == Material(0.8, dynamic_friction=0.5)
    assert ball.T_world_object.translation[2] == 0.05  # the saved state's, not the model's 1 m
    assert not objects["shelf_post"].movable and not objects["shelf_board_plank"].movable  # at a hinge
    listed = [(note.what, note.line) for note in found.skipped]
    assert listed == [
        ("<include>", 4), ("<joint name='hinge'>", 30),
        ("<sensor name='touch'>", 37), ("<plugin name='p'>", 39)
    ]  # fmt: skip


SHAPES = {
    "box": ("<box><size>1 2 3</size></box>", Box(1, 2, 3)),
    "sphere": ("<sphere><radius>0.5</radius></sphere>", Sphere(0.5)),
    "cylinder": ("<cylinder><radius>0.5</radius><length>2</length></cylinder>", Cylinder(0.5, 2)),
    "capsule": ("<capsule><radius>0.5</radius><length>2</length></capsule>", Capsule(0.5, 2)),
    "cone": ("<cone><radius>0.5</radius><length>2</length></cone>", Cone(0.5, 2)),
}


@pytest.mark.parametrize(("text", "shape"), SHAPES.values(), ids=SHAPES)
def test_shapes(tmp_path, text, shape):
    (item,) = world(tmp_path, model(body(inside=solid(text)))).objects
    assert item.shapes[0][0] == shape and item.movable and item.mass == 1.0  # SDF's default


def test_an_ellipsoid_is_a_mesh_of_its_size(tmp_path):
    text = solid("<ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid>")
    (item,) = world(tmp_path, model(body(inside=text))).objects
    mesh = item.shapes[0][0]
    assert isinstance(mesh, Mesh)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.2, 0.4, 0.6], rtol=0.01)
    solid_mesh = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert solid_mesh.is_watertight
    assert solid_mesh.volume == pytest.approx(4 / 3 * np.pi * 0.006, rel=0.02)


def test_a_plane_s_normal_is_its_z_axis(tmp_path):
    text = solid("<plane><normal>0 2 0</normal><size>1 1</size></plane>")
    (item,) = world(tmp_path, model("<static>1</static>" + body(inside=text))).objects
    shape, T = item.shapes[0]
    assert isinstance(shape, Plane)
    np.testing.assert_allclose(T.rotation.matrix[:, 2], [0, 1, 0], atol=1e-12)


def test_meshes_by_every_uri(tmp_path):
    folder = tmp_path / "share/tool"
    (folder / "meshes").mkdir(parents=True)
    (folder / "package.xml").write_text("<package><name>tool</name></package>")
    trimesh.creation.box((0.1, 0.2, 0.3)).export(folder / "meshes/a.stl")
    uris = ("model://tool/meshes/a.stl", "package://tool/meshes/a.stl", f"file://{folder}/meshes/a.stl",
            "share/tool/meshes/a.stl")  # fmt: skip
    for uri in uris:
        text = solid(f"<mesh><uri>{uri}</uri><scale>2 1 1</scale></mesh>")
        (item,) = world(tmp_path, model(body(inside=text)), folders=[tmp_path / "share"]).objects
        np.testing.assert_allclose(np.ptp(item.shapes[0][0].vertices, axis=0), [0.2, 0.2, 0.3])


def test_links_that_fixed_joints_connect_are_one_object(tmp_path):
    fixed = '<joint name="j" type="{}"><parent>{}</parent><child>b</child>{}</joint>'
    pair = body("a", "<inertial><mass>2</mass></inertial>" + solid(SHAPES["box"][0])) + body("b")
    stuck = "<axis><xyz>0 0 1</xyz><limit><lower>0</lower><upper>0</upper></limit></axis>"
    for joint in (fixed.format("fixed", "a", ""), fixed.format("revolute", "a", stuck)):
        (item,) = world(tmp_path, model(pair + joint)).objects
        assert (item.name, item.movable, item.mass, len(item.shapes)) == ("m", True, 3.0, 2)
    apart = by_name(world(tmp_path, model(pair)))
    assert list(apart) == ["m_a", "m_b"] and all(item.movable for item in apart.values())
    held = by_name(world(tmp_path, model(pair + fixed.format("fixed", "world", ""))))
    assert held["m_a"].movable and not held["m_b"].movable
    hinged = world(tmp_path, model(pair + fixed.format("revolute", "a", "")))
    assert not any(item.movable for item in hinged.objects)
    assert [str(note.what) for note in hinged.skipped] == ["<joint name='j'>"]
    by_frame = (
        pair + '<frame name="f" attached_to="b"/>' + fixed.format("fixed", "a", "").replace(">b<", ">f<")
    )
    assert len(world(tmp_path, model(by_frame)).objects) == 1


def test_a_static_model_holds_what_is_in_it(tmp_path):
    inner = model(body("x"), "inner")
    (item,) = world(tmp_path, model("<static>true</static>" + body("a") + inner)).objects
    assert not item.movable and len(item.shapes) == 2


FRICTION = {
    "both directions": ("<ode><mu>0.7</mu><mu2>0.7</mu2></ode>", Material(0.7), 0),
    "directions that differ": ("<ode><mu>0.7</mu><mu2>0.4</mu2></ode>", Material(0.4), 1),
    "one": ("<ode><mu>0.7</mu></ode>", Material(0.7), 0),
    "bullet": ("<bullet><friction>0.3</friction></bullet>", Material(0.3), 0),
    "none": ("", Material(), 0),
}


@pytest.mark.parametrize(("text", "material", "notes"), FRICTION.values(), ids=FRICTION)
def test_frictions(tmp_path, text, material, notes):
    surface = f"<surface><friction>{text}</friction></surface>"
    found = world(tmp_path, model(body(inside=solid(SHAPES["box"][0], more=surface))))
    assert found.objects[0].material == material and len(found.skipped) == notes


def test_drake_s_static_and_dynamic_friction(tmp_path):
    mu = "<drake:mu_static>0.9</drake:mu_static><drake:mu_dynamic>0.6</drake:mu_dynamic>"
    more = f"<drake:proximity_properties>{mu}</drake:proximity_properties>"
    (item,) = world(tmp_path, model(body(inside=solid(SHAPES["box"][0], more=more)))).objects
    assert item.material == Material(0.9, dynamic_friction=0.6)


@pytest.mark.parametrize(
    ("material", "color"),
    [
        ("<diffuse>0.1 0.2 0.3 0.5</diffuse>", (0.1, 0.2, 0.3, 0.5)),
        ("<diffuse>0.1 0.2 0.3</diffuse>", (0.1, 0.2, 0.3, 1.0)),
        ("<ambient>2 0 0 1</ambient>", (1.0, 0.0, 0.0, 1.0)),
        ("<script><name>Gazebo/Red</name></script>", (1.0, 0.0, 0.0, 1.0)),
        ("<script><name>My/Own</name></script>", (0.6, 0.6, 0.6, 1.0)),
    ],
)
def test_colors(tmp_path, material, color):
    visual = f'<visual name="v">{BOX}<material>{material}</material></visual>'
    (item,) = world(tmp_path, model(body(inside=solid(SHAPES["box"][0]) + visual))).objects
    assert item.color == color


LISTED = {
    "light": ('<light name="x" type="point"/>', "<light name='x'>"),
    "plugin": ('<plugin name="x" filename="y"/>', "<plugin name='x'>"),
    "actor": ('<actor name="x"/>', "<actor name='x'>"),
    "physics": ('<physics type="ode"/>', "<physics>"),
    "gravity": ("<gravity>0 0 -1.6</gravity>", "<gravity>"),
    "heightmap": (model(body(inside=solid("<heightmap/>"))), "<collision name='c'>"),
    "polyline": (model(body(inside=solid("<polyline/>"))), "<collision name='c'>"),
    "submesh": (
        model(body(inside=solid("<mesh><uri>a.dae</uri><submesh><name>s</name></submesh></mesh>"))), "<mesh>"
    ),
    "looks only": (model(body(inside=f'<visual name="v">{BOX}</visual>')), "<link name='l'>"),
    "floating": (model(body(inside="<gravity>0</gravity>" + solid(SHAPES["box"][0]))), "<link name='l'>"),
    "moving plane": (model(body(inside=solid("<plane/>"))), "<link name='l'>"),
    "included light": ("<include><uri>model://lamp</uri></include>", "<include>"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "what"), LISTED.values(), ids=LISTED)
def test_other_content_is_listed_with_its_line(tmp_path, text, what):
    (tmp_path / "lamp").mkdir()
    (tmp_path / "lamp/model.sdf").write_text('<sdf><light name="lamp"/></sdf>')
    notes = world(tmp_path, text).skipped
    assert [note.what for note in notes] == [what] and notes[0].line == 2 and notes[0].why


def test_a_model_can_be_left_out(tmp_path):
    text = model(body()) + model(body(), "robot") + "<include><uri>model://nowhere</uri></include>"
    found = world(tmp_path, text, skip={"robot", "nowhere"})
    assert [item.name for item in found.objects] == ["m"] and len(found.skipped) == 2
    with pytest.raises(InputError, match="no model 'robt' to skip .*models: m, robot"):
        world(tmp_path, model(body()) + model(body(), "robot"), skip={"robt"})


def test_models_are_found_in_the_search_path(tmp_path, monkeypatch):
    part = tmp_path / "elsewhere/part"
    part.mkdir(parents=True)
    (part / "model.sdf").write_text(f'<sdf version="1.6">{model(body())}</sdf>')
    text = "<include><uri>{}</uri><name>a</name></include>"
    here = tmp_path / "here"
    here.mkdir()
    for uri in ("model://part", "https://fuel.gazebosim.org/1.0/OpenRobotics/models/part/3"):
        with pytest.raises(InputError, match=rf"w.world:2: <uri>: {uri} not found .*--package FOLDER"):
            world(here, text.format(uri))
        for variable in ("GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH"):
            monkeypatch.setenv(variable, f"/nowhere:{tmp_path / 'elsewhere'}")
            assert [item.name for item in world(here, text.format(uri)).objects] == ["a"]
            monkeypatch.delenv(variable)


UNKNOWN = '<pose relative_to="x"/>'
LOOSE = '<joint name="j"><parent>l</parent><child>x</child></joint>'
ZERO = '<pose rotation_format="quat_xyzw">0 0 0 0 0 0 0</pose>'
ERRORS = {
    "not XML": ("<sdf", r"w.world:1: is not valid XML"),
    "entities": ("<!DOCTYPE x [<!ENTITY a 'b'>]><sdf/>", "DOCTYPE"),
    "a URDF": ("<robot name='r'/>", "root element is not <sdf>.*armcell setup"),
    "nothing": ("<sdf version='1.7'/>", "neither a <world> nor a <model>"),
    "no name": ("<sdf><world><model/></world></sdf>", "<model>: attribute 'name' is missing"),
    "no size": (f"<sdf>{model(body(inside=solid('<box/>')))}</sdf>", "<box>: has no <size>"),
    "size of two": (
        f"<sdf>{model(body(inside=solid('<box><size>1 2</size></box>')))}</sdf>", "<size>: '1 2' must be 3"
    ),
    "negative size": (
        f"<sdf>{model(body(inside=solid('<sphere><radius>-1</radius></sphere>')))}</sdf>", "<sphere>"
    ),
    "not a number": (
        f"<sdf>{model(body(inside=solid('<sphere><radius>x</radius></sphere>')))}</sdf>", "'x' is not a list"
    ),
    "not finite": (f"<sdf>{model('<pose>1e999 0 0 0 0 0</pose>' + body())}</sdf>", "must be 6 finite"),
    "no mass": (
        f"<sdf>{model(body(inside='<inertial><mass>0</mass></inertial>'))}</sdf>".replace(
            "</inertial>", "</inertial>" + solid(SHAPES["box"][0])
        ), "mass 0 kg must be positive",
    ),
    "friction": (
        "<sdf>" + model(body(inside=solid(
            SHAPES["box"][0], more="<surface><friction><ode><mu>-1</mu></ode></friction></surface>"
        ))) + "</sdf>", "<mu>: friction -1 is negative",
    ),
    "boolean": (f"<sdf>{model('<static>yes</static>' + body())}</sdf>", "<static> is 'yes'.*true or false"),
    "unknown frame": (
        f"<sdf>{model(UNKNOWN + body())}</sdf>", "unknown frame 'x' .*frames here: m"
    ),
    "circle": (
        "<sdf>" + model(body() + "<frame name='a'><pose relative_to='b'/></frame>"
                        "<frame name='b'><pose relative_to='a'/></frame>"
                        "<model name='n'><pose relative_to='a'/>" + body() + "</model>") + "</sdf>",
        "hangs on itself",
    ),
    "unknown link": (
        f"<sdf>{model(body() + LOOSE)}</sdf>",
        "<joint name='j'>: unknown child link 'x' .*links: l",
    ),
    "two links": (f"<sdf>{model(body() + body())}</sdf>", "a second link of this name"),
    "quaternion": (
        f"<sdf>{model(ZERO + body())}</sdf>",
        "quaternion of length 0",
    ),
    "missing mesh": (
        f"<sdf>{model(body(inside=solid('<mesh><uri>a.stl</uri></mesh>')))}</sdf>", "<uri>: a.stl not found"
    ),
    "path out of the model folder": (
        f"<sdf>{model(body(inside=solid('<mesh><uri>model://a/../../etc/passwd</uri></mesh>')))}</sdf>",
        "is not a valid URI",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "words"), ERRORS.values(), ids=ERRORS)
def test_errors_name_file_line_and_element(tmp_path, text, words):
    file = tmp_path / "w.world"
    file.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        load_sdf(file)
    assert str(file) in str(caught.value) and (caught.value.line or "DOCTYPE" in text)


def test_a_model_that_includes_itself_ends(tmp_path, within):
    folder = tmp_path / "loop"
    folder.mkdir()
    include = "<include><uri>model://loop</uri><name>{}</name></include>"
    inside = body() + include.format("a") + include.format("b")
    (folder / "model.sdf").write_text(f"<sdf>{model(inside)}</sdf>")
    with within(20), pytest.raises(InputError, match="nested deeper than|more than 5000 models"):
        world(tmp_path, include.format("top"))


def test_a_collada_file_s_unit_counts(tmp_path):
    """As in Gazebo: the same box in centimeters and in meters."""
    for unit, name in ((0.01, "centimeter"), (1, "meter")):
        data = trimesh.exchange.dae.export_collada(trimesh.creation.box(np.array([0.1, 0.2, 0.3]) / unit))
        head, tail = data.decode().split("</asset>", 1)
        head = re.sub(r"<unit[^>]*/>", "", head) + f'<unit name="{name}" meter="{unit}"/>'
        (tmp_path / "a.dae").write_text(f"{head}</asset>{tail}")
        load_mesh.cache_clear()
        (item,) = world(tmp_path, model(body(inside=solid("<mesh><uri>a.dae</uri></mesh>")))).objects
        np.testing.assert_allclose(np.ptp(item.shapes[0][0].vertices, axis=0), [0.1, 0.2, 0.3], rtol=1e-6)


def test_a_mesh_in_millimeters_is_listed_and_not_an_obstacle(tmp_path):
    trimesh.creation.box((100, 200, 300)).export(tmp_path / "a.stl")
    text = solid("<mesh><uri>a.stl</uri></mesh>") + solid(SHAPES["box"][0], "d")
    found = world(tmp_path, model(body(inside=text)))
    assert len(found.objects[0].shapes) == 1
    assert "probably in millimeters (give the mesh another <scale>)" in found.skipped[0].why
