"""The gate: what is shown, signed, changed, forged, and asked for before a real arm moves."""

import json
import os
from pathlib import Path

import pytest
from scipy import stats
from tests.cli.helpers import call, cell_file, read_json
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts

from armcell.campaigns import CampaignSpec, Store, gate
from armcell.campaigns.spec import checked_cell
from armcell.campaigns.trial import Trial, row_of
from armcell.cell import content_hashes, load, with_values
from armcell.cli.gate import check_gate, gate_summary
from armcell.core import InputError
from armcell.records import read_record

NOD = """robot: ur10_gripper
start: {arm: home}
objects:
  box: {box: [0.1, 0.1, 0.1], pose: [0.2, 0.9, 0.05]}
  cube: {box: [0.04, 0.04, 0.04], pose: [0.2, 0.9, 0.12], movable: true}
randomize: {cube: {dx: [-0.01, 0.01], yaw_deg: [-20, 20]}}
script: task.py
"""
TASK = """def task(cell):
    return cell.arm.move_to("home")
"""


@pytest.fixture(autouse=True)
def own_key(tmp_path, monkeypatch):
    monkeypatch.setenv(gate.KEY_VARIABLE, str(tmp_path / "key" / "gate.key"))


@pytest.fixture
def cell(tmp_path):
    (tmp_path / "task.py").write_text(TASK)
    return cell_file(tmp_path, NOD)


def campaign(cell, root, good, bad=0, values=None, near=0, drawn=None) -> Path:
    """A campaign's folder as if it had been run; `drawn(k)`: parameters of trial k."""
    spec = CampaignSpec(str(cell), values=values or {}, trials=good + bad + near)
    loaded = checked_cell(spec)
    store = Store.new(root, spec, content_hashes(loaded))
    nothing = dict.fromkeys(("slip_m", "placement_error_m", "min_clearance_m", "task_time_s"))
    for k in range(good + bad + near):
        result = {
            "success": k < good, "error_code": 1 if k < good else -4, "message": "", "failed_at": None,
            "randomized": loaded.draw(k), "unwanted_contacts": [], "total_planning_time_s": 0.0, **nothing,
        }  # fmt: skip
        row = row_of(Trial(k, k, drawn(k) if drawn else {}, near_failure=k >= good + bad), result)
        store.append({**row, "wall_s": 1.0, "cpu_s": 1.0})
    store.close()
    return store.folder


