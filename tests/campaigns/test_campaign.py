"""Campaigns in real worker processes: broken off in every way, and the table is the same."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from benchmarks.campaign import QUICK, TIMED, VARIED
from tests.cli.helpers import call, cell_file, finished, read_json, start
from tests.programs import Program

from armcell.campaigns import CampaignSpec, Store, begin, resume, rows_of, run, write_report
from armcell.campaigns.failure_frames import MOST
from armcell.campaigns.store import TRIALS
from armcell.campaigns.trial import Trial, failed, run_trial
from armcell.cell import load
from armcell.cli.campaign import run_campaign
from armcell.core import InputError

KILLS = int(os.environ.get("ARMCELL_KILLS", "3"))  # 20 were tried; each takes some seconds


@pytest.fixture
def quick(tmp_path) -> str:
    return str(cell_file(tmp_path, QUICK))


def table(folder: Path) -> list[dict]:
    rows, _ = rows_of(folder / TRIALS)
    return [{k: v for k, v in r.items() if k not in TIMED} for r in sorted(rows, key=lambda r: r["trial"])]


def unbroken(spec: CampaignSpec, root: Path, workers: int = 2) -> list[dict]:
    store = begin(spec, root)
    run(store, workers)
    store.close()
    return table(store.folder)


@pytest.mark.long
def test_the_table_does_not_depend_on_workers_and_has_both_outcomes(quick, tmp_path):
    spec = CampaignSpec(quick, VARIED, trials=60, sampling="adaptive")
    one, two = unbroken(spec, tmp_path / "a", 1), unbroken(spec, tmp_path / "b", 3)
    assert one == two and [row["trial"] for row in one] == list(range(60))
    assert {row["success"] for row in one} == {True, False}
    assert any(row["near_failure"] for row in one)
    assert all(row["error_name"] and row["message"] for row in one if not row["success"])


@pytest.mark.long
def test_workers_and_the_head_are_killed_at_random_moments(quick, tmp_path):
    """No trial is lost, none counted twice, and the table is that of an unbroken campaign."""
    spec = CampaignSpec(quick, VARIED, trials=60)
    want = unbroken(spec, tmp_path / "unbroken", 1)
    assert not any(row["near_failure"] for row in want)
    rng = random.Random(4)
    store = begin(spec, tmp_path / "broken")
    store.close()
    for k in range(KILLS):
        head = Program(
            [sys.executable, "-m", "armcell", "campaign", "--resume", str(store.folder), "--workers", "2"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        deadline = time.monotonic() + 300  # only a head that hangs gets there
        while time.monotonic() < deadline and not (pids := workers_of(head.pid)) and head.poll() is None:
            time.sleep(0.02)
        if k % 4:  # else while its workers start
            before = len(rows_of(store.folder / TRIALS)[0])
            while time.monotonic() < deadline and head.poll() is None:
                if len(rows_of(store.folder / TRIALS)[0]) > before:
                    break
                time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.5))
        if k % 2 and pids:
            kill(rng.choice(pids))
            time.sleep(rng.uniform(0.0, 1.0))
        kill(head.pid)
        head.wait()
        gone = time.monotonic() + 10
        while any(alive(pid) for pid in pids) and time.monotonic() < gone:
            time.sleep(0.05)
        assert not any(alive(pid) for pid in pids), "a worker outlived its head"
    assert len(rows_of(store.folder / TRIALS)[0]) > 0
    with open(store.folder / TRIALS, "ab") as file:  # as if the last write had been cut off
        file.write(b'{"trial": 99, "succ')
    store = resume(store.folder)
    assert store.dropped == len(b'{"trial": 99, "succ')
    run(store, 2)
    store.close()
    assert table(store.folder) == want


def kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except OSError:
        return False


def workers_of(pid: int) -> list[int]:
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


@pytest.mark.long
def test_a_worker_that_dies_or_hangs(quick, tmp_path, monkeypatch):
    """Its trial is tried three times, then it is a failure with its cause; the others go on."""
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(
        "import os, sys, time, threading\n"
        "if 'armcell.campaigns.worker' in ' '.join(sys.orig_argv):\n"
        "    import queue\n"
        "    get = queue.Queue.get\n"
        "    def watched(*a, **k):\n"
        "        data = get(*a, **k)\n"
        "        if isinstance(data, dict) and data.get('number') == 2: os._exit(7)\n"
        "        if isinstance(data, dict) and data.get('number') == 4: time.sleep(1000)\n"
        "        return data\n"
        "    queue.Queue.get = watched\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{site}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    rows = unbroken(CampaignSpec(quick, trials=6, trial_seconds=20.0), tmp_path)
    assert [row["error_name"] for row in rows] == ["", "", "CRASHED", "", "TRIAL_TIMED_OUT", ""]
    assert "status 7" in rows[2]["message"] and "20 s" in rows[4]["message"]


@pytest.mark.slow
def test_workers_that_die_as_they_start(quick, tmp_path, monkeypatch):
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(
        "import os, sys\nif 'armcell.campaigns.worker' in ' '.join(sys.orig_argv): os._exit(9)\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{site}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    store = begin(CampaignSpec(quick, trials=6), tmp_path)
    with pytest.raises(InputError, match="status 9 as they start.*armcell check"):
        run(store, 1)
    assert store.rows == {}
    monkeypatch.undo()
    Path(quick).write_text("robot: nobody\n")  # changed after the look at it
    with pytest.raises(InputError, match="a worker says: .*nobody"):
        run(store, 1)
    store.close()


@pytest.mark.slow
def test_stop_rules(quick, tmp_path):
    for options, told in (({"half_width": 0.1}, "interval"), ({"max_seconds": 0.01}, "are over")):
        store = begin(CampaignSpec(quick, trials=5000, **options), tmp_path)
        assert told in run(store, 2)
        count = len(store.rows)
        assert count < 100
        if "half_width" in options:  # sure enough already: nothing is gone on with
            assert told in run(store, 2) and len(store.rows) == count
        store.close()


def row(number: int) -> dict:
    return {**failed(Trial(number, number, {}), "", ""), "success": True}


def test_a_store_keeps_what_was_whole(tmp_path):
    store = Store.new(tmp_path, CampaignSpec("panda_pick"), {})
    with pytest.raises(InputError, match="another process"):
        Store.open(store.folder)
    for number in (0, 1, 1):
        store.append(row(number))
    store.close()
    file = store.folder / TRIALS
    assert file.read_text() == json.dumps(row(0)) + "\n" + json.dumps(row(1)) + "\n"
    file.write_text(file.read_text()[:-5])
    again = Store.open(store.folder)
    assert list(again.rows) == [0] and again.dropped == len(json.dumps(row(1))) - 4
    again.append(row(1))
    again.close()
    assert [r["trial"] for r in rows_of(file)[0]] == [0, 1]
    file.write_text("{}\n")
    for _ in range(2):  # and it is not kept from others
        with pytest.raises(InputError, match=f"{TRIALS}:1"):
            Store.open(store.folder)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk(tmp_path):
    store = Store.new(tmp_path, CampaignSpec("panda_pick"), {})
    store.append(row(0))
    os.dup2(os.open("/dev/full", os.O_WRONLY), store._file)
    with pytest.raises(InputError, match="No space left on device.*--resume"):
        store.append(row(1))
    assert list(store.rows) == [0]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_report_on_a_full_disk(tmp_path, monkeypatch, capsys):
    """What was there stays; the error is one of ours, and does not hide the one before it."""
    store = Store.new(tmp_path, CampaignSpec("panda_pick"), {})
    (store.folder / "summary.json").write_text("before")
    (store.folder / "summary.json.part").symlink_to("/dev/full")
    with pytest.raises(InputError, match="No space left on device.*make room"):
        write_report(store, "it was stopped")
    assert (store.folder / "summary.json").read_text() == "before"
    (store.folder / "summary.json.part").symlink_to("/dev/full")

    def no_worker(*_):
        raise InputError("no worker comes up")

    monkeypatch.setattr("armcell.cli.campaign._run", no_worker)
    with pytest.raises(InputError, match="no worker comes up"):
        run_campaign(store, 1)
    Store.open(store.folder).close()  # nobody holds it any more


@pytest.mark.slow
def test_failures_of_planning_have_stage_and_pair(tmp_path):
    cell = cell_file(
        tmp_path, QUICK.replace("  box:", "  box: {box: [0.1, 0.1, 0.1], pose: [2, 0, 1]}\n  two:")
    )
    row = run_trial(load(cell), Trial(0, 0, {"objects.two.pose": [0.1, 0.0, 1.1]}))
    assert row["error_name"] == "GOAL_IN_COLLISION"
    assert row["stage"] == "move to extended" and "two" in row["pair"] and "box" not in row["pair"]


def test_what_is_passed_over_is_refused(tmp_path, capsys):
    with pytest.raises(InputError, match="adaptive sampling needs parameters.*--vary"):
        begin(CampaignSpec("panda_pick", sampling="adaptive"), tmp_path)
    said = call(capsys, "campaign", "--resume", tmp_path, "--seed", 9)
    assert said.status == 2 and "asked then" in said.err


def test_what_is_no_campaign(tmp_path, capsys):
    said = call(capsys, "campaign", "--resume", tmp_path)
    assert said.status == 1 and "campaign.json" in said.err
    (tmp_path / "campaign.json").write_text('{"format": 99, "spec": {}, "hashes": {}}')
    assert "format 99" in call(capsys, "campaign", "--resume", tmp_path).err
    (tmp_path / "campaign.json").write_text("{")
    assert "cannot be read" in call(capsys, "campaign", "--resume", tmp_path).err
    assert call(capsys, "campaign").status == 2
    assert "PATH=LOW,HIGH" in call(capsys, "campaign", "panda_pick", "--vary", "a=1").err


@pytest.mark.slow
def test_the_command(quick, tmp_path, capsys, monkeypatch):
    options = (
        "--trials",
        30,
        "--vary",
        "objects.box.pose.y=-0.4,0.4",
        "--vary",
        "objects.box.pose.z=0.8,1.1",
    )
    monkeypatch.chdir(tmp_path)
    name = Path(quick).name
    runs = ("--workers", 1, "--runs", tmp_path, "--json", tmp_path / "s.json")
    said = call(capsys, "campaign", name, *options, *runs)
    monkeypatch.chdir("/")  # its commands work in any folder
    data = read_json(tmp_path / "s.json")
    assert said.status == 1 and f"{data['success']['count']} of 30 succeeded" in said.out
    folder = next(tmp_path.glob("*-campaign-*"))
    page = (folder / "report.html").read_text()
    assert "http" not in page.replace("http-equiv", "") and "Failures by cause" in page
    assert "| failures | code |" in (folder / "report.md").read_text()
    assert "| trial | seed | code |" in (folder / "report.md").read_text()
    pictures = sorted(folder.glob("pictures/*"))
    assert len(pictures) == min(len(data["failures"]), MOST) == page.count('<figure id="trial_')
    assert f"![trial {data['failures'][0]['trial']}, seed" in (folder / "report.md").read_text()
    # Each failure replays from the command that the report gives.
    failure = data["failures"][0]
    words = failure["replay"].split()[1:]
    again = call(capsys, *words, "--headless", "--json", tmp_path / "r.json")
    assert again.status == 1 and read_json(tmp_path / "r.json")["message"] == failure["message"]
    # Another cell under the same name is not gone on with.
    Path(quick).write_text(QUICK.replace("0.1, 0.1, 0.1", "0.1, 0.1, 0.2"))
    said = call(capsys, "campaign", "--resume", folder, "--trials", 40)
    assert said.status == 1 and "objects" in said.err
    Path(quick).write_text(QUICK)
    assert call(capsys, "campaign", "--resume", folder, "--trials", 32).status == 1
    assert len(rows_of(folder / TRIALS)[0]) == 32
    said = call(capsys, "campaign", "--compare", folder, folder)
    assert said.status == 0 and "no difference shown" in said.out and "what differs: nothing" in said.out
    other = begin(CampaignSpec(quick, {}, trials=1, seed=7), tmp_path)
    other.append({**next(iter(rows_of(folder / TRIALS)[0]))})
    other.close()
    assert "what differs: parameters, seed" in call(capsys, "campaign", "--compare", folder, other.folder).out


@pytest.mark.long
def test_ctrl_c_leaves_nothing_running(quick, tmp_path):
    process = start("campaign", quick, "--trials", 100000, "--workers", 2, "--runs", tmp_path)
    deadline = time.monotonic() + 90
    while time.monotonic() < deadline:
        files = list(tmp_path.glob("*-campaign-*/trials.jsonl"))
        if files and files[0].stat().st_size > 0:
            break
        time.sleep(0.1)
    pids = workers_of(process.pid)
    assert len(pids) == 2
    os.killpg(process.pid, signal.SIGINT)
    said = finished(process)
    assert said.status == 130 and "--resume" in said.err and "Traceback" not in said.err
    assert not any(alive(pid) for pid in pids)
    assert (files[0].parent / "report.html").exists()
