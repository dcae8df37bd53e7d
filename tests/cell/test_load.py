"""Loading a cell: by name, folder, file; what it says it is; its draws."""

from __future__ import annotations

import numpy as np
import pytest

import armcell
from armcell.cell import built_in_cells, cell_names
from armcell.collision import ExactChecker
from armcell.core import SE3, Box, Cylinder, Mesh, Sphere, UnknownNameError

SMALL = """
robot: panda
start: {arm: extended, hand: closed}
padding: 0.01
objects:
  table: {box: [1, 1, 0.1], pose: [0.5, 0, -0.051]}
  ball: {sphere: 0.03, pose: [0.5, 0, 0.03], movable: true, mass: 0.2, friction: 0.4, color: [1, 0, 0, 0.5]}
  lamp:
    pose: {xyz: [0.5, 0.5, 0], rpy_deg: [0, 0, 90]}
    shapes:
      - {cylinder: [0.02, 0.4], pose: [0, 0, 0.2]}
      - {box: [0.2, 0.1, 0.02], pose: {xyz: [0.1, 0, 0.4], quat_xyzw: [0, 0, 0, 1]}}
randomize:
  ball: {dx: [-0.1, 0.1], mass: [0.1, 0.3]}
settings: {attempts: 2, near: {velocity: 0.1, acceleration: 0.05}}
physics: {timestep: 0.001}
"""


@pytest.fixture(params=cell_names())
def built_in(request):
    return armcell.load(request.param)


@pytest.fixture
def small(tmp_path):
    (tmp_path / "small.yaml").write_text(SMALL)
    return armcell.load(tmp_path / "small.yaml")


# --- the built-in cells ---
def test_both_cells_of_the_issue_are_there_with_a_description():
    assert {"panda_pick", "six_axis_pick"} <= set(cell_names())
    assert [c.name for c in built_in_cells()] == cell_names()
    assert all(c.description for c in built_in_cells())


@pytest.mark.slow
@pytest.mark.cases("*-0")
@pytest.mark.parametrize("seed", [None, 0, 1, 2, 3, 4])
def test_the_start_touches_nothing(built_in, seed):
    scene = built_in.scene(seed)
    assert not ExactChecker(scene).contacts(scene.positions, padded=False)


def test_the_six_axis_cell_is_the_issue_s():
    cell = armcell.load("six_axis_pick")
    assert len(cell.model.group("arm").joint_names) == 6
    (shape, _), = cell.scene().object("obstacle").shapes  # fmt: skip
    assert (shape.x, shape.y, shape.z) == (0.1, 0.1, 0.3)


# --- a file of one's own ---
def test_a_cell_is_found_by_file_and_by_folder(tmp_path, small):
    assert small.name == "small"
    folder = tmp_path / "kitchen"
    folder.mkdir()
    (folder / "cell.yaml").write_text(SMALL)
    assert armcell.load(folder).name == armcell.load(str(folder / "cell.yaml")).name == "kitchen"


def test_every_line_of_the_file_counts(small):
    scene = small.scene()
    assert scene.padding == 0.01
    extended = small.model.named_state("arm", "extended")
    np.testing.assert_allclose(scene.state.reindexed(extended.joint_names).positions, extended.positions)
    assert scene.state["panda_finger_joint1"] == 0.0
    table, ball, lamp = (scene.object(n) for n in ("table", "ball", "lamp"))
    assert isinstance(table.shapes[0][0], Box) and not table.movable
    assert isinstance(ball.shapes[0][0], Sphere) and ball.movable
    assert (ball.mass_kg, ball.material.friction, ball.color) == (0.2, 0.4, (1.0, 0.0, 0.0, 0.5))
    (pole, T_pole), (shade, T_shade) = lamp.shapes
    assert isinstance(pole, Cylinder) and isinstance(shade, Box)
    assert T_pole.translation[2] == 0.2
    world = lamp.T_world_object @ T_shade  # turned by 90 degrees: its arm points along y
    assert world.isclose(SE3.from_xyz_rpy((0.5, 0.6, 0.4), (0, 0, np.pi / 2)), 1e-9, 1e-9)
    assert small.settings.attempts == 2 and small.settings.near.velocity == 0.1
    assert small.settings.free == armcell.load("panda_pick").settings.free  # what is not named stays
    assert small.physics.timestep == 0.001


