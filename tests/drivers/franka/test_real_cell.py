"""Mode `real` end to end on Franka arms: bring-up, pick, learned twin; each robot with its own protocol."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.drivers.franka.emulated import emulator, operate

from armcell.cell import load
from armcell.cell.built_in import LIBRARY
from armcell.cli.main import main
from armcell.drivers import Capability

pytestmark = [pytest.mark.slow, pytest.mark.realtime]


@pytest.fixture(params=["fr3", "panda"])
def arm(request, tmp_path):
    """panda_pick with an emulated arm: the cell file, and the arm's address."""
    with emulator("--model", request.param, "--cell", "panda_pick", "--seed", "0") as host:
        text = (LIBRARY / "panda_pick" / "cell.yaml").read_text()
        text += "\nreal:\n  kind: franka\n  arms:\n"
        text += f"    arm: {{host: {host}, model: {request.param}, gripper: {{kind: hand}}}}\n"
        file = tmp_path / "cell.yaml"
        file.write_text(text)
        yield file, host


def test_bring_up_twin_and_pick(arm, tmp_path: Path, capsys):
    file, host = arm
    record = tmp_path / "bringup.json"
    status = main(["bringup", str(file), "--yes", "--record", str(record)])
    steps = json.loads(record.read_text())["steps"]
    assert status == 0, steps
    assert [s["name"] for s in steps] == ["network", "identity", "power", "geometry", "joints", "line"]
    assert "serial" not in steps[1]["text"] and "calibration: apply" not in steps[3]["text"]

    assert main(["twin", str(file), "--yes"]) == 0, capsys.readouterr().err
    assert "Nm, load" in capsys.readouterr().out
    with load(file).connect("real") as live:
        assert live.driver.guard is not None and live.driver.guard.compares
        assert Capability.DRY_RUN in live.driver.capabilities

    operate(host, "reset")
    out = tmp_path / "result.json"
    gate = ["--without-gate", "an emulator"]
    status = main(
        ["run", str(file), "--mode", "real", "--seed", "0", "--headless", "--json", str(out), *gate]
    )
    result = json.loads(out.read_text())
    assert status == 0, result["message"]
    assert result["success"] and result["mode"] == "real" and result["placement_error_m"] < 0.005
