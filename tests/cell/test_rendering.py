"""Cameras of a cell that keeps to the wall's clock: drawn elsewhere, the same pictures, never waited for."""

from __future__ import annotations

import logging
import os
import signal
import time

import numpy as np
import pytest

from armcell.cell import live_cameras, load, pictures
from armcell.cli.run_record import camera_frames
from armcell.core import SE3, ArmcellError, Event
from armcell.perception import MapSettings
from armcell.ros import Bus
from armcell.ros.nodes import CameraPublisher
from armcell.scene import OCTOMAP
from armcell.sim import render, render_process, take_image
from armcell.sim.render_process import MeasuredState, PhysicsState, RenderProcess, RenderRequest, RenderSetup

CELL = """
robot: panda
start: {arm: home, hand: open}
objects:
  table: {box: [1.2, 1.8, 0.04], pose: [0.4, 0, -0.021]}
  post: {box: [0.08, 0.08, 0.3], pose: [0.55, 0.3, 0.15]}
  cube: {box: [0.05, 0.05, 0.05], pose: [0.5, 0.0, 0.025], movable: true, color: [0.9, 0.1, 0.1]}
cameras:
  top: {eye: [1.2, -0.5, 0.9], target: [0.5, 0, 0], width: 96, height: 72, noise: stereo, rate: 20}
  hand: {on: panda_hand, pose: {xyz: [0.06, 0, 0.02], rpy_deg: [0, 0, 90]}, width: 64, height: 48}
"""
FAST = 5.0  # times the wall's clock: paced, and a test does not take long
SLOWEST = 0.5  # [s] a step may take while renderers stand still for seconds: the machine may be busy


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rendering")
    (folder / "cell.yaml").write_text(CELL)
    return load(folder)


@pytest.fixture
def process():
    found = RenderProcess()
    yield found
    found.close()


@pytest.fixture
def nothing_is_drawn_here(monkeypatch):
    """A picture drawn in this process is an error."""

    def never(*arguments, **more):
        raise AssertionError("drawn in the process that steps the cell")

    monkeypatch.setattr(render, "_drawn", never)


def same(a, b) -> None:
    assert a.camera == b.camera and a.pinhole == b.pinhole
    assert a.T_world_camera.isclose(b.T_world_camera, 0.0, 0.0)
    np.testing.assert_array_equal(a.rgb, b.rgb)
    np.testing.assert_array_equal(a.depth, b.depth)


def passed(live, seconds: float, each=lambda: None) -> float:
    """Let time pass; the longest that a step took [s, wall]."""
    longest, end = 0.0, live.driver.now + seconds
    while live.driver.now < end:
        began = time.monotonic()
        live.ctx.advance(live.driver.period)
        each()
        longest = max(longest, time.monotonic() - began)
    return longest


def until(live, condition, seconds: float = 300.0, each=lambda: None) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        passed(live, live.driver.period, each)


def renderer_of(live):
    return live.camera("top").renderer


@pytest.mark.long
def test_pictures_of_physics_are_those_of_take_image_bit_for_bit(cell, process):
    with cell.connect(seed=3) as live:
        world = live.driver.world
        setup = RenderSetup.of(world)
        for move in range(3):
            live.driver.command(live.model.group("arm").joint_names, np.full(7, -0.3 * move), np.zeros(7))
            live.driver.advance(0.2)
            if move == 2:
                world.set_object_pose("post", SE3.from_xyz(0.5, -0.3, 0.15))
                world.set_object_pose("cube", SE3.from_xyz(0.45, 0.1, 0.2))
            for camera in world.cameras.values():
                process.begin(RenderRequest(setup, PhysicsState.of(world), camera))
                image = process.finish()
                expected = take_image(world, camera)
                same(image, expected)
                assert image.time == expected.time == world.time
        only = RenderRequest(setup, PhysicsState.of(world), world.cameras["top"], rgb=False)
        process.begin(only)
        image = process.finish()
        assert image.rgb is None and image.depth is not None


@pytest.mark.long
def test_pictures_of_a_robot_without_physics_too(cell, process):
    with cell.connect("fake") as live:
        setup = RenderSetup(live.scene_at_start)
        for target in ("home", "extended"):
            assert live.arm.move_to(target)
            q, poses = live.driver.joint_state().positions, live.driver.object_poses()
            for camera in live.cameras.values():
                process.begin(RenderRequest(setup, MeasuredState(q, poses), camera.camera))
                same(process.finish(), camera.draw())


