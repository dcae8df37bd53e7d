"""A pick whose object poses come from a camera only."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tests.perception.test_mesh_poses import notched
from tests.sizes import seeds

from armcell.cell import load, run_task
from armcell.core import SE3, ErrorCode, InputError
from armcell.perception import pose_error


@pytest.fixture(scope="module")
def cell():
    return load("six_axis_camera")


@pytest.mark.slow
def test_nobody_knows_where_the_cube_is_before_a_look(cell):
    with cell.connect(seed=2) as live:
        assert "cube" not in live.scene().objects and "cube" not in live.driver.object_poses()
        with pytest.raises(InputError, match="unknown object 'cube'"):
            live.arm.pick("cube")
        sight = live.look("above")
        assert sight.ok, sight.message
        true = live.driver.world.object_pose("cube")
        item = live.scene().object("cube")
        position, angle = pose_error(item.shapes, item.T_world_object, true)
        assert 0 < position < 0.002 and np.rad2deg(angle) < 2.0  # near, and not the truth itself


@pytest.mark.long
def test_a_cube_that_is_hidden_or_a_camera_that_fails_ends_the_task(cell):
    with cell.connect(seed=2) as live:
        live.driver.world.set_object_pose("cube", SE3.from_xyz(3, 3, 0.1))
        result = run_task(cell, live, 2, "sim")
        assert not result["success"] and "cube not found" in result["message"]
    with cell.connect(seed=2) as live:
        live.camera("above").image()
        live.camera("above").frozen = True
        live.ctx.advance(1.0)
        sight = live.look("above")
        assert sight.code is ErrorCode.SENSOR_INFO_STALE and "frozen" in sight.message


@pytest.mark.slow
@pytest.mark.cases("0")
@pytest.mark.parametrize("seed", seeds(2, range(5)))
def test_picked_and_placed_where_the_camera_says(cell, seed):
    with cell.connect(seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
        assert result["success"], result["message"]
        assert not result["unwanted_contacts"] and not result["welds"]
        true, seen = live.driver.world.object_pose("cube"), live.driver.object_poses()["cube"]
        assert np.linalg.norm(true.translation - seen.translation) < 0.003  # looked at again at the end
        mat = cell.scene().object("mat").T_world_object
        assert np.abs(mat.inverse().apply(true.translation))[:2].max() < 0.08


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        ("{camera: eye, objects: [cube]}", "perception: camera 'eye' has no depth.*depth: false"),
        ("{camera: front, objects: [cube]}", "unknown camera 'front'"),
        ("{camera: deep, objects: [ball]}", "unknown object 'ball'"),
        ("{camera: deep, objects: [table]}", "'table' is fixed"),
        ("{camera: deep, objects: [cube], on: table}", "unknown key 'on'.*surface"),
        ("{camera: deep, objects: []}", "perception/objects"),
    ],
)
def test_wrong_entries_are_named(tmp_path, lines, text):
    (tmp_path / "cell.yaml").write_text(
        "robot: panda\nobjects:\n  table: {box: [1, 1, 0.02], pose: [0.5, 0, -0.02]}\n"
        "  cube: {box: [0.05, 0.05, 0.05], pose: [0.5, 0, 0.025], movable: true}\n"
        "cameras:\n  eye: {eye: [1, 0, 1], target: [0, 0, 0], depth: false}\n"
        f"  deep: {{eye: [1, 0, 1], target: [0, 0, 0]}}\nperception: {lines}\n"
    )
    with pytest.raises(InputError, match=text):
        load(tmp_path)


AMBIGUOUS = """
robot: panda
objects:
  table: {box: [0.8, 0.8, 0.04], pose: [0.6, 0, -0.02]}
  thing: {mesh: thing.stl, pose: [0.6, 0, 0.001], movable: true}
cameras:
  above: {eye: [0.6, 0.01, 0.6], target: [0.6, 0, 0.03], width: 320, height: 240, noise: stereo}
  back: {eye: [0.95, 0, 0.4], target: [0.6, 0, 0.03], width: 320, height: 240, noise: stereo}
perception: {camera: above, objects: [thing], surface: table}
task: [{look: [above, back]}]
"""


@pytest.mark.slow
def test_an_object_of_ambiguous_pose_is_not_in_the_scene_until_a_second_camera_sees_it(tmp_path):
    mesh = notched()
    trimesh.Trimesh(mesh.vertices, mesh.faces).export(tmp_path / "thing.stl")
    (tmp_path / "cell.yaml").write_text(AMBIGUOUS)
    cell = load(tmp_path)
    with cell.connect(seed=0) as live:
        assert live.look(["above", "back"]).ok
        assert "thing" in live.scene().objects
        sight = live.look("above")
        assert "ambiguous" in sight.message
        assert "thing" not in live.scene().objects
        with pytest.raises(InputError, match="unknown object 'thing'"):
            live.arm.pick("thing")
        result = run_task(cell, live, 0, "sim")
        assert result["success"], result["message"]
