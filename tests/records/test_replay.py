"""Records read back, cut off anywhere, run again, and compared: against what was told to the recorder."""

import json
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.helpers import call, cell_file, read_json, start
from tests.records.synthetic import panda_scene, play

from armcell.core import SE3, Box, Contact, Event, InputError, JointState, StateSample
from armcell.kinematics import kinematic_tree
from armcell.records import RunRecorder, compare, read_record
from armcell.records.reader import scenes_of
from armcell.scene import CollisionObject, scene_changes

BOX = """robot: panda
start: {arm: home}
objects:
  box: {box: [0.1, 0.1, 0.1], pose: [0.4, 0.4, 0.05]}
task: [{move: extended}]
"""
BEHIND_A_WALL = """robot: panda
start: {arm: home, hand: open}
objects:
  table: {box: [1, 1, 0.1], pose: [0.5, 0, -0.051]}
  wall: {box: [0.02, 0.2, 0.2], pose: [0.45, 0, 0.1]}
  cube: {box: [0.05, 0.05, 0.05], pose: [0.5, 0, 0.024], movable: true}
task: [{pick: cube}]
"""


class Told:
    """Keeps what the recorder is told, and may change it on the way."""

    def __init__(self, recorder, changed=lambda kind, value: value):
        self._recorder, self._changed = recorder, changed
        self.samples, self.events, self.plans = [], [], []

    def on_state(self, sample):
        touch = (Contact("cube", "floor", -1e-4, (0.1, 0.2, 0.0)),) if sample.time > 3 else ()
        sample = replace(
            sample, targets=sample.joints.reindexed(sample.joints.joint_names[:3]), contacts=touch
        )
        sample = self._changed("state", sample)
        self.samples.append(sample)
        self._recorder.on_state(sample)

    def on_event(self, event):
        event = self._changed("event", event)
        self.events.append(event)
        self._recorder.on_event(event)

    def on_trajectory(self, time, trajectory):
        trajectory = self._changed("plan", trajectory)
        self.plans.append((time, trajectory))
        self._recorder.on_trajectory(time, trajectory)


@pytest.fixture(scope="module")
def scene():
    return panda_scene()


def recorded(scene, folder, changed=lambda kind, value: value) -> Told:
    about = {"format": 1, "cell": "made up", "seed": 0, "mode": "fake", "hashes": {}, "versions": {}}
    with RunRecorder(folder, scene, metadata=about) as recorder:
        told = Told(recorder, changed)
        play(scene, told, rate=100.0)
        recorder.finish({"success": True, "message": "done"})
    return told