@pytest.mark.slow
def test_a_picture_shows_the_moment_of_its_stamp(cell, nothing_is_drawn_here):
    """Color, depth and info of one message time are of one state, however late they are drawn."""
    with cell.connect(time_scale=FAST) as live:
        got, states = [], {}
        camera = live.camera("hand")

        def ask():
            states[live.driver.now] = live.driver.world.link_pose("panda_hand")
            camera.ask("test", got.append)

        names = live.model.group("arm").joint_names
        until(live, lambda: len(got) > 5, each=ask)
        live.driver.command(names, np.array([0.4, 0.2, 0, -1.7, 0, 1.9, 0.8]), np.zeros(7))
        seen = len(got)
        until(live, lambda: len(got) > seen + 10, each=ask)
        for image in got:
            T = states[image.time] @ camera.camera.T_link_camera
            assert image.T_world_camera.isclose(T, 1e-12, 1e-12)
            assert image.rgb is not None and image.depth is not None
        assert not got[0].T_world_camera.isclose(got[-1].T_world_camera, 0.05, 0.1)


@pytest.mark.long
def test_no_step_draws_or_waits_for_streams_watches_frames_or_key_moments(cell, nothing_is_drawn_here):
    with cell.connect(time_scale=FAST) as live:
        bus, taken = Bus(), []

        class Recorder:
            def add_frame(self, at, camera, rgb):
                taken.append(("frame", at, rgb.shape))

            def add_picture(self, at, title, rgb):
                taken.append(("picture", at, rgb.shape))

        recorder = Recorder()
        cameras = CameraPublisher(bus, live.cameras)
        subs = [
            bus.subscribe("/top/color/image_raw", "sensor_msgs/Image", queue_size=500),
            bus.subscribe("/hand/depth/points", "sensor_msgs/PointCloud2", queue_size=500),
        ]
        live.ctx.observers += camera_frames(["top=10"], live, "sim", recorder)
        key = pictures.Pictures(live, recorder.add_picture)
        live.ctx.observers.append(key)
        watch = live.watch("top", MapSettings(max_age=60.0), rate=10)

        def publish():
            bus.clock.set(live.driver.now)
            cameras.publish()

        longest = passed(live, 0.2, publish)
        live.ctx.emit("stage", "pick", phase="end")
        kinds = lambda: {kind for kind, *_ in taken}  # noqa: E731
        until(live, lambda: kinds() == {"frame", "picture"} and watch.updates, each=publish)
        until(live, lambda: all(s.get(0) is not None for s in subs), each=publish)
        renderer = renderer_of(live)
        os.kill(renderer.pid, signal.SIGSTOP)  # a renderer that takes for ever
        try:
            longest = max(longest, passed(live, 10.0, publish))
        finally:
            os.kill(renderer.pid, signal.SIGCONT)
        assert longest < SLOWEST
        delivered = cameras.frames()["top"]
        assert delivered > 0
        until(live, lambda: cameras.frames()["top"] > delivered + 3, each=publish)
        cameras.close()


@pytest.mark.slow
def test_a_look_lets_time_pass_while_it_is_drawn(tmp_path, nothing_is_drawn_here):
    text = CELL + "perception: {camera: top, objects: [cube], surface: table}\n"
    (tmp_path / "cell.yaml").write_text(text.replace("width: 96, height: 72", "width: 320, height: 240"))
    # A picture may be 0.5 s of the cell's time old: 5 s here, for it is drawn with low priority.
    with load(tmp_path).connect(time_scale=0.1) as live:
        before = live.driver.now
        sight = live.look("top")
        assert live.driver.now > before  # the first picture of a process takes a second at least
        assert not sight.missing, sight.message
        truth = live.driver.world.object_pose("cube")
        assert live.scene().object("cube").T_world_object.isclose(truth, 0.01, 4.0)
        live.stop()  # who is cancelled lets no time pass, and gets a picture all the same
        assert live.camera("top").take(live.ctx.advance).rgb is not None


@pytest.mark.long
def test_the_octomap_of_a_paced_cell_follows(tmp_path, nothing_is_drawn_here):
    (tmp_path / "cell.yaml").write_text(CELL.replace("width: 96, height: 72", "width: 160, height: 120"))
    with load(tmp_path).connect(time_scale=1.0) as live:
        live.change_scene(lambda scene: scene.without_object("post"))
        watch = live.watch("top", MapSettings(max_age=5.0), rate=10)
        until(live, lambda: sum(u.ok for u in watch.updates) > 3)
        assert OCTOMAP in live.scene().objects  # the post
        low, high = live.scene().object(OCTOMAP).bounds()
        assert low[0] > 0.4 and high[1] < 0.5
        os.kill(renderer_of(live).pid, signal.SIGSTOP)
        try:
            until(live, lambda: any("not true any more" in e.text for e in live.ctx.events), 20.0)
        finally:
            os.kill(renderer_of(live).pid, signal.SIGCONT)


