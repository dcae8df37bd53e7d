"""A cell's task as data: what the JSON says, that it is the truth, and that it is the same each time."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.tasks.helpers import AtStage, teleport

import armcell
from armcell.cell import load, run_task
from armcell.core import ErrorCode, InputError

FILE = Path(armcell.__file__).parent / "cell" / "library" / "panda_pick" / "cell.yaml"
SLIPPERY = "    movable: true\n    mass: 0.5\n    friction: 0.035\n"
RUN = """
import json, sys
import armcell
from armcell.cell import load, run_task
cell = armcell.load(sys.argv[1])
with cell.connect(sys.argv[2], seed=4) as live:
    print(json.dumps(run_task(cell, live, 4, sys.argv[2]), allow_nan=False, sort_keys=True))
"""


def perform(cell, mode: str, seed: int) -> dict:
    with cell.connect(mode, seed=seed) as live:
        return json.loads(json.dumps(run_task(cell, live, seed, mode), allow_nan=False))


@pytest.fixture(scope="module", params=[("panda_pick", "sim"), ("six_axis_pick", "fake")])
def run(request):
    name, mode = request.param
    return armcell.load(name), mode, perform(armcell.load(name), mode, 3)


@pytest.mark.slow
def test_says_what_the_issue_asks_for(run):
    cell, mode, result = run
    assert result["success"] and result["error_code"] == 1 and result["error_name"] == "SUCCESS"
    assert (result["cell"], result["mode"], result["seed"]) == (cell.name, mode, 3)
    assert result["randomized"] == cell.draw(3)
    assert result["slip_m"] <= 5e-4 and result["placement_error_m"] <= 5e-3
    assert result["unwanted_contacts"] == [] and result["welds"] == []
    assert result["min_clearance_m"] > 0
    assert {"armcell", "mujoco", "python"} <= set(result["versions"])


def test_its_numbers_are_those_of_its_stages(run):
    stages = run[2]["stages"]
    assert all(s["ok"] and not s["error"] for s in stages)
    assert [s["name"] for s in stages].count("hold") == 1
    (hold,) = [s for s in stages if s["name"] == "hold"]
    assert hold["motion_time_s"] == pytest.approx(5.0, abs=0.02)
    assert run[2]["slip_m"] == hold["slip_m"]
    assert run[2]["task_time_s"] == pytest.approx(sum(s["motion_time_s"] for s in stages))
    assert run[2]["total_planning_time_s"] == pytest.approx(sum(s["planning_time_s"] for s in stages))
    assert run[2]["min_clearance_m"] == min(s["clearance_m"] for s in stages if s["clearance_m"] is not None)
    assert run[2]["wall_time_s"] > run[2]["total_planning_time_s"]


def without_wall_times(value):
    if isinstance(value, dict):
        kept = {k: v for k, v in value.items() if not k.endswith(("planning_time_s", "wall_time_s"))}
        return {k: without_wall_times(v) for k, v in kept.items()}
    return [without_wall_times(v) for v in value] if isinstance(value, list) else value


@pytest.mark.slow
@pytest.mark.cases("panda_pick-sim")
@pytest.mark.parametrize(("name", "mode"), [("panda_pick", "sim"), ("six_axis_pick", "sim")])
def test_two_processes_give_the_same_bytes(name, mode):
    asked = [
        subprocess.Popen([sys.executable, "-c", RUN, name, mode], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    one, two = (json.loads(process.communicate(timeout=120)[0]) for process in asked)
    assert one["success"]
    assert json.dumps(without_wall_times(one)) == json.dumps(without_wall_times(two))
    assert one["stages"][1]["planning_time_s"] > 0


def test_another_seed_is_another_run():
    cell = armcell.load("panda_pick")
    one, two = perform(cell, "fake", 0), perform(cell, "fake", 1)
    assert one["randomized"] != two["randomized"]
    assert one["task_time_s"] != two["task_time_s"]


# --- cells that are not the built-in one ---
def edited(tmp_path, *changes: tuple[str, str]):
    text = FILE.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "cell.yaml").write_text(text[: text.index("randomize:")] + text[text.index("cameras:") :])
    return armcell.load(tmp_path)


@pytest.mark.slow
@pytest.mark.cases("hybrid")
@pytest.mark.parametrize("mode", ["weld", "hybrid"])
def test_grip_modes_report_their_welds(tmp_path, mode):
    cell = edited(
        tmp_path,
        ("    movable: true\n    mass: 0.1\n    friction: 0.6\n", SLIPPERY),
        ("task:", f"physics: {{grip_mode: {mode}}}\ntask:"),
    )
    result = perform(cell, "sim", 0)
    assert result["success"], result["message"]
    (weld,) = result["welds"]
    assert (weld["object"], weld["gripper"]) == ("cube", "hand")
    assert 0 < weld["time_s"] < weld["released_s"] < result["task_time_s"]
    assert weld["reason"]


@pytest.mark.slow
def test_friction_alone_says_that_it_failed(tmp_path):
    cell = edited(tmp_path, ("    movable: true\n    mass: 0.1\n    friction: 0.6\n", SLIPPERY))
    result = perform(cell, "sim", 0)
    assert not result["success"] and result["error_name"] == "CONTROL_FAILED"
    assert "lost cube" in result["message"]
    assert result["welds"] == [] and result["placement_error_m"] is None and result["slip_m"] is None
    assert [s["name"] for s in result["stages"]].count("lift") == cell.settings.attempts


def test_a_robot_that_touches_something_did_not_succeed(tmp_path):
    (tmp_path / "cell.yaml").write_text(
        "robot: panda\nstart: {arm: home, hand: open}\ntask: [{hold: 0.2}]\n"
        "objects: {ball: {sphere: 0.03, pose: [0.6, 0, 0.5], movable: true}}\n"
    )
    cell = armcell.load(tmp_path)
    with cell.connect("sim") as live:
        palm = cell.scene().frame_pose("panda_hand")
        live.driver.world.set_object_pose("ball", palm)
        result = run_task(cell, live, 0, "sim")
    assert all(stage["ok"] for stage in result["stages"])
    contacts = result["unwanted_contacts"]
    assert {"panda_hand", "ball"} in [{c["body_a"], c["body_b"]} for c in contacts]
    assert all(c["steps"] >= 1 and c["depth_m"] >= 0 and c["time_s"] > 0 for c in contacts)
    assert not result["success"] and result["error_name"] == "CONTROL_FAILED"
    assert "touched" in result["message"]


def test_a_cell_without_a_task_says_so(tmp_path):
    (tmp_path / "cell.yaml").write_text("robot: panda\n")
    cell = armcell.load(tmp_path)
    with cell.connect("fake") as live, pytest.raises(InputError, match="no task"):
        run_task(cell, live, 0, "fake")


def test_moves_only(tmp_path):
    text = "robot: ur10\nstart: {arm: home}\ntask: [{move: up}, {hold: 0.5}]\n"
    model = armcell.load_robot("ur10")
    state = next(n for n in model.named_states["arm"] if n != "home")
    (tmp_path / "cell.yaml").write_text(text.replace("up", state))
    cell = armcell.load(tmp_path)
    result = perform(cell, "sim", 0)
    assert result["success"], result["message"]
    assert [s["name"] for s in result["stages"]] == [f"move to {state}", "hold"]
    assert result["slip_m"] is None and result["placement_error_m"] is None
    assert np.isfinite(result["min_clearance_m"])


def test_after_a_stop_nothing_moves_before_resume():
    with load("panda_pick").connect("fake") as live:
        live.stop()
        before = live.driver.joint_state().positions
        for _ in range(2):
            assert live.arm.move_to("extended").code is ErrorCode.PREEMPTED
        assert np.array_equal(live.driver.joint_state().positions, before)
        live.resume()
        assert live.arm.move_to("extended").ok


@pytest.mark.slow
def test_transfer_in_a_file_picks_up_again_what_was_lost(tmp_path):
    """And turns it as the file says."""
    head, task, _ = FILE.read_text().partition("task:")
    file = tmp_path / "cell.yaml"
    file.write_text(f"{head}{task}\n  - transfer: {{object: cube, on: tray, at: [0.02, 0], up: [1, 0, 0]}}\n")
    cell = load(file)
    with cell.connect("sim", seed=2) as live:
        live.ctx.observers.append(AtStage("lift", lambda: teleport(live, -0.12, 0.0)))
        result = run_task(cell, live, 2, "sim")
        T = live.driver.object_poses()["cube"]
    assert result["success"], result["message"]
    assert [s["name"] for s in result["stages"]].count("lift") >= 2
    assert T.rotation.matrix[2, 0] > 0.999  # the cube's x is up
    assert result["placement_error_m"] <= 5e-3 and result["unwanted_contacts"] == []
    tray = live.scene().object("tray").T_world_object
    assert np.linalg.norm(T.translation[:2] - tray.translation[:2]) < 0.08
