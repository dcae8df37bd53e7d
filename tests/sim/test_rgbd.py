"""Cameras with depth: OpenGL against rays against geometry; noise, mounts, decals."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.core import SE3, SO3, Box, InputError, Pinhole, Plane, UnknownNameError
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, Decal, DepthNoise, SimWorld, has_gl, look_at, take_image

OFF_CENTER = Pinhole(160, 120, 145.0, 150.0, 70.0, 66.0)
PICTURE = np.array([[0, 255, 0], [255, 255, 0], [0, 0, 255]], np.uint8)


@pytest.fixture(scope="module")
def world() -> SimWorld:
    objects = [
        CollisionObject.single("floor", Plane(), SE3.from_xyz(0, 0, -0.5)),
        CollisionObject.single("block", Box(0.2, 0.3, 0.4), SE3.from_xyz(0.9, 0.6, -0.3)),
    ]
    decals = [Decal("sign", "block", SE3.from_xyz(0, 0, 0.2), 0.18, PICTURE)]
    return SimWorld(PlanningScene.of(load_robot("panda"), objects=objects), decals=decals, seed=3)


def backends() -> list[bool]:
    return [False, True] if has_gl() else [False]


@pytest.mark.slow
@pytest.mark.skipif(not has_gl(), reason="no OpenGL here")
def test_opengl_and_rays_agree(world):
    """Depth to 10 micrometers, but for pixels on an edge; colors on average."""
    camera = Camera("c", look_at([1.6, -0.4, 0.8], [0.4, 0.2, 0.1]), pinhole=OFF_CENTER)
    a, b = (take_image(world, camera, gl) for gl in (True, False))
    off = np.abs(a.depth - b.depth)
    assert np.median(off) < 1e-5 and np.mean(off > 1e-3) < 0.01
    assert a.depth.max() > 2.0 > a.depth[a.depth > 0].min()
    assert np.mean(np.abs(a.rgb.astype(float) - b.rgb)) < 40


@pytest.mark.parametrize("gl", backends())
def test_depth_is_where_geometry_says(world, gl):
    """The block's top in a camera that is not centerd: its pixels back in the world are on the plane."""
    camera = Camera("c", look_at([1.2, 0.0, 0.8], [0.9, 0.6, -0.1]), pinhole=OFF_CENTER)
    image = take_image(world, camera, gl, rgb=False)
    assert image.rgb is None and image.camera == "c"
    corners = np.array([[0.8 + 0.2 * i, 0.45 + 0.3 * j, -0.1] for i in (0, 1) for j in (0, 1)])
    inside = corners.mean(axis=0) + (corners - corners.mean(axis=0)) * 0.9
    for point in inside:
        (u, v), z = OFF_CENTER.project(camera.T_world_camera.inverse().apply(point))[0], image.depth
        u, v = round(u), round(v)
        seen = np.array([(u - 70.0) / 145.0, (v - 66.0) / 150.0, 1.0]) * z[v, u]
        assert camera.T_world_camera.apply(seen)[2] == pytest.approx(-0.1, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("gl", backends())
def test_decals_are_the_right_way_round(world, gl):
    """x of a decal is right in its picture and y up."""
    camera = Camera("c", look_at([0.9, 0.6, 0.6], [0.9, 0.6, -0.1]), 120, 120, 30.0)
    image = take_image(world, camera, gl)
    for row, column in np.ndindex(3, 3):
        point = [0.9 + (column - 1) * 0.06, 0.6 + (1 - row) * 0.06, -0.0995]
        u, v = np.rint(camera.model.project(camera.T_world_camera.inverse().apply(point))[0]).astype(int)
        bright = image.rgb[v, u].mean()
        assert (bright > 120) == (PICTURE[row, column] > 0), (row, column, bright)


def test_a_camera_on_a_link_moves_with_it(world):
    T = SE3(SO3.from_rpy((0.1, 0.2, 0.3)), np.array([0.05, 0.0, 0.04]))
    camera = Camera("hand", SE3.identity(), 32, 24, link="panda_hand", T_link_camera=T)
    start = world.joint_state().positions
    for turn in (0.0, 0.5):
        q = start.copy()
        q[0] += turn
        world.set_positions(q)
        expected = world.link_pose("panda_hand") @ T
        image = take_image(world, camera, gl=False, rgb=False)
        assert image.T_world_camera.isclose(expected, 1e-9, 1e-9)
    world.set_positions(start)


def test_noise_is_as_told():
    """On a wall at 1 and at 2 m: the spread grows fourfold, steps and lost pixels are as asked."""
    noise = DepthNoise(growth=0.002, dropout=0.1)
    for z in (1.0, 2.0):
        seen = noise.applied(np.full((400, 400), z, np.float32), np.random.default_rng(0))
        assert np.mean(seen == 0) == pytest.approx(0.1, abs=0.005)
        assert seen[seen > 0].std() == pytest.approx(0.002 * z * z, rel=0.02)
        assert seen[seen > 0].mean() == pytest.approx(z, abs=1e-4)
    stepped = DepthNoise(step=0.01).applied(np.linspace(0.5, 0.6, 1000, dtype=np.float32)[None], _rng())
    assert len(np.unique(stepped)) == 11
    wall = np.full((50, 50), 1.0, np.float32)
    wall[:, 25:] = 2.0
    edge = DepthNoise(edge_dropout=1.0, nearest=0.5, farthest=1.5).applied(wall, _rng())
    assert not edge[:, 24:].any() and np.all(edge[:, :24] == 1.0)


def _rng() -> np.random.Generator:
    return np.random.default_rng(1)


def test_the_same_moment_looks_the_same_and_another_does_not(world):
    camera = Camera("c", look_at([1, 0, 1], [0.5, 0, 0]), 32, 24, noise=DepthNoise.for_stereo())
    first, again = (take_image(world, camera, gl=False, rgb=False).depth for _ in range(2))
    assert np.array_equal(first, again)
    world.step()
    assert not np.array_equal(first, take_image(world, camera, gl=False, rgb=False).depth)


def test_a_camera_without_depth(world):
    image = take_image(world, Camera("c", SE3.identity(), 16, 16, has_depth=False), gl=False)
    assert image.depth is None and image.rgb is not None


def test_wrong_cameras_noise_and_decals():
    with pytest.raises(InputError, match="distortion"):
        Camera("c", SE3.identity(), pinhole=Pinhole(10, 10, 9, 9, 5, 5, (0.1, 0, 0, 0)))
    with pytest.raises(InputError, match="rate of 0"):
        Camera("c", SE3.identity(), rate=0)
    with pytest.raises(InputError, match="belong together"):
        Camera("c", SE3.identity(), link="a")
    with pytest.raises(InputError, match="dropout 1.5"):
        DepthNoise(dropout=1.5)
    with pytest.raises(InputError, match="nearest >= farthest"):
        DepthNoise(nearest=2, farthest=1)
    with pytest.raises(InputError, match="same point"):
        look_at([1, 2, 3], [1, 2, 3])
    with pytest.raises(UnknownNameError, match="nowhere"):
        scene = PlanningScene.of(load_robot("parallel_gripper"))
        lost = SimWorld(scene, decals=[Decal("d", "nowhere", SE3.identity(), 0.1, PICTURE)])
        take_image(lost, Camera("c", SE3.identity(), 16, 16), gl=False)