def test_a_mesh_beside_the_file(tmp_path):
    import trimesh

    trimesh.creation.box((100, 60, 40)).export(tmp_path / "part.stl")
    text = "robot: panda\nobjects: {part: {mesh: part.stl, mesh_scale: 0.001, pose: [0.5, 0, 0.2]}}\n"
    (tmp_path / "cell.yaml").write_text(text)
    item = armcell.load(tmp_path).scene().object("part")
    assert isinstance(item.shapes[0][0], Mesh)
    low, high = item.bounds()
    np.testing.assert_allclose(high - low, (0.1, 0.06, 0.04), atol=1e-6)


def test_a_robot_stands_where_the_cell_says(tmp_path):
    text = "robot: {model: panda, pose: {xyz: [1, 2, 0.5], rpy_deg: [0, 0, 90]}}\nstart: {arm: home}\n"
    (tmp_path / "cell.yaml").write_text(text)
    moved = armcell.load(tmp_path).scene()
    T_world_base = SE3.from_xyz_rpy((1, 2, 0.5), (0, 0, np.pi / 2))
    here = armcell.load("panda_pick").scene().frame_pose("panda_hand_tcp")
    assert moved.frame_pose("panda_hand_tcp").isclose(T_world_base @ here, 1e-9, 1e-9)


def test_a_robot_of_one_s_own_beside_the_file(tmp_path):
    (tmp_path / "arm.urdf").write_text(
        '<robot name="stick"><link name="base"/><link name="tip"/><joint name="j" type="revolute">'
        '<parent link="base"/><child link="tip"/><limit lower="-1" upper="1" velocity="1" effort="1"/>'
        "</joint></robot>"
    )
    (tmp_path / "cell.yaml").write_text("robot: arm.urdf\n")
    assert armcell.load(tmp_path).model.joint_names == ("j",)


def test_unknown_cell_lists_the_known():
    with pytest.raises(UnknownNameError, match="panda_pick.*did you mean 'panda_pick'"):
        armcell.load("panda_pik")


# --- the draw ---
@pytest.fixture(params=["panda_pick", "six_axis_pick"])
def cube_cell(request):
    return armcell.load(request.param)


@pytest.mark.slow
def test_a_seed_s_draw_is_its_own_and_in_range(cube_cell):
    draws = [cube_cell.draw(seed) for seed in range(50)]
    again = armcell.load(cube_cell.name)
    assert draws[::-1] == [again.draw(seed) for seed in reversed(range(50))]
    for name, spec in cube_cell.spec.randomize.items():
        for key, limits in spec.model_dump(exclude_none=True).items():
            values = [draw[name][key] for draw in draws]
            low, high = limits
            assert low <= min(values) and max(values) <= high
            assert len(set(values)) == 50
            assert np.ptp(values) > 0.7 * (high - low)  # the range is used


def test_the_drawn_scene_has_the_drawn_values(cube_cell):
    nominal = cube_cell.scene()
    for seed in (0, 7):
        scene, draw = cube_cell.scene(seed), cube_cell.draw(seed)["cube"]
        was, item = nominal.object("cube"), scene.object("cube")
        moved = item.T_world_object.translation - was.T_world_object.translation
        np.testing.assert_allclose(moved, (draw["dx"], draw["dy"], 0.0), atol=1e-9)
        turned = (was.T_world_object.rotation.inverse() @ item.T_world_object.rotation).log()
        np.testing.assert_allclose(turned, (0, 0, np.deg2rad(draw["yaw_deg"])), atol=1e-9)
        assert (item.mass, item.material.friction) == (draw["mass"], draw["friction"])
        unchanged = set(nominal.objects) - {"cube"}
        assert all(scene.object(n) == nominal.object(n) or
                   scene.object(n).T_world_object.isclose(nominal.object(n).T_world_object)
                   for n in unchanged)  # fmt: skip


def test_what_is_not_randomised_stays_as_written(small):
    assert set(small.draw(1)["ball"]) == {"dx", "mass"}
    item = small.scene(1).object("ball")
    assert item.material.friction == 0.4
    assert item.T_world_object.translation[1] == 0.0


def test_connecting_twice_gives_two_cells(small):
    with small.connect("fake", seed=1) as one, small.connect("fake", seed=2) as two:
        assert one.driver is not two.driver
        assert one.driver.object_poses()["ball"].distance_to(two.driver.object_poses()["ball"])[0] > 1e-3


def test_unknown_mode_lists_the_known(small):
    with pytest.raises(UnknownNameError, match="fake, real, sim"):
        small.connect("hologram")
