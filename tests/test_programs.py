"""A program that is forked behaves as one that a new interpreter runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
from tests import programs
from tests.programs import Program

import armcell.cli.main  # noqa: F401  (it sets environment variables, as in the server)

pytestmark = pytest.mark.slow

REPORT = """
import json, os, signal, sys, threading
numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGPIPE, signal.SIGCHLD)
print(json.dumps([
    __name__, sys.argv, sys.path, os.getcwd(), sorted(os.environ.items()), sys.stdin.read(),
    [str(signal.getsignal(n)) for n in numbers], signal.set_wakeup_fd(-1), threading.active_count(),
    os.getsid(0) == os.getpid(), os.nice(0), sorted(int(n) for n in os.listdir("/proc/self/fd"))[:3],
    [(s.line_buffering, s.write_through, s.encoding, s.errors) for s in (sys.stdout, sys.stderr)],
]))
"""


@pytest.mark.parametrize("words", [["-c", REPORT], ["report.py"], ["-u", "report.py"]], ids="cfu")
def test_a_program_sees_what_it_sees_in_a_new_interpreter(tmp_path, words):
    (tmp_path / "report.py").write_text(REPORT)
    options = {
        "cwd": tmp_path,
        "capture_output": True,
        "text": True,
        "input": "in",
        "start_new_session": True,
    }
    environment = {**os.environ, "ROS_IP": "127.0.0.9"}
    forked, new = (
        run([sys.executable, *words, "a", "b"], env=environment, **options)
        for run in (programs.run, subprocess.run)
    )
    assert (forked.stdout, forked.stderr) == (new.stdout, new.stderr) and new.stdout


@pytest.mark.cases("import sys; *", "1 / 0", "import atexit*", "import os; os._exit(7)")
@pytest.mark.parametrize(
    "code",
    [
        "", "import sys; sys.exit(3)", "import sys; sys.exit('words')", "raise SystemExit", "1 / 0",
        "raise KeyboardInterrupt", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)",
        "import os; os.abort()", "import os; os._exit(7)", "import atexit; atexit.register(print, 'last')",
        "import threading, time; threading.Thread(target=lambda: (time.sleep(0.2), print('end'))).start()",
    ],
)  # fmt: skip
def test_a_program_ends_as_in_a_new_interpreter(code):
    command = [sys.executable, "-c", code]
    forked, new = (run(command, capture_output=True, text=True) for run in (programs.run, subprocess.run))
    assert (forked.returncode, forked.stdout) == (new.returncode, new.stdout)
    assert forked.stderr.splitlines()[-1:] == new.stderr.splitlines()[-1:]  # the traceback's frames differ


def test_modules_are_run_and_python_finds_theirs(tmp_path):
    (tmp_path / "mine.py").write_text("import sys; print(__name__, sys.argv, __spec__.name, sys.path[0])")
    options = {"cwd": tmp_path, "capture_output": True, "text": True}
    forked, new = (
        run([sys.executable, "-m", "mine", "x"], **options) for run in (programs.run, subprocess.run)
    )
    assert forked.stdout == new.stdout and "mine" in new.stdout


def test_programs_are_forked_also_after_an_import_has_set_its_variables(monkeypatch):
    monkeypatch.setenv("LD_LIBRARY_PATH", "/as/cv2/sets/it:")
    process = Program([sys.executable, "-c", "print('up')"], stdout=subprocess.PIPE, text=True)
    assert process._request is not None and process.communicate(timeout=60)[0] == "up\n"


def test_signals_waits_and_unbuffered_output():
    command = [sys.executable, "-u", "-c", "import time\nprint('up')\ntime.sleep(60)"]
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        process = Program(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert process._request is not None and process.stdout is not None
        assert process.stdout.readline() == "up\n" and process.poll() is None
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.05)
        process.send_signal(number)
        process.communicate(timeout=20)
        assert process.returncode == -number and process.poll() == -number
        end = time.monotonic() + 5.0
        while time.monotonic() < end and os.path.exists(f"/proc/{process.pid}"):
            time.sleep(0.01)
        assert not os.path.exists(f"/proc/{process.pid}")


@pytest.mark.parametrize(
    "changed", [{"MUJOCO_GL": "off"}, {"PYTHONHASHSEED": "1"}, {"PYTHONPATH": "/nowhere"}]
)
def test_what_imports_read_needs_a_new_interpreter(changed):
    process = Program([sys.executable, "-c", ""], env={**os.environ, **changed})
    assert process._request is None and process.wait() == 0
