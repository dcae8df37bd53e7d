"""Mode `real` end to end: the cell file's arms are emulated in physics, in a process of their own."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts, free_port

from armcell.cell import cell_names, load
from armcell.cell.built_in import LIBRARY
from armcell.cli.main import main
from armcell.core import ErrorCode
from armcell.drivers import Capability
from armcell.records import RunRecorder
from armcell.ros import Bus, schema
from armcell.ros.nodes import ServedCell

pytestmark = pytest.mark.slow


@pytest.fixture
def cell(tmp_path):
    """six_axis_pick with a real arm, and the arm's address."""
    assert "six_axis_pick" in cell_names()
    (host,) = free_hosts(1)
    text = (LIBRARY / "six_axis_pick" / "cell.yaml").read_text()
    # The ages are for a machine that other programs fill; the defaults are 0.05 and 0.1 s.
    text += "\nreal:\n  max_state_age: 0.3\n  watchdog: 0.5\n  arms:\n"
    text += f"    arm: {{host: {host}, port: {free_port()}, model: UR10, gripper: {{kind: socket}}}}\n"
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    return file, host


TRIES = 3  # where the computer stands still for half a second, as busy virtual ones do, the arm rightly stops


def run_real(file, host, out, *seed):
    """`armcell run --mode real` beside an emulated arm: the result, and the robot's messages."""
    real = [*seed, "--mode", "real", "--without-gate", "an emulator"]
    for left in reversed(range(TRIES)):
        with emulator("--cell", "six_axis_pick", *seed, hosts=[host]):
            status = main(["run", str(file), *real, "--headless", "--json", str(out)])
            messages = dashboard(host, "armcell messages")[0]
        result = json.loads(out.read_text())
        if "this computer was held up" not in result["message"] or not left:
            break
    assert status == 0, result["message"]
    return result, messages


def test_the_same_task_on_a_robot_over_the_wire(cell, tmp_path):
    result, messages = run_real(*cell, tmp_path / "result.json", "--seed", "0")
    assert result["success"] and result["mode"] == "real"
    assert [s["name"] for s in result["stages"]].count("open") == 2
    assert "protective stop" not in messages  # physics saw no unwanted touch


@pytest.mark.realtime
def test_no_draw_moves_the_things_of_a_real_cell(cell, tmp_path):
    """The commands of docs/real_ur.md, which give no seed: things are where the cell file says."""
    result, _ = run_real(*cell, tmp_path / "result.json")
    assert result["success"] and result["seed"] is None and result["randomized"] == {}
    assert "--seed" not in result["command"]


@pytest.mark.realtime
def test_a_served_arm_tells_where_it_is_while_it_moves_and_stops_when_told(cell):
    file, host = cell
    bus, new, at = Bus(), schema().new, schema().message("builtin_interfaces/Duration").from_sec
    states = bus.subscribe("/joint_states", "sensor_msgs/JointState", queue_size=1000)
    with (
        emulator("--cell", "six_axis_pick", hosts=[host]),
        ServedCell(load(file).connect("real"), bus, plan=False) as served,
    ):
        arm = served.live.model.group("arm").joint_names

        def moved(seconds: float, cancel_after: float | None = None) -> tuple[Any, list[float]]:
            """How a motion of 0.4 rad ended, and what was heard of its joint meanwhile."""
            here = served.call(served.live.driver.joint_state).reindexed(arm).positions
            points = [
                new("trajectory_msgs/JointTrajectoryPoint", q, np.zeros(6), time_from_start=at(t))
                for t, q in ((0.0, here), (seconds, here + 0.4 * np.eye(6)[0]))
            ]
            while states.get(0) is not None:
                pass
            work = served.node.queue_trajectory(
                new("trajectory_msgs/JointTrajectory", joint_names=arm, points=points)
            )
            if cancel_after is not None:
                time.sleep(cancel_after)
                work.cancel.set()
            assert work.wait(20)
            heard = []
            while (state := states.get(0)) is not None:
                heard.append(state.position[list(state.name).index(arm[0])] - here[0])
            return work.outcome(), heard

        outcome, heard = moved(2.0)
        assert outcome.ok, outcome
        between = [angle for angle in heard if 0.02 < angle < 0.38]
        assert len(between) > 20  # 30 a second
        outcome, heard = moved(4.0, cancel_after=1.0)
        assert outcome.code is ErrorCode.PREEMPTED and 0.005 < heard[-1] < 0.3, outcome
        served.node.queue_trajectory(new("trajectory_msgs/JointTrajectory"))  # stop all, fingers too
        assert moved(1.0)[0].ok
        assert served.failure is None


