"""Depth and pictures, with and without OpenGL."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from armcell.core import SE3, SO3, Box, InputError, Plane
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, SimWorld, has_gl, render_depth, render_rgb


def _world() -> SimWorld:
    objects = [
        CollisionObject.single("floor", Plane(), SE3.from_xyz(0, 0, -0.5)),
        CollisionObject.single(
            "red", Box(0.4, 0.4, 0.4), SE3.from_xyz(0, 3.0, -0.3), color=(1.0, 0.0, 0.0, 1.0)
        ),
    ]
    return SimWorld(PlanningScene.of(load_robot("ur10"), objects=objects))


def test_depth_of_a_plane_is_flat():
    camera = Camera("down", SE3(SO3.from_rpy((np.pi, 0, 0)), np.array([3.0, 0.0, 1.5])), 64, 48)
    depth = render_depth(_world(), camera)
    assert depth.dtype == np.float32 and depth.shape == (48, 64)
    assert depth == pytest.approx(np.full((48, 64), 2.0), abs=1e-5)


def test_depth_of_a_slanted_plane_and_of_nothing():
    camera = Camera.looking_at("far", [0, -3.0, 0.0], [0, -4.0, -1.0], width=40, height=30)
    depth = render_depth(_world(), camera)
    v, u = np.mgrid[0:30, 0:40]
    x, y = ((p - c) / camera.model.fx for p, c in ((u, 19.5), (v, 14.5)))
    points = camera.T_world_camera.apply(np.stack([x * depth, y * depth, depth], axis=-1))
    assert points[..., 2] == pytest.approx(np.full((30, 40), -0.5), abs=1e-4)
    sky = Camera.looking_at("sky", [0, -3.0, 0.0], [0, -4.0, 5.0], width=40, height=30)
    assert not render_depth(_world(), sky).any()


@pytest.mark.slow
def test_left_is_left_and_up_is_up():
    """The red box is right of and below the camera's axis, and so it is in either kind of picture."""
    camera = Camera.looking_at(
        "front", [-0.8, 1.0, 0.3], [-0.8, 3.0, 0.3], width=160, height=120, fovy_deg=60
    )
    for gl in (False, True) if has_gl() else (False,):
        picture = render_rgb(_world(), camera, gl=gl).astype(int)
        red = (picture[..., 0] > 80) & (picture[..., 1] < 60)
        v, u = np.nonzero(red)
        assert len(v) > 100, gl
        assert u.min() > 80 and v.min() > 60, gl


@pytest.mark.slow
@pytest.mark.cases("ur10_gripper")
@pytest.mark.parametrize("robot", ("panda", "ur10_gripper"))
def test_ray_cast_picture_shows_the_robot(robot):
    camera = Camera.looking_at("c", [1.7, -1.5, 1.2], [0.3, 0.0, 0.35], width=320, height=240)
    model = load_robot(robot)
    world = SimWorld(PlanningScene.of(model))
    before = world.snapshot().physics.tobytes()
    picture = render_rgb(world, camera, gl=False)
    assert picture.shape == (240, 320, 3) and picture.dtype == np.uint8
    assert picture.std() > 10 and len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
    assert world.snapshot().physics.tobytes() == before  # looking changes nothing
    q = world.joint_state().positions
    q[0] += 1.0
    world.set_positions(q)
    assert np.abs(render_rgb(world, camera, gl=False).astype(int) - picture).max() > 100  # it follows


@pytest.mark.slow
def test_without_gl_nothing_is_printed():
    script = (
        "from armcell.sim import Camera, SimWorld, has_gl, render_rgb\n"
        "from armcell.model import load_robot\nfrom armcell.scene import PlanningScene\n"
        "assert not has_gl()\n"
        "w = SimWorld(PlanningScene.of(load_robot('parallel_gripper')))\n"
        "c = Camera.looking_at('c', [0.3, 0.3, 0.2], [0, 0, 0], width=32, height=24)\n"
        "assert render_rgb(w, c).std() > 1\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], env={**os.environ, "MUJOCO_GL": "off"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "" and done.stderr == ""


def test_bad_cameras():
    with pytest.raises(InputError, match="pixels"):
        Camera("c", SE3.identity(), width=0)
    with pytest.raises(InputError, match="field of view"):
        Camera("c", SE3.identity(), fovy_deg=200.0)
