"""`armcell run`: what it prints, writes and leaves behind."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest
from tests.cli.helpers import call, cell_file, read_json

from armcell.cli.console import write_json

FAKE = ("--mode", "fake", "--seed", "3")


def left_in(folder) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty current folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_headless_writes_the_json_and_nothing_else(capsys, here):
    said = call(capsys, "run", "panda_pick", *FAKE, "--headless", "--json", "out.json")
    assert said.status == 0 and said.err == ""
    assert left_in(here) == {"out.json"}
    result = read_json(here / "out.json")
    assert result["success"] and result["seed"] == 3 and result["mode"] == "fake"
    for stage in result["stages"]:
        assert stage["name"] in said.words
    assert "success (seed 3)" in said.words and "unwanted contacts 0" in said.words


def test_a_run_that_fails_is_status_1_and_says_why(capsys, here):
    text = (
        "robot: panda\nstart: {arm: home}\nobjects:\n"
        "  cube: {box: [0.15, 0.15, 0.15], pose: [0.5, 0, 0.075], movable: true}\ntask: [{pick: cube}]\n"
    )
    said = call(capsys, "run", cell_file(here, text), *FAKE, "--headless", "--json", "out.json")
    assert said.status == 1
    assert "failed: PLANNING_FAILED: pick cube" in said.words
    result = read_json(here / "out.json")
    assert not result["success"] and result["error_code"] == -1
    assert "150 mm wide, the gripper opens 80 mm" in result["message"]


@pytest.mark.slow
def test_without_headless_a_folder_with_report_numbers_and_record(capsys, here):
    said = call(capsys, "run", "panda_pick", *FAKE, "--json", "out.json")
    assert said.status == 0
    (folder,) = (here / "runs").iterdir()
    assert re.fullmatch(r"\d{8}-\d{6}-panda_pick", folder.name)
    assert left_in(folder) == {"report.html", "result.json", "run.mcap"}
    assert f"report: runs/{folder.name}/report.html" in said.words
    assert read_json(folder / "result.json") == read_json(here / "out.json")
    record = (folder / "run.mcap").read_bytes()
    assert record.startswith(b"\x89MCAP0\r\n") and record.endswith(b"\x89MCAP0\r\n")


@pytest.mark.slow
def test_the_report_needs_no_network(capsys, here):
    call(capsys, "run", cell_file(here), *FAKE)
    (report,) = here.glob("runs/*/report.html")
    page = report.read_text()
    loaded = re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?([^"')\s>]+)""", page)
    assert not [link for link in loaded if not link.startswith(("data:", "#"))]
    assert "<script" not in page and "@import" not in page
    assert "move to extended" in page


@pytest.mark.long
def test_in_physics_the_report_has_pictures(capsys, here):
    assert call(capsys, "run", "panda_pick", "--seed", "1").status == 0
    (report,) = here.glob("runs/*/report.html")
    page = report.read_text()
    pictures = re.findall(r'src="data:image/(png|jpeg);base64,([^"]{2000,})"', page)
    assert len(pictures) >= len(read_json(report.with_name("result.json"))["stages"])
    assert len({data for _, data in pictures}) > 5


@pytest.mark.slow
def test_runs_names_the_folder_and_two_runs_have_two(capsys, here):
    file = cell_file(here)
    for _ in range(2):
        call(capsys, "run", file, *FAKE, "--runs", "kept")
    assert len(list((here / "kept").iterdir())) == 2


@pytest.mark.slow
def test_the_same_seed_gives_the_same_json(capsys, here, monkeypatch):
    texts = []
    for name in ("a.json", "b.json"):
        arguments = ["run", "panda_pick", *FAKE, "--headless", "--json", name]
        monkeypatch.setattr(sys, "argv", ["armcell", *arguments])  # as it is when the shell calls
        call(capsys, *arguments)
        lines = (here / name).read_text().splitlines()
        texts.append([line for line in lines if "planning_time_s" not in line and "wall_time_s" not in line])
    assert texts[0] == texts[1]