@pytest.fixture(scope="module")
def run(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return folder, recorded(scene, folder)


@pytest.mark.slow
def test_every_number_comes_back(run):
    folder, told = run
    record = read_record(folder)
    assert record.cut == "" and record.result == {"success": True, "message": "done"}
    assert record.metadata["cell"] == "made up" and len(record.states) == len(told.samples) > 1000
    for state, sample in zip(record.states, told.samples, strict=True):
        assert state.nanoseconds == round(sample.time * 1e9)
        assert state.joints.positions.tobytes() == sample.joints.positions.tobytes()
        assert state.joints.velocities.tobytes() == sample.joints.velocities.tobytes()
        assert state.joints.efforts.tobytes() == sample.joints.efforts.tobytes()
        assert state.targets.names == sample.targets.joint_names
        again = state.sample()
        assert again.object_poses["cube"].isclose(sample.object_poses["cube"], 0.0, 1e-7)
        assert again.gripper_width == sample.gripper_width and again.gripper_force == sample.gripper_force
        assert again.contacts == sample.contacts
    assert [(e.time, e.kind, e.text, e.data) for e in record.events] == [
        (e.time, e.kind, e.text, e.data) for e in told.events
    ]
    for (at, plan), (told_at, told_plan) in zip(record.trajectories, told.plans, strict=True):
        assert at == pytest.approx(told_at, abs=1e-9) and plan.joint_names == told_plan.joint_names
        assert plan.positions.tobytes() == told_plan.positions.tobytes()
        np.testing.assert_allclose(plan.times, told_plan.times, atol=1e-9)
    assert compare(record, read_record(folder)).identical


@pytest.mark.slow
def test_cut_off_anywhere_the_whole_part_is_there(run, tmp_path):
    folder, told = run
    data = (folder / "run.mcap").read_bytes()
    rng = np.random.default_rng(1)
    found = []
    for length in sorted(rng.integers(0, len(data), 25).tolist()):
        file = tmp_path / "cut.mcap"
        file.write_bytes(data[:length])
        try:
            record = read_record(file)
        except InputError as error:
            assert "cut.mcap" in str(error)
            found.append(0)
            continue
        assert record.cut
        for state, sample in zip(record.states, told.samples):
            assert state.joints.positions.tobytes() == sample.joints.positions.tobytes()
        found.append(len(record.states))
    assert found == sorted(found) and found[-1] > 0.8 * len(told.samples)
    assert sum(n > 0 for n in found) > 15  # little is lost: a chunk is half a second or so


@pytest.mark.long
def test_damage_is_said_and_never_a_traceback(run, tmp_path):
    folder, _ = run
    data = (folder / "run.mcap").read_bytes()
    rng = np.random.default_rng(2)
    for at in rng.integers(0, len(data), 25).tolist():
        broken = bytearray(data)
        broken[at : at + 40] = rng.bytes(len(broken[at : at + 40]))
        file = tmp_path / "broken.mcap"
        file.write_bytes(broken)
        try:
            read_record(file)
        except InputError as error:
            assert "broken.mcap" in str(error)


def test_what_is_no_record(scene, tmp_path):
    with pytest.raises(InputError, match="no such run"):
        read_record(tmp_path / "nothing")
    with pytest.raises(InputError, match=r"has no run\.mcap"):
        read_record(tmp_path)
    (tmp_path / "text.mcap").write_text("hello, this is no record at all")
    with pytest.raises(InputError, match="is no MCAP file"):
        read_record(tmp_path / "text.mcap")
    with RunRecorder(tmp_path / "new", scene, metadata={"format": 99}) as recorder:
        play(scene, recorder, rate=5.0)
    with pytest.raises(InputError, match="format 99, this armcell reads 1"):
        read_record(tmp_path / "new")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_ends_the_record_and_not_the_run(scene, tmp_path, caplog):
    recorder = RunRecorder(tmp_path, scene)
    for k in range(900):
        if k == 600:
            os.dup2(os.open("/dev/full", os.O_WRONLY), recorder._mcap._stream.fileno())
        q = scene.positions + 1e-3 * np.random.default_rng(k).random(len(scene.positions))
        recorder.on_state(StateSample(0.01 * k, JointState(scene.model.joint_names, q)))
    recorder.finish({"success": True})
    assert caplog.text.count("ends here: No space left on device") == 1
    assert len(recorder.series().times) == 900  # the report still has all
    record = read_record(tmp_path)
    assert record.cut and 200 < len(record.states) <= 600


@pytest.mark.slow
def test_the_first_difference_is_found_where_it_was_made(run, scene, tmp_path):
    folder, told = run
    at = {"state": 700, "event": 9, "plan": 3}
    seen = dict.fromkeys(at, -1)

    def changed(kind, value):
        seen[kind] += 1
        if seen[kind] != at[kind] and not (kind == "state" and seen[kind] > at[kind]):
            return value
        if kind == "state":  # in the last bit, and growing
            q = value.joints.positions.copy()
            q[2] = (
                np.nextafter(q[2], 9) if seen[kind] == at[kind] else q[2] + 1.1e-5 * (seen[kind] - at[kind])
            )
            return replace(value, joints=replace(value.joints, positions=q))
        if kind == "event":
            return replace(value, text=value.text + " again")
        return replace(value, positions=value.positions + 1e-12)

    recorded(scene, tmp_path, changed)
    first, second = read_record(folder), read_record(tmp_path)
    found = compare(first, second)
    assert found.same_states == 700 and found.state.time == pytest.approx(told.samples[700].time, abs=1e-9)
    assert found.state.what == f"position of {scene.model.joint_names[2]}"
    assert found.state.second == np.nextafter(found.state.first, 9)
    assert found.event.what == "event 10" and found.plan.what == "plan 4"
    assert [d.what for d in found.distances] == [scene.model.joint_names[2]]
    last = len(told.samples) - 1
    assert found.distances[0].largest == pytest.approx(1.1e-5 * (last - 700), rel=1e-6)
    assert dict(found.distances[0].reached)[1e-4] == pytest.approx(told.samples[710].time, abs=1e-9)
    assert not found.same_course and any("first different" in line for line in found.words())
    # A run that goes on for longer.
    with RunRecorder(tmp_path / "short", scene) as recorder:
        for sample in told.samples[:50]:
            recorder.on_state(sample)
    assert compare(first, read_record(tmp_path / "short")).state.what == "the last state's time"


def test_scenes_come_back_as_they_were_changed(scene, tmp_path):
    box = CollisionObject.single("box", Box(0.1, 0.2, 0.3), SE3.from_xyz(1, 2, 3), color=(1, 0, 0, 1))
    second = scene.with_object(box).with_allowed("box", "floor")
    third = second.without_object("wall").with_object_pose("box", SE3.from_xyz(3, 2, 1))
    with RunRecorder(tmp_path, scene) as recorder:
        for k, (old, new) in enumerate(((scene, second), (second, third))):
            recorder.on_state(StateSample(float(k), scene.state))
            recorder.on_event(Event(k + 0.5, "scene", "changed", scene_changes(old, new)))
    scenes = scenes_of(read_record(tmp_path), scene)
    assert [at for at, _ in scenes] == [0.0, 0.5, 1.5]
    assert scenes[1][1].object("box").shapes[0][0] == Box(0.1, 0.2, 0.3)
    assert "wall" not in scenes[2][1].objects
    assert scenes[2][1].object("box").T_world_object.isclose(SE3.from_xyz(3, 2, 1))
    assert scene_changes(scene, second)["allowed"] == [["box", "floor", True]]
    assert scene_changes(third, third) == {}


@pytest.mark.long
def test_a_run_executed_again_is_the_same_to_the_bit(tmp_path, capsys):
    file, runs = cell_file(tmp_path, BOX), tmp_path / "runs"
    assert call(capsys, "run", file, "--seed", 5, "--runs", runs).status == 0
    (first,) = runs.iterdir()
    said = call(capsys, "replay", first, "--execute", "--runs", runs, "--json", tmp_path / "r.json")
    found = read_json(tmp_path / "r.json")
    assert said.status == 0 and found["identical"] and found["states"] == found["same_states"] > 100
    # Softer servos: the runs part, and it is said where.
    assert call(capsys, "run", file, "--seed", 6, "--set", "physics.arm_kp=3000", "--runs", runs).status == 0
    other = max(runs.iterdir(), key=lambda f: f.stat().st_mtime)
    said = call(capsys, "diff", first, other, "--json", tmp_path / "d.json")
    assert said.status == 1 and "asked: seed 5 / 6" in said.out and "asked: another physics" in said.out
    assert read_json(tmp_path / "d.json")["same_states"] < found["states"]
    # What has changed since is named; the recorded cell itself is what runs, not the changed file.
    record = json.loads(json.dumps(dict(read_record(first).metadata)))
    record["hashes"]["versions.mujoco"], record["versions"]["mujoco"] = "x", "3.1.4"
    scene = panda_scene()
    with RunRecorder(tmp_path / "older", scene, metadata=record) as recorder:
        recorder.on_state(StateSample(0.0, scene.state))
    said = call(capsys, "replay", tmp_path / "older", "--execute", "--runs", runs)
    assert said.status == 1 and "mujoco 3.1.4 ->" in said.err and "--anyway" in said.err
    said = call(capsys, "replay", tmp_path / "older", "--execute", "--anyway", "--runs", runs)
    assert said.status == 1 and "first different" in said.out


@pytest.mark.slow
def test_a_failed_run_executed_again_is_the_same(tmp_path, capsys):
    file = cell_file(tmp_path, BOX.replace("[0.4, 0.4, 0.05]", "[0.25, 0, 1.09]"))  # where the hand shall be
    asked = ("--mode", "fake", "--seed", 8, "--runs", tmp_path / "runs")
    assert "GOAL_IN_COLLISION" in call(capsys, "run", file, *asked).out
    (first,) = (tmp_path / "runs").iterdir()
    (error,) = (e for e in read_record(first).events if e.kind == "error")
    assert error.data["stages"][0]["seconds"] > 0  # wall clock is in it
    touching = error.data["contacts"][0]
    assert {touching["body_a"], touching["body_b"]} & {"box"} and touching["distance"] < 0
    assert len(touching["position"]) == 3
    said = call(capsys, "replay", first, "--execute", "--runs", tmp_path / "runs")
    assert said.status == 0 and "events: the same" in said.out and "outcome: the same" in said.out


@pytest.mark.slow
def test_a_plan_says_what_was_asked_what_the_planner_tells_and_what_was_rejected(tmp_path, capsys):
    file = cell_file(tmp_path, BEHIND_A_WALL)
    asked = ("--mode", "fake", "--seed", 1, "--runs", tmp_path / "runs")
    assert call(capsys, "run", file, *asked).status == 0
    (first,) = (tmp_path / "runs").iterdir()
    record = read_record(first)
    rejected, *plans = (e for e in record.events if e.kind == "plan")
    for stage, candidate, reason in rejected.data["evidence"]["rejections"]:
        assert stage and candidate and reason
    assert len(rejected.data["evidence"]["rejections"]) >= 4
    assert any(row["failed"] for row in rejected.data["evidence"]["stages"])
    by_name = {e.text: e.data for e in plans}
    free = by_name["move to pre-grasp"]["evidence"]
    names = record.states[0].joints.names
    assert set(free["goal"]) < set(names) and len(free["goal"]) == 7
    assert (free["planner_id"], free["seed"], free["attempts"]) == ("RRTConnect", 1, 1)
    if by_name["move to pre-grasp"]["planner"] == "RRTConnect":
        assert free["iterations"] > 0
    motion = next(t for at, t in record.trajectories if t.joint_names == tuple(free["goal"]))
    assert list(motion.positions[-1]) == pytest.approx(list(free["goal"].values()))
    assert by_name["lift"]["evidence"]["goal"]["link"] == "panda_hand_tcp"
    assert by_name["approach"]["evidence"]["planned"] == "backwards"
    # However long a planner looked, a motion that is the same is the same.
    said = call(capsys, "replay", first, "--execute", "--runs", tmp_path / "runs")
    assert said.status == 0 and "events: the same" in said.out


def test_how_a_plan_was_found_is_not_compared_but_of_a_failure_it_is(scene, tmp_path):
    def run(name, kind, iterations):
        with RunRecorder(tmp_path / name, scene) as recorder:
            recorder.on_state(StateSample(0.0, scene.state))
            recorder.on_event(Event(0.5, kind, "over there", {"evidence": {"iterations": iterations}}))
        return read_record(tmp_path / name)

    assert compare(run("a", "plan", 5), run("b", "plan", 6)).event is None
    assert compare(run("c", "error", 5), run("d", "error", 6)).event.what.startswith("evidence.iterations")


def test_data_of_events_differ_by_name_and_not_by_the_wall_clock(scene, tmp_path):
    def run(name, **data):
        with RunRecorder(tmp_path / name, scene) as recorder:
            recorder.on_state(StateSample(0.0, scene.state))
            recorder.on_event(Event(0.5, "error", "no way", data))
        return read_record(tmp_path / name)

    rows = [{"stage": "pick", "seconds": 0.1, "passed": 2, "gap": float("nan")}]
    first = run("a", stages=rows, plan_us=3.0, simplify_us=2.0, certify_us=1.0, cost_over_time=[[0.1, 2.0]])
    again = run("b", stages=[{**rows[0], "seconds": 0.2}], plan_us=4.0, cost_over_time=[])
    assert compare(first, again).event is None
    found = compare(first, run("c", stages=[{**rows[0], "passed": 3}])).event
    assert found.what == "stages[0].passed of event 1 (error: no way)"
    assert (found.time, found.first, found.second) == (0.5, 2, 3)
    found = compare(first, run("d", stages=rows, pairs=[1])).event
    assert (found.what.split()[0], found.first, found.second) == ("pairs", "not there", [1])
    found = compare(first, run("e", stages=rows * 2)).event
    assert found.what.startswith("number of stages of") and (found.first, found.second) == (1, 2)


@pytest.mark.long
def test_a_killed_run_leaves_what_was_whole(tmp_path, capsys):
    file = cell_file(tmp_path, BOX.replace("[{move: extended}]", "[{hold: 500.0}]"))
    process = start("run", file, "--runs", tmp_path / "runs", "--time-scale", "5")
    end = time.monotonic() + 120
    while time.monotonic() < end:
        parts = list((tmp_path / "runs").glob("*/run.mcap.part"))
        if parts and parts[0].stat().st_size > 200_000:
            break
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    record = read_record(parts[0].parent)
    assert record.cut and len(record.states) > 200 and record.metadata["mode"] == "sim"
    assert record.result is None


@pytest.mark.slow
def test_the_view_shows_the_recorded_instant(run, scene):
    from armcell.viewer.replay import ReplayView

    folder, told = run
    record = read_record(folder)
    with ReplayView(record, scene, port=0) as view:
        for k in (1200, 300):
            view.seek(told.samples[k].time)
            tree = kinematic_tree(scene.model)
            T = tree.link_pose(told.samples[k].joints.positions, "panda_hand")
            end = time.monotonic() + 5
            while time.monotonic() < end:
                frame = view.viewer.link_frames["panda_hand"]
                if SE3.from_quat_wxyz(frame.position, frame.wxyz).isclose(T, 1e-6, 1e-6):
                    break
                time.sleep(0.01)
            else:
                raise AssertionError("the link is not where it was")
            assert view.time.value == pytest.approx(told.samples[k].time, abs=0.005)
        view.speed.value = "5"
        view.toggle()
        assert view.play_button.label == "Pause"
        end = time.monotonic() + 5
        while view.time.value < told.samples[300].time + 1.0 and time.monotonic() < end:
            time.sleep(0.01)
        view.toggle()
        assert view.play_button.label == "Play" and view.time.value > told.samples[300].time + 0.9
        assert len(view.stage.options) == 12