@pytest.mark.long
def test_a_renderer_that_dies_is_started_again_and_motions_go_on(cell, caplog):
    with cell.connect(time_scale=FAST) as live:
        got, camera = [], live.camera("top")
        ask = lambda: camera.ask("test", got.append)  # noqa: E731
        until(live, lambda: got, each=ask)
        first = renderer_of(live).pid
        os.kill(first, signal.SIGSEGV)
        seen = len(got)
        with caplog.at_level(logging.WARNING):
            until(live, lambda: len(got) > seen + 1, each=ask)
        assert renderer_of(live).pid != first and not renderer_of(live).broken
        assert "ended by SIGSEGV; motions go on, rendering is tried again" in caplog.text
        assert live.arm.move_to("extended")
        last = renderer_of(live).pid
    with pytest.raises(ProcessLookupError):
        os.kill(last, 0)


@pytest.mark.slow
def test_a_renderer_that_cannot_work_is_given_up_with_a_warning(cell, caplog, monkeypatch):
    monkeypatch.setattr(render_process, "WORKER", "armcell.no_such_worker")
    with cell.connect(time_scale=FAST) as live:
        got, camera = [], live.camera("top")
        with caplog.at_level(logging.WARNING):
            until(live, lambda: renderer_of(live).broken, each=lambda: camera.ask("test", got.append))
        assert "no more pictures of this cell; motions go on" in caplog.text and not got
        with pytest.raises(ArmcellError, match="camera 'top' gives no picture: .* ended with status 1"):
            live.look("top")
        assert live.arm.move_to("extended")


@pytest.mark.long
def test_key_moments_that_wait_are_drawn_when_the_cell_is_closed(cell):
    taken = []
    with cell.connect(time_scale=FAST) as live:
        key = pictures.Pictures(live, lambda *picture: taken.append(picture))
        live.camera("top").ask("a stream", lambda image: taken.append("stream"))
        until(live, lambda: renderer_of(live).ready)
        for number in range(3):
            key.on_event(Event(0.1 * number, "stage", f"stage {number}", {"phase": "end"}))
        live.camera("top").ask("a stream", lambda image: taken.append("stream"))
    assert [p[1] for p in taken if p != "stream"] == ["stage 0", "stage 1", "stage 2"]
    assert all(p == "stream" or p[2].shape == (72, 96, 3) for p in taken)


def test_the_newest_state_is_drawn_and_cameras_take_turns(cell, monkeypatch):
    """With a renderer that is stepped by hand."""
    drawn = []

    class Process:
        pid = 0

        def begin(self, order):
            drawn.append(order)

        def finish(self):
            while len(drawn) > len(done) and not go:
                time.sleep(0.001)
            go.pop()
            done.append(drawn[-1])
            raise ArmcellError("not drawn")

        def close(self):
            pass

        kill = close

    go, done = [], []
    monkeypatch.setattr(live_cameras, "RenderProcess", Process)
    monkeypatch.setattr(live_cameras, "GIVES_UP_AFTER", 99)
    with cell.connect(time_scale=100.0) as live:
        top, hand = live.camera("top"), live.camera("hand")

        def wait(count):
            while len(drawn) < count:
                time.sleep(0.001)

        top.ask("a", lambda image: None)
        wait(1)
        for _ in range(50):  # one is being drawn: of these the last one is next
            live.driver.advance(live.driver.period)
            top.ask("a", lambda image: None)
            hand.ask("a", lambda image: None)
        go.append(1)
        wait(2)
        go.append(1)
        wait(3)
        assert [o.camera.name for o in drawn] == ["top", "top", "hand"]
        assert drawn[1].state.time == drawn[2].state.time == live.driver.now
        go += [1] * 10


@pytest.mark.slow
def test_in_lock_step_pictures_are_drawn_at_once(cell):
    with cell.connect() as live:
        got = []
        live.camera("top").ask("test", got.append)
        assert len(got) == 1 and got[0].time == live.driver.now
        assert renderer_of(live).pid is None
        assert live.camera("top").take(live.ctx.advance) is got[0]
        assert isinstance(live.camera("top"), live_cameras.LiveCamera)
