"""Gazebo worlds into cells: new files, cells that exist, the command, and a task on imported objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from tests.cli.helpers import call, read_json

import armcell
from armcell.cell import load_objects
from armcell.cell.world_import import add_to_cell, import_world, with_objects, write_imported
from armcell.core import SE3, InputError
from armcell.scene import Material
from armcell.scene.sdf import load_sdf

SEED = Path(__file__).parents[1] / "fuzz/seeds/cell.world"
WORLD = """<sdf version="1.7" xmlns:drake="drake.mit.edu"><world name="w">
  <model name="bench"><static>true</static><pose>0.5 0 -0.045 0 0 0</pose><link name="l">
    <collision name="c"><geometry><box><size>0.4 0.8 0.04</size></box></geometry></collision></link></model>
  <model name="cube"><pose>0.5 0 0 0 0 0</pose><link name="l"><inertial><mass>0.1</mass></inertial>
    <collision name="c"><geometry><box><size>0.05 0.05 0.05</size></box></geometry>
      <drake:proximity_properties><drake:mu_static>0.9</drake:mu_static><drake:mu_dynamic>0.7</drake:mu_dynamic>
      </drake:proximity_properties></collision></link></model>
</world></sdf>
"""


def same(a, b):
    assert (a.name, a.movable, a.color) == (b.name, b.movable, b.color)
    assert a.material == b.material and a.mass == b.mass
    assert a.T_world_object.isclose(b.T_world_object, 1e-12, 1e-12)
    for (shape, T), (other, U) in zip(a.shapes, b.shapes, strict=True):
        assert type(shape) is type(other) and T.isclose(U, 1e-12, 1e-12)
        np.testing.assert_allclose(shape.half_extents, other.half_extents, atol=1e-12)


def test_a_file_of_objects_reads_the_same_again(tmp_path):
    objects = load_sdf(SEED).objects
    write_imported(objects, tmp_path / "o.yaml", None)
    for a, b in zip(objects, load_objects(tmp_path / "o.yaml"), strict=True):
        same(a, b)


def test_a_new_cell(tmp_path):
    world = import_world(SEED, prefix="w_", T_cell_world=SE3.from_xyz(0.0, 0.0, -0.2))
    write_imported(world.objects, tmp_path / "c.yaml", "panda")
    scene = armcell.load(tmp_path / "c.yaml").scene()
    assert list(scene.objects) == [o.name for o in world.objects] and "w_table" in scene.objects
    np.testing.assert_allclose(scene.objects["w_table"].T_world_object.translation, [1, 0, 0.5], atol=1e-12)
    assert scene.objects["w_ball"].material == Material(0.8, dynamic_friction=0.5)
    with pytest.raises(InputError, match="file exists .*--force"):
        write_imported(world.objects, tmp_path / "c.yaml", "panda")
    before = set(tmp_path.iterdir())
    with pytest.raises(InputError, match="other.yaml: robot: .*panad"):
        write_imported(world.objects, tmp_path / "other.yaml", "panad")
    assert set(tmp_path.iterdir()) == before  # nothing is left of what failed


def test_a_mesh_of_many_objects_is_one_file(tmp_path):
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "a.stl")
    mesh = "<geometry><mesh><uri>a.stl</uri></mesh></geometry>"
    link = f'<link name="l"><collision name="c">{mesh}</collision></link>'
    models = "".join(f'<model name="m{k}">{link}</model>' for k in range(3))
    (tmp_path / "w.sdf").write_text(f"<sdf>{models}</sdf>")
    write_imported(load_sdf(tmp_path / "w.sdf").objects, tmp_path / "o.yaml", None)
    assert len(load_objects(tmp_path / "o.yaml")) == 3 and len(list(tmp_path.glob("*.obj"))) == 1


CELLS = {
    "block": "robot: panda\n# me\nobjects:\n  a: {sphere: 0.1, pose: [9, 9, 8]} # far\n\n#then\nstart: {}\n",
    "deeper block": "robot: panda\nobjects:\n    a:\n        sphere: 0.1\n        pose: [9, 9, 9]\n# end\n",
    "last, no line end": "robot: panda\nobjects:\n  a:\n    sphere: 0.1\n    pose: [9, 9, 9]",
    "braces": "robot: panda\nobjects: {a: {sphere: 0.1, pose: [9, 9, 9]}}  # far\nstart: {}\n",
    "empty": "robot: panda\nobjects: {}\nstart: {}\n",
    "null": "robot: panda\nobjects:\nstart: {}\n",
    "none": "# a cell\nrobot: panda\nstart: {}\n",
}


@pytest.mark.parametrize("text", CELLS.values(), ids=CELLS)
def test_more_objects_in_a_cell_leave_its_other_lines(text):
    entries = {"new": {"sphere": 0.2}, "more": {"box": [1.0, 1.0, 1.0], "pose": [3.0, 0.0, 0.0]}}
    made = with_objects(text, entries)
    old, new = yaml.safe_load(text), yaml.safe_load(made)
    assert new == {**old, "objects": {**(old.get("objects") or {}), **entries}}
    comments = [line[line.index("#") :] for line in text.splitlines() if "#" in line]
    assert all(comment in made for comment in comments)


def test_a_cell_that_has_the_name_already_is_left_alone(tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text("robot: panda\nobjects:\n  table: {box: [1, 1, 1], pose: [5, 5, 5]}\n")
    before = file.read_text()
    with pytest.raises(InputError, match="has 'table' already .*--prefix"):
        add_to_cell(load_sdf(SEED).objects, tmp_path)
    assert file.read_text() == before and list(tmp_path.iterdir()) == [file]
    add_to_cell(import_world(SEED, prefix="w_", T_cell_world=SE3.from_xyz(3, 0, 0)).objects, tmp_path)
    assert {"table", "w_table"} <= set(armcell.load(tmp_path).scene().objects)
    with pytest.raises(InputError, match="is a built-in cell"):
        add_to_cell(load_sdf(SEED).objects, "panda_pick")
    with pytest.raises(InputError, match="file not found"):
        add_to_cell(load_sdf(SEED).objects, tmp_path / "no.yaml")


@pytest.mark.slow
def test_the_command(capsys, tmp_path):
    numbers, cell = tmp_path / "n.json", tmp_path / "c.yaml"
    said = call(capsys, "import", SEED, "--json", numbers)
    assert (
        said.status == 0
        and "nothing written: add -o" in said.out
        and f"{SEED}:39: <plugin name='p'>" in said.words
    )
    found = read_json(numbers)
    assert len(found["objects"]) == 6 and len(found["skipped"]) == 4
    assert found["objects"][-1]["friction"] == {"static": 0.8, "dynamic": 0.5}
    arguments = (
        "--robot",
        "panda",
        "-o",
        cell,
        "--at",
        "0.3,0,-0.8",
        "--rpy-deg",
        "0,0,90",
        "--skip",
        "crate_1",
    )
    said = call(capsys, "import", SEED, *arguments)
    assert said.status == 0 and f"armcell check {cell}" in said.out
    np.testing.assert_allclose(
        armcell.load(cell).scene().objects["table"].T_world_object.translation, [0.3, 1.0, -0.1], atol=1e-9
    )
    assert call(capsys, "import", SEED, "--into", cell).status == 1
    assert call(capsys, "import", SEED, "--into", cell, "--prefix", "b_").status == 0
    assert len(armcell.load(cell).scene().objects) == 11
    for wrong in (("--into", cell, "-o", cell), ("--robot", "panda"), ("--at", "1,2")):
        assert call(capsys, "import", SEED, *wrong).status == 2
    said = call(capsys, "import", tmp_path / "no.world")
    assert said.status == 1 and "no.world: file not found" in said.err


@pytest.mark.slow
def test_a_task_on_imported_objects(capsys, tmp_path):
    """A Gazebo world becomes a cell whose cube the arm picks up in physics."""
    (tmp_path / "w.world").write_text(WORLD)
    cell = tmp_path / "cell.yaml"
    assert call(capsys, "import", tmp_path / "w.world", "--robot", "panda", "-o", cell).status == 0
    with cell.open("a") as file:
        file.write("start: {arm: home, hand: open}\ntask: [{pick: cube}, {hold: 1.0}]\n")
    said = call(capsys, "run", cell, "--headless", "--seed", 1)
    assert said.status == 0, said.out + said.err