@pytest.mark.slow
def test_enough_is_what_the_exact_interval_says(cell, tmp_path):
    for good, bad, near in ((71, 0, 0), (72, 0, 0), (109, 1, 0), (200, 3, 0), (200, 4, 0), (72, 0, 30)):
        low = stats.beta.ppf(0.025, good, bad + 1)  # Clopper and Pearson's lower end
        folder, file = campaign(cell, tmp_path / "runs", good, bad, near=near), tmp_path / f"{good}.json"
        if low >= 0.95:
            record = gate.issue(load(cell), folder, file)
            assert record["campaign"]["interval"][0] == pytest.approx(low, abs=1e-9)
            assert gate.check(load(cell), file)["campaign"]["trials"] == good + bad
        else:
            with pytest.raises(InputError, match=f"{good} of {good + bad} succeeded") as said:
                gate.issue(load(cell), folder, file)
            assert not file.exists() and (bad or "72 trials without a failure" in str(said.value))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"trials": 300}, "asked for 300"),
        ({"half_width": 0.02}, "its interval"),
        ({"max_seconds": 9.0}, "9 s"),
    ],
)
def test_the_number_of_trials_is_fixed_beforehand(cell, tmp_path, asked, said):
    folder = campaign(cell, tmp_path / "runs", 200)
    data = read_json(folder / "campaign.json")
    data["spec"] |= asked
    (folder / "campaign.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=f"200 trials, and was.*{said}"):
        gate.issue(load(cell), folder, tmp_path / "gate.json")


@pytest.mark.slow
def test_changed_inputs_are_named(cell, tmp_path):
    gate.issue(load(cell), campaign(cell, tmp_path / "runs", 80), gate.gate_file(load(cell)))
    assert gate.gate_file(load(cell)) == tmp_path / "cell.gate.json"
    gate.check(load(cell))
    text, script = cell.read_text(), TASK
    for said, what in (
        ("objects.box", text.replace("0.1, 0.1, 0.1", "0.1, 0.1, 0.11")),
        ("start", text.replace("{arm: home}", "{arm: up}")),
        ("physics", text + "physics: {arm_kp: 4000}\n"),
        ("settings", text + "settings: {attempts: 2}\n"),
        ("robot", text.replace("robot: ur10_gripper", "robot: {model: ur10_gripper, pose: [0, 0, 0.1]}")),
        ("real", text + "real: {max_state_age: 0.2}\n"),
    ):
        cell.write_text(what)
        with pytest.raises(InputError, match=rf"changed since: (.*, )?{said}(,|;| \(|$)"):
            gate.check(load(cell))
    cell.write_text(text)
    (tmp_path / "task.py").write_text(script + "# slower\n")
    with pytest.raises(InputError, match="changed since: task"):
        gate.check(load(cell))
    (tmp_path / "task.py").write_text(script)
    with pytest.raises(InputError, match=r"changed since: objects\.box"):
        gate.check(with_values(load(cell), {"objects.box.pose.z": 0.06}))
    gate.check(load(cell))
    with pytest.raises(InputError, match="belongs to another state of this cell"):
        gate.issue(
            with_values(load(cell), {"padding": 0.01}), campaign(cell, tmp_path / "r", 80), tmp_path / "x"
        )


LOOKING = """robot: ur10_gripper
start: {arm: home}
objects:
  mat: {box: [0.1, 0.1, 0.01], pose: [0.6, 0.2, 0.005]}
  cube: {box: [0.04, 0.04, 0.04], pose: [0.6, -0.2, 0.02], movable: true}
cameras: {eye: {eye: [1.3, 0, 1], target: [0.7, 0, 0]}}
"""


@pytest.mark.parametrize(
    ("does", "looks"),
    [
        ("task: [{transfer: {object: cube, on: mat, look: eye}}]", True),
        ("task: [{look: eye}]", True),
        ("script: task.py", True),  # what it looks with is not known
        ("task: [{transfer: {object: cube, on: mat}}]", False),
    ],
)
def test_a_camera_counts_where_it_is_looked_with(tmp_path, does, looks):
    (tmp_path / "task.py").write_text(TASK)
    there = content_hashes(load(cell_file(tmp_path, LOOKING + does)))
    moved = content_hashes(load(cell_file(tmp_path, LOOKING.replace("[1.3, 0, 1]", "[1.3, 0.35, 1]") + does)))
    assert {name for name in moved if there.get(name) != moved[name]} == ({"cameras"} if looks else set())


def test_an_address_changes_nothing_a_payload_does(cell, tmp_path):
    def real(host, payload):
        cell.write_text(NOD + f"real: {{arms: {{arm: {{host: {host}, payload: {payload}}}}}}}\n")
        return load(cell)

    there = real("10.0.0.1", 1.0)
    gate.issue(there, campaign(cell, tmp_path / "runs", 80), gate.gate_file(there))
    gate.check(real("10.0.0.2", 1.0))
    with pytest.raises(InputError, match="changed since: real"):
        gate.check(real("10.0.0.1", 1.5))


@pytest.mark.slow
def test_versions_and_forgery(cell, tmp_path, monkeypatch):
    file = gate.gate_file(load(cell))
    gate.issue(load(cell), campaign(cell, tmp_path / "runs", 80), file)
    honest = json.loads(file.read_text())
    assert oct(gate.key_file().stat().st_mode & 0o777) == "0o600"
    for edit in (
        lambda r: r["campaign"].update(succeeded=81),
        lambda r: r["hashes"].update(task="0"),
        lambda r: r.update(least=0.5),
        lambda r: r.update(signature="0" * 64),
        lambda r: r.update(signature="none"),
    ):
        record = json.loads(json.dumps(honest))
        edit(record)
        file.write_text(json.dumps(record))
        with pytest.raises(InputError, match="signature is not right"):
            gate.check(load(cell))
    for text, said in (("{", "no gate record"), ("[]", "no gate record"), ("{}", "no gate record")):
        file.write_text(text)
        with pytest.raises(InputError, match=said):
            gate.check(load(cell))
    file.write_text(json.dumps(honest))
    monkeypatch.setenv(gate.KEY_VARIABLE, str(tmp_path / "other.key"))
    with pytest.raises(InputError, match="under another key"):
        gate.check(load(cell))
    (tmp_path / "other.key").write_text("00")
    with pytest.raises(InputError, match="too short"):
        gate.check(load(cell))
    monkeypatch.undo()
    monkeypatch.setenv(gate.KEY_VARIABLE, str(tmp_path / "key" / "gate.key"))
    found = gate.versions() | {"mujoco": "4.0.9"}
    monkeypatch.setattr(gate, "versions", lambda: found)
    monkeypatch.setattr("armcell.cell.cell_hashes.versions", lambda: found)
    with pytest.raises(InputError, match=r"mujoco \S+ -> 4\.0\.9"):
        gate.check(load(cell))


SAME = NOD.replace("randomize: {cube: {dx: [-0.01, 0.01], yaw_deg: [-20, 20]}}\n", "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "drawn", "varied"),
    [
        (SAME, None, []),
        (SAME + "randomize: {cube: {dx: [0.01, 0.01]}}\n", None, []),
        (SAME, lambda k: {"objects.cube.mass": 0.2}, []),
        (SAME + "disturbances: {joint_noise_deg: 0.01}\n", None, []),
        (SAME, lambda k: {"objects.cube.mass": 0.2 + k}, ["objects.cube.mass"]),
        (NOD, None, ["randomize.cube.dx", "randomize.cube.yaw_deg"]),
    ],
)
def test_a_campaign_that_varied_nothing_shows_one_case_only(cell, tmp_path, text, drawn, varied):
    cell.write_text(text)
    folder, file = campaign(cell, tmp_path / "runs", 80, drawn=drawn), tmp_path / "gate.json"
    if varied:
        record = gate.issue(load(cell), folder, file, allow_unvaried="not needed")
        assert record["campaign"]["varied"] == varied and record["allow_unvaried"] is None
        return
    with pytest.raises(InputError, match=r"varies nothing.*randomize.*--allow-unvaried REASON"):
        gate.issue(load(cell), folder, file)
    with pytest.raises(InputError, match="needs a reason"):
        gate.issue(load(cell), folder, file, allow_unvaried=" ")
    assert not file.exists()
    gate.issue(load(cell), folder, file, allow_unvaried="the fixture holds it")
    record = gate.check(load(cell), file)
    assert record["allow_unvaried"] == "the fixture holds it" and record["campaign"]["varied"] == []
    for forged in ("another reason", None):
        file.write_text(json.dumps({**json.loads(file.read_text()), "allow_unvaried": forged}))
        with pytest.raises(InputError, match="signature is not right"):
            gate.check(load(cell), file)


def test_a_cell_is_the_same_from_every_working_folder(cell, tmp_path, monkeypatch):
    """Its robot's and its own name are the folder's, also where the folder is '.'."""
    text = "robot: .\n" + NOD.partition("\n")[2]
    cell.write_text(text)
    (tmp_path / "robot.yaml").write_text("parts: [{robot: ur10_gripper}]\n")
    there = content_hashes(load(cell))
    monkeypatch.chdir(tmp_path)
    assert content_hashes(load(cell.name)) == there
    cell.rename(tmp_path / "cell.yaml")
    assert load("cell.yaml").name == load(tmp_path).name == tmp_path.name


def test_one_seed_repeated_is_no_variation(cell, tmp_path):
    folder = campaign(cell, tmp_path / "runs", 80)
    rows = [json.loads(line) for line in (folder / "trials.jsonl").read_text().splitlines()]
    same = [{**row, "seed": 7, "randomized": rows[7]["randomized"]} for row in rows]
    (folder / "trials.jsonl").write_text("".join(json.dumps(row) + "\n" for row in same))
    with pytest.raises(InputError, match="80 trials that differ in nothing"):
        gate.issue(load(cell), folder, tmp_path / "gate.json")


def test_a_cell_that_draws_nothing_is_named_before_its_campaign(cell, tmp_path, capsys):
    cell.write_text(SAME)
    said = call(capsys, "gate", cell, "--trials", 72, "--runs", tmp_path / "runs")
    assert said.status == 1 and "--allow-unvaried" in said.err and not (tmp_path / "runs").exists()
    said = call(capsys, "gate", cell, "--trials", 72, "--runs", tmp_path / "runs", "--allow-unvaried", "")
    assert said.status == 1 and "needs a reason" in said.err and not (tmp_path / "runs").exists()


def test_runs_with_real_arms_print_what_was_allowed(cell, tmp_path, capsys):
    cell.write_text(SAME + "real: {arms: {arm: {host: 10.0.0.1}}}\n")
    loaded = load(cell)
    folder = campaign(cell, tmp_path / "runs", 80)
    gate.issue(loaded, folder, gate.gate_file(loaded), allow_unvaried="one part, always there")
    passed = check_gate(loaded, "real", None, None)
    assert "varied nothing: one part, always there" in capsys.readouterr().err
    assert passed["gate"]["allow_unvaried"] == "one part, always there"  # the run's record keeps it
    assert "varied nothing: one part, always there" in gate_summary(passed)


@pytest.mark.slow
def test_real_arms_ask_for_it(tmp_path, capsys):
    """From a cell's campaign to the emulated arm, and what is said when something was changed in between."""
    (host,) = free_hosts(1)
    (tmp_path / "task.py").write_text(TASK)
    port = 20100 + 10 * (os.getpid() % 900)  # other tests' arms are on the usual one, clients above 32768
    arm = f"{{host: {host}, model: UR10, port: {port}}}"
    text = NOD + f"real: {{max_state_age: 0.5, watchdog: 0.5, arms: {{arm: {arm}}}}}\n"
    cell, out = cell_file(tmp_path, text), tmp_path / "out.json"
    run = ("run", cell, "--mode", "real", "--runs", tmp_path / "runs", "--json", out)
    with emulator("--cell", str(cell), hosts=[host]):
        said = call(capsys, *run)
        assert said.status == 1 and "has not been shown to work in simulation" in said.err
        assert "armcell gate" in said.err and "--without-gate" in said.err
        assert call(capsys, *run, "--without-gate", " ").status == 1
        said = call(capsys, "gate", cell, "--trials", 20, "--workers", 1, "--runs", tmp_path / "runs")
        assert said.status == 1 and "20 of 20 succeeded, which is at least 83.2%" in said.err
        said = call(capsys, "gate", cell, "--trials", 72, "--workers", 1, "--runs", tmp_path / "runs")
        assert said.status == 0 and "72 of 72 succeeded: at least 95.0%" in said.out
        assert call(capsys, *run).status == 0
        assert read_json(out)["gate"]["campaign"]["trials"] == 72
        cell.write_text(text.replace("0.1, 0.1, 0.1", "0.1, 0.1, 0.3"))
        said = call(capsys, *run)
        assert said.status == 1 and "changed since: objects.box" in said.err
        assert call(capsys, *run, "--without-gate", "box was measured anew").status == 0
        kept = read_json(out)["gate"]
        assert (
            kept["overridden"] and kept["reason"] == "box was measured anew" and "objects.box" in kept["else"]
        )
        assert "protective stop" not in dashboard(host, "armcell messages")[0]
    records = sorted((tmp_path / "runs").glob("*/run.mcap"))
    notes = [e.text for e in read_record(records[-1]).events if e.kind == "note"]
    assert notes == ["gate overridden: box was measured anew"]
