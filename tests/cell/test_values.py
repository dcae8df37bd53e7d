"""Values changed by their path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from armcell.cell import load
from armcell.cell.value_overrides import parse_value, with_values
from armcell.core import InputError, UnknownNameError
from armcell.sim import DepthNoise
from armcell.tasks import TaskSettings
from armcell.tasks.settings import Speed

NOISELESS = DepthNoise(farthest=1e6)  # as a cell file says it


@pytest.fixture(scope="module")
def cell():
    return load("panda_pick")


def test_the_scene_has_them(cell):
    other = with_values(
        cell,
        {
            "objects.cube.mass": 0.42,
            "objects.cube.box.2": 0.06,
            "objects.wall.pose.x": 0.6,
            "objects.wall.pose.yaw": 0.1,
            "physics.arm_kp": 4000.0,
            "settings.attempts": 2,
            "padding": 0.01,
        },
    )
    scene, before = other.scene(), cell.scene()
    assert scene.objects["cube"].mass == 0.42 and before.objects["cube"].mass == 0.1
    assert scene.objects["cube"].shapes[0][0].z == 0.06
    T = scene.objects["wall"].T_world_object
    assert T.translation[0] == 0.6 and T.rotation.rpy[2] == pytest.approx(0.1)
    assert np.array_equal(T.translation[1:], before.objects["wall"].T_world_object.translation[1:])
    assert (other.physics.arm_kp, other.settings.attempts, scene.padding) == (4000.0, 2, 0.01)
    assert cell.physics.arm_kp != 4000.0
    drawn, drawn_before = other.draw(3)["cube"], cell.draw(3)["cube"]
    assert drawn.pop("mass") == 0.42 and drawn_before.pop("mass") != 0.42
    assert drawn == drawn_before  # nothing else of the seed's draw is another


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        ("objects.cub.mass", 1.0, "did you mean 'objects.cube.mass'"),
        ("object.cube.mass", 1.0, "did you mean 'objects.cube.mass'"),
        ("objects.cube.masss", 1.0, "masss"),
        ("objects.cube.mass", -1.0, "mass"),
        ("objects.cube.box.7", 1.0, "7 of objects.cube.box.7"),
        ("objects.wall.pose.w", 1.0, "x, y, z"),
        ("physics.arm_kpp", 1.0, "arm_kp"),
        ("padding.x", 1.0, "padding.x"),
        ("nothing", 1.0, "nothing"),
        ("objects.cube.mass", "heavy", "objects/cube/mass"),
    ],
)
def test_what_cannot_be_set_is_named(cell, path, value, told):
    with pytest.raises(InputError) as caught:
        with_values(cell, {path: value})
    assert told in str(caught.value)


def test_what_has_a_name_or_a_default_may_be_changed_in_part():
    seeing = load("six_axis_camera")
    for name, known in (("above", DepthNoise.for_stereo()), ("overview", NOISELESS)):
        other = with_values(seeing, {f"cameras.{name}.noise.floor": 0.003})
        noise = next(camera.noise for camera in other.cameras if camera.name == name)
        assert noise == replace(known, floor=0.003)
        for path in (f"cameras.{name}.noise.flor", f"cameras.{name}.noise.floor.x"):
            with pytest.raises(InputError, match="noise"):
                with_values(seeing, {path: 1.0})
    with pytest.raises(UnknownNameError, match=r"did you mean 'cameras\.above\.noise\.floor'"):
        with_values(seeing, {"cameras.abov.noise.floor": 0.003})


def test_a_drawn_friction_keeps_the_ratio_of_both():
    cell = with_values(load("panda_pick"), {"objects.cube.friction": {"static": 0.8, "dynamic": 0.6}})
    for seed in (None, 3):
        material = cell.scene(seed).objects["cube"].material
        assert material.sliding / material.friction == pytest.approx(0.75)
    one = with_values(cell, {"objects.cube.friction.dynamic": 0.4})
    assert one.scene().objects["cube"].material.sliding == 0.4


def test_a_part_of_a_setting_leaves_the_rest_at_its_default(cell):
    other = with_values(
        cell,
        {
            "settings.free.velocity": 0.3,
            "settings.execution.path_tolerance": 0.2,
            "physics.gravity.z": -1.6,
        },
    )
    want = replace(TaskSettings().execution, path_tolerance=0.2)
    assert other.settings == replace(
        TaskSettings(), free=Speed(0.3, TaskSettings.free.acceleration), execution=want
    )
    assert other.physics.gravity == (0.0, 0.0, -1.6)
    with pytest.raises(InputError, match="did you mean 'velocity'"):
        with_values(cell, {"settings.free.velocty": 0.3})


def test_a_value_that_is_given_stays_as_it_is(cell):
    pose = [0.5, -0.2, 0.025]
    given = {"objects.cube.pose": pose, "objects.cube.pose.x": 0.4}
    assert with_values(cell, given).scene().objects["cube"].T_world_object.translation[0] == 0.4
    assert pose == [0.5, -0.2, 0.025]


def test_as_text():
    assert parse_value("objects.cube.mass=0.3") == ("objects.cube.mass", 0.3)
    assert parse_value("a.b=[1, 2]") == ("a.b", [1, 2])
    for wrong in ("a", "=3", "a=[1"):
        with pytest.raises(InputError):
            parse_value(wrong)
    assert issubclass(UnknownNameError, InputError)


def test_the_robot_is_loaded_anew_only_where_it_is_another():
    cell = load("panda_pick")
    assert with_values(cell, {"objects.cube.mass": 0.3}).model is cell.model
    assert with_values(cell, {"robot.model": "ur10_gripper", "start": {}}).model.name != cell.model.name