@pytest.mark.realtime
def test_a_served_arm_rests_before_the_cell_is_closed(cell, tmp_path):
    file, host = cell
    loaded, new, at = load(file), schema().new, schema().message("builtin_interfaces/Duration").from_sec
    with emulator("--cell", "six_axis_pick", hosts=[host]):
        with RunRecorder(tmp_path / "record", loaded.scene(None)) as recorder:
            served = ServedCell(loaded.connect("real", None, [recorder]), Bus(), plan=False)
            served.start()
            arm = served.live.model.group("arm").joint_names
            here = served.call(served.live.driver.joint_state).reindexed(arm).positions
            points = [
                new("trajectory_msgs/JointTrajectoryPoint", q, np.zeros(6), time_from_start=at(t))
                for t, q in ((0.0, here), (4.0, here + 1.2 * np.eye(6)[0]))
            ]
            work = served.node.queue_trajectory(
                new("trajectory_msgs/JointTrajectory", joint_names=arm, points=points)
            )
            time.sleep(2.0)
            served.close()
        assert work.outcome().code is ErrorCode.PREEMPTED and served.failure is None
        series = recorder.series()
        column = series.joint_names.index(arm[0])
        assert np.nanmax(series.velocities[:, column]) > 0.2 > 0.02 > abs(series.velocities[-1, column])
        with load(file).connect("real") as live:
            now = live.driver.joint_state()[arm[0]]
        assert now == pytest.approx(series.positions[-1, column], abs=2e-3)


@pytest.mark.realtime
def test_bring_up(cell, tmp_path, capsys):
    file, host = cell
    record = tmp_path / "bringup.json"
    with emulator("--cell", "six_axis_pick", "--off", "--calibration", "4", hosts=[host]):
        status = main(["bringup", str(file), "--yes", "--record", str(record)])
    steps = json.loads(record.read_text())["steps"]
    assert status == 0, steps
    assert [s["name"] for s in steps] == ["network", "identity", "power", "geometry", "joints", "line"]
    assert all(s["outcome"] == "done" for s in steps)


@pytest.mark.realtime
def test_bring_up_stops_at_the_wrong_model(cell, tmp_path, capsys):
    file, host = cell
    with emulator("--model", "UR10e", hosts=[host]):
        assert main(["bringup", str(file), "--yes", "--record", str(tmp_path / "r.json")]) == 1
    assert "is a UR10e, the cell file says UR10" in " ".join(capsys.readouterr().out.split())


def test_real_needs_addresses(capsys):
    assert load("six_axis_pick").spec.real == {}
    assert main(["run", "six_axis_pick", "--mode", "real", "--headless"]) == 1
    assert "the cell has no real arms" in capsys.readouterr().err
    assert not Path("bringup.json").exists()


@pytest.fixture
def seeing(cell):
    """The cell of `cell`, whose cube only a camera finds."""
    file, host = cell
    file.write_text(
        file.read_text() + "perception: {camera: overview, objects: [cube], surface: work_table}\n"
    )
    return file, host


@pytest.mark.realtime
def test_real_arms_behind_a_camera_learn_their_twin(seeing, capsys):
    file, host = seeing
    with emulator("--cell", "six_axis_pick", hosts=[host]):
        assert main(["twin", str(file), "--yes", "--motions", "3"]) == 0, capsys.readouterr().err
        bands = json.loads(file.with_name("cell.twin.json").read_text())
        assert list(bands["arms"]) == ["arm"] and "calibration.arm" in bands["identity"]
        with load(file).connect("real") as live:  # compared with the bands that were just learned
            assert "cube" not in live.scene().objects
            assert live.driver.guard is not None and live.driver.guard.compares
            assert Capability.DRY_RUN in live.driver.capabilities


@pytest.mark.realtime
def test_real_arms_behind_a_camera_are_brought_up(seeing, tmp_path):
    file, host = seeing
    record = tmp_path / "bringup.json"
    with emulator("--cell", "six_axis_pick", "--off", hosts=[host]):
        status = main(["bringup", str(file), "--yes", "--record", str(record)])
    steps = json.loads(record.read_text())["steps"]
    assert status == 0, steps
    assert [s["name"] for s in steps] == ["network", "identity", "power", "geometry", "joints", "line"]
