"""The map of a camera: what is seen is in it, the robot and known objects are not, rays clear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from armcell.collision import ExactChecker
from armcell.core import SE3, Box, ErrorCode, InputError
from armcell.model import load_robot
from armcell.perception import CameraMap, MapSettings
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, DepthNoise, SimWorld, look_at, take_image

TABLE = CollisionObject.single("table", Box(1.2, 1.6, 0.04), SE3.from_xyz(0.5, 0, -0.02))
BLOCK = CollisionObject.single("block", Box(0.1, 0.1, 0.3), SE3.from_xyz(0.6, 0.2, 0.15), movable=True)
CAMERA = Camera(
    "eye", look_at([1.5, -0.8, 1.0], [0.5, 0.1, 0.2]), 320, 240, 60.0, noise=DepthNoise.for_stereo()
)


@pytest.fixture(scope="module")
def cell() -> tuple[SimWorld, PlanningScene]:
    """A Panda, a table and a block that the planning scene does not know of."""
    robot = load_robot("panda")
    known = PlanningScene.of(robot, objects=[TABLE]).with_state(robot.named_state("arm", "home"))
    return SimWorld(known.with_object(BLOCK)), known


@pytest.mark.long
def test_the_unknown_block_is_in_the_map_and_nothing_else(cell):
    world, known = cell
    world.set_object_pose("block", BLOCK.T_world_object)
    seen = CameraMap()
    done = seen.update(take_image(world, CAMERA), known)
    assert done.ok and done.hits > 100 and done.robot_points > 500 and done.object_points > 2000
    local = BLOCK.T_world_object.inverse().apply(seen.octree.centers)
    off = np.abs(local) - BLOCK.shapes[0][0].half_extents
    assert np.mean(np.max(off, axis=1) < 0.03) > 0.97  # [m] a voxel and three sigma of noise
    checker = ExactChecker(seen.applied_to(known))
    assert not checker.contacts(known.positions)  # the robot is not in its own map


@pytest.mark.slow
def test_it_goes_when_the_block_goes_and_comes_where_it_comes(cell):
    world, known = cell
    world.set_object_pose("block", BLOCK.T_world_object)
    seen = CameraMap()
    for _ in range(2):
        seen.update(take_image(world, CAMERA), known)
        world.step()
    moved = SE3.from_xyz(0.6, -0.3, 0.15)
    world.set_object_pose("block", moved)
    for _ in range(6):
        assert seen.update(take_image(world, CAMERA), known).ok
        world.step()
    local = moved.inverse().apply(seen.octree.centers)
    assert len(local) > 50 and np.mean(np.abs(local).max(axis=1) < 0.2) > 0.95


def test_what_is_held_is_not_an_obstacle(cell):
    world, known = cell
    hand = known.frame_pose("panda_hand")
    held = BLOCK.at(SE3.from_xyz(*(hand.translation - [0, 0, 0.3])))
    world.set_object_pose("block", held.T_world_object)
    without = CameraMap()
    assert without.update(take_image(world, CAMERA), known).hits > 100
    holding = known.with_object(held).with_attached("block", "panda_hand", ("panda_leftfinger",))
    with_it = CameraMap()
    assert with_it.update(take_image(world, CAMERA), holding).hits < 10


def test_pictures_that_cannot_be_used_leave_the_map_as_it_was(cell):
    world, known = cell
    world.set_object_pose("block", BLOCK.T_world_object)
    image, seen = take_image(world, CAMERA), CameraMap()
    seen.update(image, known)
    before = seen.octree
    stale = seen.update(image, known, now=image.time + 1.0)
    blind = seen.update(replace(image, depth=np.full_like(image.depth, np.nan)), known)
    assert stale.code is ErrorCode.SENSOR_INFO_STALE and "frozen" in stale.message
    assert blind.code is ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA
    assert seen.octree is before and stale.cells == len(before.sizes)


def test_wrong_settings():
    with pytest.raises(InputError, match="every is 0"):
        MapSettings(every=0)
    with pytest.raises(InputError, match="robot_padding"):
        MapSettings(robot_padding=-1)
    with pytest.raises(InputError, match="resolution"):
        CameraMap(MapSettings(resolution=0))


@pytest.mark.slow
def test_noise_of_single_pixels_makes_no_obstacle(cell):
    """Over many pictures of a table far off some pixels leave its padding, each of them alone."""
    world, known = cell
    world.set_object_pose("block", SE3.from_xyz(3, 3, 0.15))
    far = replace(CAMERA, T_world_camera=look_at([2.2, -1.4, 1.4], [0.5, 0.0, 0.0]))
    images = [take_image(world, far) for _ in range(8) if world.step() is None]
    single = CameraMap(MapSettings(speckle=1))
    assert sum(single.update(image, known).hits for image in images) > 5
    assert sum(CameraMap().update(image, known).hits for image in images) == 0
    with pytest.raises(InputError, match="speckle is 0"):
        MapSettings(speckle=0)
