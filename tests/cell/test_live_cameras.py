"""Cameras of a running cell: rate, freezing, the octomap that follows, the stop before an obstacle."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.cell import load
from armcell.core import SE3, ErrorCode, InputError, UnknownNameError
from armcell.perception import MapSettings
from armcell.scene import OCTOMAP

CELL = """
robot: panda
start: {arm: home, hand: open}
objects:
  table: {box: [1.2, 1.8, 0.04], pose: [0.4, 0, -0.021]}
  post: {box: [0.08, 0.08, 0.7], pose: [0.55, 0, 5.0], movable: true}
cameras:
  eye: {eye: [1.6, -0.9, 1.2], target: [0.4, 0, 0.3], width: 320, height: 240, fovy_deg: 60, noise: stereo}
"""
LEFT = [0.9, 0.3, 0, -1.9, 0, 2.2, 0.8]
RIGHT = [-0.9, 0.3, 0, -1.9, 0, 2.2, 0.8]


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seeing")
    (folder / "cell.yaml").write_text(CELL)
    return load(folder)


def without_post(live) -> None:
    """The post stays in physics, the planner does not know of it."""
    live.change_scene(lambda scene: scene.without_object("post"))


@pytest.mark.slow
def test_pictures_come_at_the_rate_and_a_frozen_camera_gives_the_last(cell):
    with cell.connect() as live:
        camera = live.camera()
        assert live.camera("eye") is camera
        first = camera.image(rgb=False)
        live.ctx.advance(0.02)
        assert camera.image(rgb=False) is first and not camera.due()
        live.ctx.advance(0.02)
        second = camera.image(rgb=False)
        assert second.time == pytest.approx(0.04, abs=0.005)
        camera.frozen = True
        live.ctx.advance(1.0)
        assert camera.image(rgb=False) is second
        with pytest.raises(UnknownNameError, match="camera 'front'"):
            live.camera("front")


@pytest.mark.slow
def test_the_fake_robot_has_cameras_too(cell):
    with cell.connect("fake") as live, cell.connect("sim") as real:
        a, b = (c.camera().image(rgb=False) for c in (live, real))
        assert np.mean(np.abs(a.depth - b.depth) < 0.02) > 0.95  # noise of other moments


@pytest.mark.slow
def test_the_octomap_follows_and_a_motion_stops_before_what_comes_across(cell):
    with cell.connect() as live:
        without_post(live)
        live.driver.world.set_object_pose("post", SE3.from_xyz(3, 3, 0.35))
        watch = live.watch(settings=MapSettings(), rate=15)
        assert live.arm.move_to(LEFT)
        assert OCTOMAP not in live.scene().objects and len(watch.updates) > 10

        came = []

        class Comes:
            """Half a second into the motion the post is put into its way."""

            def on_state(self, sample):
                if came and came[0] is not None and sample.time > came[0] + 0.3:
                    live.driver.world.set_object_pose("post", SE3.from_xyz(0.5, -0.15, 0.35))
                    came[0] = None

            def on_event(self, event):
                pass

            def on_trajectory(self, time, trajectory):
                came.append(time)

        live.ctx.observers.append(Comes())
        outcome = live.arm.move_to(RIGHT)
        assert outcome.code is ErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
        assert outcome.evidence["object"] == OCTOMAP
        assert "sees something across the path" in watch.stopped and "<octomap>" in watch.stopped
        assert any(e.kind == "stop" for e in live.ctx.events)
        touched = [c for c in live.driver.unwanted_contacts() if "post" in (c.body_a, c.body_b)]
        assert not [c for c in touched if "table" not in (c.body_a, c.body_b)]
        for _ in range(4):  # what comes into view from the side may stop it once more
            live.ctx.advance(0.4)
            if arrived := live.arm.move_to(RIGHT):
                break
        assert arrived, "a way around what the camera sees"
        assert not [c for c in live.driver.unwanted_contacts() if "panda" in c.body_a + c.body_b]


@pytest.mark.slow
def test_a_picture_that_is_looked_at_twice_puts_no_robot_into_the_map(cell, tmp_path):
    """A camera slower than the watch: the robot has moved on since its newest picture was taken."""
    (tmp_path / "cell.yaml").write_text(CELL.replace("noise: stereo", "rate: 4"))
    with load(tmp_path).connect() as live:
        without_post(live)
        live.driver.world.set_object_pose("post", SE3.from_xyz(3, 3, 0.35))
        watch = live.watch(settings=MapSettings(), rate=20)
        assert live.arm.move_to(LEFT) and live.arm.move_to(RIGHT), watch.stopped
        assert sum(u.hits for u in watch.updates) == 0 and OCTOMAP not in live.scene().objects


@pytest.mark.slow
def test_a_look_that_failed_is_told_where_nothing_is_looked_for(tmp_path):
    (tmp_path / "cell.yaml").write_text(CELL.replace(", movable: true", ""))
    with load(tmp_path).connect() as live:
        live.camera().image()
        live.camera().frozen = True
        live.ctx.advance(1.0)
        assert live.look().code is ErrorCode.SENSOR_INFO_STALE
        report = live.ctx.reports[-1]
        assert not report.ok and "frozen" in report.error


@pytest.mark.slow
def test_a_frozen_camera_is_told_once(cell):
    with cell.connect() as live:
        without_post(live)
        watch = live.watch()
        watch.update()
        live.camera().frozen = True
        live.ctx.advance(1.5)
        errors = [e for e in live.ctx.events if e.kind == "error"]
        assert watch.updates[-1].code is ErrorCode.SENSOR_INFO_STALE and 1 <= len(errors) < 15
        with pytest.raises(InputError, match="rate is 0"):
            live.watch(rate=0)