# --- nothing half-written ---
def nothing_ran(said) -> bool:
    return said.status == 1 and said.out.strip() == "" and len(said.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("target", "reason"), [("none/out.json", "folder does not exist"), (".", "is a folder")]
)
def test_json_that_cannot_be_written_is_said_before_the_run(capsys, here, target, reason):
    said = call(capsys, "run", "panda_pick", *FAKE, "--headless", "--json", target)
    assert nothing_ran(said) and reason in said.err
    assert left_in(here) == set()


def test_a_file_where_the_folder_should_be(capsys, here):
    (here / "file").write_text("")
    said = call(capsys, "run", "panda_pick", *FAKE, "--headless", "--json", "file/out.json")
    assert nothing_ran(said) and "internal error" not in said.err


def test_a_folder_that_takes_no_files(capsys, here):
    said = call(capsys, "run", "panda_pick", *FAKE, "--headless", "--json", "/proc/armcell.json")
    assert nothing_ran(said) and "/proc" in said.err and "internal error" not in said.err


def test_a_runs_folder_that_cannot_be_made(capsys, here):
    (here / "runs").write_text("a file")
    said = call(capsys, "run", "panda_pick", *FAKE)
    assert nothing_ran(said) and "runs" in said.err and "internal error" not in said.err


def test_a_run_that_cannot_begin_leaves_no_folder(capsys, here):
    said = call(capsys, "run", "panda_pick", "--mode", "hologram")
    assert said.status == 1 and "unknown mode" in said.err
    assert not list(here.glob("runs/*"))


@pytest.mark.slow
def test_a_task_that_turns_out_impossible_is_reported_like_any_failure(capsys, here):
    text = (
        "robot: panda\nstart: {arm: home, hand: open}\nobjects:\n"
        "  table: {box: [1, 1, 0.1], pose: [0.5, 0, -0.051]}\n"
        "  post: {cylinder: [0.005, 0.2], pose: [0.4, 0.3, 0.1]}\n"
        "  cube: {box: [0.05, 0.05, 0.05], pose: [0.5, 0, 0.024], movable: true}\n"
        "task: [{pick: cube}, {place: {object: cube, on: post}}]\n"
    )
    said = call(capsys, "run", cell_file(here, text), *FAKE, "--json", "out.json")
    assert said.status == 1 and "does not fit on 'post'" in said.words + said.err
    assert "lift" in [s["name"] for s in read_json(here / "out.json")["stages"]]
    assert list(here.glob("runs/*/report.html"))


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_on_a_full_disk_the_result_is_shown_and_what_is_missing_is_named(capsys, here, monkeypatch):
    folder = here / "runs" / "run"
    folder.mkdir(parents=True)
    monkeypatch.setattr("armcell.records.new_run_folder", lambda root, cell: folder)
    (folder / "report.html.part").symlink_to("/dev/full")
    said = call(capsys, "run", cell_file(here), *FAKE, "--json", "out.json")
    assert said.status == 1 and "move to extended" in said.words and "success (seed 3)" in said.words
    assert "report.html: cannot be written: No space left on device (the run itself ended" in said.err
    assert left_in(here) == {"cell.yaml", "out.json", "runs/run/result.json", "runs/run/run.mcap"}
    assert read_json(folder / "result.json") == read_json(here / "out.json")
    (folder / "run.mcap.part").symlink_to("/dev/full")
    said = call(capsys, "run", cell_file(here), *FAKE)
    assert nothing_ran(said) and "no record can be begun: No space left on device (make room" in said.err


def test_json_is_written_whole_or_not_at_all(tmp_path):
    file = tmp_path / "out.json"
    write_json(file, {"first": 1})
    with pytest.raises(ValueError):
        write_json(file, {"second": float("nan")})
    with pytest.raises(TypeError):
        write_json(file, {"third": object()})
    assert json.loads(file.read_text()) == {"first": 1}
    assert left_in(tmp_path) == {"out.json"}
