"""Objects that lie still may sleep: the same physics for less."""

from __future__ import annotations

from threading import Thread

import numpy as np
import pytest

from armcell.core import SE3, Box
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, PhysicsSettings, SimWorld, look_at, take_image

MODEL = load_robot("ur10_gripper")


def scene():
    table = CollisionObject.single("table", Box(2, 2, 0.02), SE3.from_xyz(0.5, 0, -0.01))
    low = CollisionObject.single("low", Box(0.05, 0.05, 0.05), SE3.from_xyz(0.8, 0, 0.03), movable=True)
    high = CollisionObject.single("high", Box(0.04, 0.04, 0.04), SE3.from_xyz(0.8, 0, 0.08), movable=True)
    return PlanningScene.of(MODEL, objects=[table, low, high]).with_state(MODEL.named_state("arm", "up"))


def test_asleep_things_rest_where_they_would_awake_and_wake_when_moved():
    awake, asleep = (SimWorld(scene(), PhysicsSettings(sleep=sleep)) for sleep in (False, True))
    for world in (awake, asleep):
        world.step(1000)
    assert asleep.mj_data.ntree_awake < awake.mj_data.ntree_awake
    for name in ("low", "high"):
        assert awake.object_pose(name).isclose(asleep.object_pose(name), 5e-4, 5e-3)
    asleep.set_object_pose("low", SE3.from_xyz(0.8, 0.3, 0.025))
    asleep.step(500)
    assert asleep.object_pose("high").translation[2] == pytest.approx(0.02, abs=1e-3)  # its support is gone


@pytest.mark.slow
def test_pictures_of_a_sleeping_world_show_it():
    camera = Camera("above", look_at((0.8, 0.0, 1.0), (0.8, 0.001, 0.0)), 64, 48, 30.0)
    depths = []
    for sleep in (False, True):
        world = SimWorld(scene(), PhysicsSettings(sleep=sleep), [camera])
        world.step(500)
        depths.append(take_image(world, camera, rgb=False).depth)
    np.testing.assert_allclose(depths[0], depths[1], atol=1e-3)


@pytest.mark.slow
def test_a_picture_is_whole_after_another_worlds_pictures_are_gone():
    """A freed renderer may not take the buffers of the one that is in use."""
    camera = Camera("above", look_at((0.8, 0.0, 1.0), (0.8, 0.001, 0.0)), 64, 48, 30.0)
    first, second = SimWorld(scene(), cameras=[camera]), SimWorld(scene(), cameras=[camera])
    take_image(first, camera, rgb=False)
    before = take_image(second, camera, rgb=False).depth
    first.render_cache = None
    np.testing.assert_array_equal(take_image(second, camera, rgb=False).depth, before)


@pytest.mark.slow
def test_several_threads_take_pictures_of_one_world():
    """Arms that work side by side have a thread each and may use the same camera."""
    camera = Camera("above", look_at((0.8, 0.0, 1.0), (0.8, 0.001, 0.0)), 64, 48, 30.0)
    world = SimWorld(scene(), cameras=[camera])
    depths = [take_image(world, camera, rgb=False).depth]
    for _ in range(2):
        thread = Thread(target=lambda: depths.append(take_image(world, camera, rgb=False).depth))
        thread.start()
        thread.join()
    assert len(depths) == 3
    for depth in depths[1:]:
        np.testing.assert_array_equal(depth, depths[0])
