"""Ctrl-C ends at once, with status 130, without a traceback, and leaves no process and no port."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest
from tests.cli.helpers import cell_file, finished, start

import armcell

AT_ONCE = 20.0  # [s]

# A ring around the flange, narrower than the hand: there is no way to the cube, planning goes on.
PRISON = """
robot: panda
start: {arm: home, hand: open}
padding: 0.0
settings: {planning_time: 60, planning_budget: 60}
objects:
  table: {box: [2, 2, 0.04], pose: [0, 0, -0.021]}
  ring:
    pose: [0.307, 0, 0.635]
    shapes:
      - {box: [0.17, 0.01, 0.01], pose: [0, 0.08, 0]}
      - {box: [0.17, 0.01, 0.01], pose: [0, -0.08, 0]}
      - {box: [0.01, 0.15, 0.01], pose: [0.08, 0, 0]}
      - {box: [0.01, 0.15, 0.01], pose: [-0.08, 0, 0]}
  cube: {box: [0.05, 0.05, 0.05], pose: [0.5, 0, 0.024], movable: true, mass: 0.1}
task: [{pick: cube}]
"""


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Numba has compiled everything: in its callbacks a Ctrl-C is lost."""
    cell = armcell.load("panda_pick")
    with cell.connect("sim", seed=0) as live:
        assert live.arm.pick("cube").ok
        assert live.arm.place("cube", on="tray").ok


def until(condition, process, timeout: float = 60.0) -> None:
    end = time.monotonic() + timeout
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end, "it did not get that far"
        time.sleep(0.02)


def interrupted(process) -> None:
    """Ctrl-C now: what must be true of it wherever the program is."""
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    said = finished(process, 30)
    assert time.monotonic() - began < AT_ONCE
    assert said.status == 130
    assert said.err.splitlines()[-1] == "armcell: interrupted"
    assert "Traceback" not in said.err and "internal error" not in said.err
    assert "success" not in said.out


def listens(port: int) -> bool:
    """Whether a page answers; without its token it refuses."""
    try:
        urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=2).close()
    except urllib.error.HTTPError as error:
        return error.code == 403
    except OSError:
        pass
    return False


def recording(folder) -> bool:
    """Whether a run has begun: its record is open."""
    return any(folder.glob("*/run.mcap*"))


@pytest.mark.slow
def test_while_the_arm_moves_in_real_time(tmp_path):
    process = start("run", "panda_pick", "--time-scale", "1", "--runs", tmp_path)
    until(lambda: recording(tmp_path), process)
    time.sleep(1.0)
    interrupted(process)
    assert not list(tmp_path.glob("*/report.html"))


@pytest.mark.slow
def test_while_it_plans(tmp_path):
    cell_file(tmp_path, PRISON)
    process = start("run", tmp_path, "--runs", tmp_path / "runs")
    until(lambda: recording(tmp_path / "runs"), process)
    time.sleep(2.0)
    interrupted(process)


@pytest.mark.slow
def test_with_the_view_open_the_port_is_free_again(tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    process = start("run", "panda_pick", "--view", "--port", port, "--runs", tmp_path)
    until(lambda: listens(port), process)
    time.sleep(0.5)
    interrupted(process)
    assert not listens(port)


SIGNAL_AT_IMPORT = """
import os, runpy, signal, sys

class CtrlC:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, CtrlC())
sys.argv = ["armcell", "check", "panda_pick"]
runpy.run_module("armcell", run_name="__main__")
"""


@pytest.mark.slow
@pytest.mark.cases("lxml.etree", "typer")
@pytest.mark.parametrize(
    "module",
    [
        "typer",
        "lxml.etree",
        "mujoco",
    ],
)
def test_while_it_loads(module):
    """Libraries load for a second or two, which is when a mistyped command is taken back."""
    code = SIGNAL_AT_IMPORT.format(module=module)
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in process.stderr
    assert process.stdout == ""


@pytest.mark.slow
def test_while_the_planning_panel_is_open():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    process = start("view", "panda_pick", "--port", port)
    until(lambda: listens(port), process)
    time.sleep(0.5)
    interrupted(process)
    assert not listens(port)


@pytest.mark.parametrize("again", [False, True])
def test_an_orderly_end_may_take_its_time_unless_asked_again(again):
    text = """import signal, time
from armcell import _interrupts as interrupts
interrupts.install()
interrupts.take_time(0.1)  # nothing was interrupted
time.sleep(0.3)
try:
    signal.raise_signal(signal.SIGINT)
    time.sleep(1)
except KeyboardInterrupt:
    interrupts.take_time()
time.sleep(interrupts.GRACE + 0.5)
if AGAIN:
    signal.raise_signal(signal.SIGINT)
    time.sleep(2)
print("orderly")
""".replace("AGAIN", str(again))
    process = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=30)
    assert (process.stdout, process.returncode) == (("", 130) if again else ("orderly\n", 0))
