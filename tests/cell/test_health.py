"""Layers start in order, say which one failed, and what dies stops the cell or is restarted."""

import gc
import json
import time

import numpy as np
import pytest
from tests.drivers.ur.emulated import emulator, free_hosts, free_port

from armcell.cell import load
from armcell.cell.built_in import LIBRARY
from armcell.cell.health import LAYERS, Health
from armcell.cli.main import main
from armcell.core import InputError


def test_order_and_failures():
    told = []
    health = Health(told.append)
    early = pytest.raises(InputError, match="drivers cannot start before description, controllers")
    with early, health.layer("drivers"):
        pass
    with health.layer("description") as said:
        said.append("a robot")
    with pytest.raises(InputError, match="no arm"), health.layer("controllers"):
        raise InputError("no arm")
    assert told == ["description: ok (a robot)", "controllers: failed"]
    assert [health.states[n].partition(":")[0] for n in LAYERS] == [
        "ok",
        "failed",
        "waiting",
        "waiting",
        "waiting",
    ]


def test_a_missing_description_is_said_before_anything_starts(tmp_path, capsys):
    (tmp_path / "cell.yaml").write_text("robot: {model: nowhere.urdf}\nobjects: {}\ntask: [{move: home}]\n")
    assert main(["run", str(tmp_path), "--mode", "fake", "--runs", str(tmp_path / "runs")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert said.startswith("armcell: ") and "nowhere.urdf" in said and "cell.yaml" in said
    text = "robot: ur10\nobjects: {}\ntask: [{move: home}]\nreal: {arms: {leg: {host: 127.0.0.9}}}\n"
    (tmp_path / "cell.yaml").write_text(text)
    assert main(["run", str(tmp_path), "--mode", "real", "--runs", str(tmp_path / "runs")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "start: description ok, controllers failed, drivers waiting" in said and "leg" in said


def test_a_run_tells_its_layers(tmp_path, capsys):
    file = tmp_path / "cell.yaml"
    text = (LIBRARY / "six_axis_pick" / "cell.yaml").read_text()
    file.write_text(text[: text.index("\ntask:")] + "\ntask:\n  - move: home\n")
    out = tmp_path / "result.json"
    assert main(["run", str(file), "--mode", "fake", "--headless", "--json", str(out)]) == 0
    assert json.loads(out.read_text())["layers"] == dict.fromkeys(LAYERS, "ok")
    assert "layers: all ok" in capsys.readouterr().out


@pytest.mark.slow
def test_a_part_that_dies_is_restarted_or_stops_the_cell(tmp_path):
    (host,) = free_hosts(1)
    text = (LIBRARY / "six_axis_pick" / "cell.yaml").read_text()
    text += "\nreal:\n  twin: false\n  max_state_age: 0.3\n  watchdog: 0.5\n  arms:\n"
    text += f"    arm: {{host: {host}, port: {free_port()}, model: UR10, gripper: {{kind: socket}}}}\n"
    (tmp_path / "cell.yaml").write_text(text)
    health = Health()
    for layer in LAYERS:
        with health.layer(layer):
            pass
    with emulator("--cell", "six_axis_pick", hosts=[host]) as robot, load(tmp_path).connect("real") as live:
        assert health.now(live) == dict.fromkeys(LAYERS, "ok")
        assert gc.get_freeze_count() > 50_000  # no long pause for garbage while an arm listens for us
        (gripper,) = live.driver._grippers.values()
        broken = gripper._socket
        broken.shutdown(2)  # its connection dies: it is made anew
        end = time.monotonic() + 5.0
        while gripper._socket is broken and time.monotonic() < end:
            time.sleep(0.02)
        time.sleep(0.3)
        assert gripper.time_since_answer < 0.3 and health.now(live)["drivers"] == "ok"
        live.driver._heartbeat.stop()  # what keeps the robot going dies: all stops, and it is said
        time.sleep(0.3)
        assert "watchdog thread" in health.now(live)["drivers"]
        rest = live.driver.arms["arm"].q
        outcome = live.arm.move_to("home")
        assert not outcome.ok and "watchdog thread" in outcome.message
        np.testing.assert_allclose(live.driver.arms["arm"].q, rest, atol=1e-4)
        with pytest.raises(InputError, match="start armcell again"):
            live.driver.resume()
        robot.kill()
        time.sleep(0.5)
        assert health.now(live)["drivers"].startswith("stopped: arm:")
    assert gc.get_freeze_count() == 0
