"""Output that cannot be written, and terminals that do not have every character: never a traceback."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from tests import programs
from tests.cli.helpers import call, cell_file, start

ARMCELL = f"{sys.executable} -m armcell"


def shell(command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command line; A stands for armcell."""
    text = command.replace("A ", f"{ARMCELL} ", 1)
    return subprocess.run(
        ["bash", "-c", text], capture_output=True, text=True, errors="replace", timeout=120,
        env={**os.environ, **environment},
    )  # fmt: skip


def quiet(done: subprocess.CompletedProcess[str]) -> None:
    for trace in ("Traceback", "Exception ignored", "Error:", "internal error", "Logging error"):
        assert trace not in done.stdout + done.stderr, done


@pytest.mark.slow
@pytest.mark.cases("A cells >&--0-", "A cells >/dev/full-1-*")
@pytest.mark.parametrize(
    ("command", "status", "says"),
    [
        ("A cells >&-", 0, ""),
        ("A cells 2>&-", 0, ""),
        ("A cells <&- >&- 2>&-", 0, ""),
        ("A --help >&-", 0, ""),
        ("A check nope >&-", 1, "unknown cell 'nope'"),
        ("A check nope 2>&-", 1, ""),
        ("A check nope 2>/dev/full", 1, ""),
        ("A --nope 2>/dev/full", 2, ""),
        ("A cells >/dev/full", 1, "armcell: standard output cannot be written: No space left on device\n"),
        (
            "A --version >/dev/full",
            1,
            "armcell: standard output cannot be written: No space left on device\n",
        ),
        ("A --help >/dev/full", 1, "armcell: standard output cannot be written: No space left on device\n"),
        ("A cells >/dev/full 2>&1", 1, ""),
        ("A cells 2>&1 >&-", 0, ""),
    ],
)
def test_streams_that_are_closed_or_full(command, status, says):
    done = shell(command)
    quiet(done)
    assert done.returncode == status and says in done.stderr, done
    assert says or not done.stderr


def test_a_reader_that_goes_away():
    """`armcell cells | head -1`, whatever the pipe still takes."""
    reader, writer = os.pipe()
    os.close(reader)
    done = programs.run(
        [sys.executable, "-m", "armcell", "cells"], stdout=writer, stderr=subprocess.PIPE, text=True
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")  # as of a program that SIGPIPE ended


@pytest.mark.slow
def test_a_served_cell_ends_in_order_when_nobody_reads_any_more(tmp_path):
    server = start("serve", "panda_pick", "--unity", "--port", 0, "--mode", "fake", "--runs", tmp_path)
    assert server.stdout is not None and server.stderr is not None
    assert "Unity can connect" in server.stdout.readline()
    server.stdout.close()
    # What it prints next finds no reader: a client that comes is told of on a line.
    from armcell.ros import Bus
    from armcell.ros.tcp import ForwardedNames, RosTcpClient

    port = int(_port_of(server.pid))
    with RosTcpClient(Bus(), "127.0.0.1", port, ForwardedNames()):
        assert server.wait(30) == 141
    assert "Traceback" not in server.stderr.read()
    assert list(tmp_path.glob("*/run.mcap"))


def _port_of(pid: int) -> str:
    """The TCP port that a process listens on."""
    inodes = {os.readlink(f"/proc/{pid}/fd/{fd}") for fd in os.listdir(f"/proc/{pid}/fd")}
    for line in open(f"/proc/{pid}/net/tcp"):  # noqa: SIM115
        words = line.split()
        if words[3] == "0A" and f"socket:[{words[9]}]" in inodes:
            return str(int(words[1].split(":")[1], 16))
    raise AssertionError("it listens on nothing")


NOT_ASCII = """
description: "Ein Tisch für zwei, 30 °C — 机器人"
robot: panda
start: {arm: home}
objects:
  würfel: {box: [0.05, 0.05, 0.05], pose: [0.5, 0, 0.5], movable: true, mass: 0.1}
task: [{move: extended}]
"""


@pytest.mark.long
@pytest.mark.parametrize(
    "environment",
    [
        {"PYTHONIOENCODING": "latin-1"},
        {"PYTHONIOENCODING": "ascii"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
    ids=["latin-1", "ascii", "C"],
)
def test_terminals_without_every_character(environment, tmp_path):
    file = cell_file(tmp_path, NOT_ASCII)
    done = shell(f"A check {file}", **environment)
    quiet(done)
    assert done.returncode == 0 and "rfel" in done.stdout
    done = shell(f"A check {tmp_path}/кошка.yaml", **environment)
    quiet(done)
    assert done.returncode == 1 and ".yaml" in done.stderr


@pytest.mark.slow
@pytest.mark.cases("run")
@pytest.mark.parametrize("command", ["run", "campaign"])
def test_a_run_in_an_ascii_locale(command, tmp_path):
    """Cell files, records, reports and campaign folders are UTF-8, whatever the terminal is."""
    file = cell_file(tmp_path, NOT_ASCII)
    more = "--trials 2 --workers 1" if command == "campaign" else "--mode fake"
    done = shell(
        f"A {command} {file} {more} --runs {tmp_path}/läufe --json {tmp_path}/r.json",
        LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0",
    )  # fmt: skip
    quiet(done)
    assert done.returncode == 0, done


@pytest.mark.parametrize(
    ("suffix", "text", "says"),
    [
        ("obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "vertices of shape"),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "mesh"),
        ("off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "outside the range of its vertices"),
        ("obj", "v 1e400 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
    ],
)
def test_broken_meshes_are_one_line(suffix, text, says, tmp_path, capsys):
    (tmp_path / f"part.{suffix}").write_text(text)
    cell = "robot: panda\nstart: {arm: home}\nobjects:\n  part: {mesh: part.SUFFIX, pose: [1, 0, 1]}\n"
    file = cell_file(tmp_path, cell.replace("SUFFIX", suffix))
    said = call(capsys, "check", file)
    assert said.status == 1 and says in said.err and len(said.err.splitlines()) == 1, said
