"""Debian's own ROS 1, run by the system's Python: what our node and master are tested against."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import time
from pathlib import Path

import pytest

from armcell.ros import schema

PYTHON = "/usr/bin/python3"
PACKAGES = "python3-rospy python3-rosmaster python3-rostopic python3-actionlib python3-tf2-ros"
TOOLS = "python3-rosservice python3-rosparam python3-rosnode python3-rosmsg"
MODULES = "rospy, rosmaster, rostopic, actionlib, tf2_ros, rosservice, rosparam, rosnode, rosmsg"


def missing() -> str | None:
    """Why real ROS 1 cannot be tested against here; None if it can."""
    if not Path(PYTHON).exists():
        return f"{PYTHON} is not there"
    done = subprocess.run([PYTHON, "-c", f"import {MODULES}"], capture_output=True, text=True)
    if done.returncode == 0:
        return None
    last = (done.stderr.strip().splitlines() or ["it ended badly"])[-1]
    return f"{last}; apt-get install {PACKAGES} {TOOLS}"


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


class Debian:
    """A master's address and programs that use it; `close` ends those that were started."""

    def __init__(self, folder: Path):
        self.folder, self.port = folder, free_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        self.environment = {
            "PATH": "/usr/bin:/bin", "HOME": str(folder), "ROS_LOG_DIR": str(folder),
            "ROS_MASTER_URI": self.uri, "ROS_IP": "127.0.0.1", "PYTHONUNBUFFERED": "1",
        }  # fmt: skip
        self._started: list[subprocess.Popen] = []
        texts = folder / "texts.json"
        known = schema()
        texts.write_text(json.dumps({name: known.full_text(name) for name in known.messages}))
        (folder / "ours.py").write_text(OURS.format(texts=str(texts)))

    def start_master(self) -> subprocess.Popen:
        process = self.start("/usr/bin/rosmaster", "--core", "-p", str(self.port))
        end = time.monotonic() + 20
        while time.monotonic() < end:
            try:
                socket.create_connection(("127.0.0.1", self.port), timeout=1).close()
                return process
            except OSError:
                time.sleep(0.05)
        raise AssertionError("rosmaster did not start")

    def start(self, *arguments: str, **options) -> subprocess.Popen:
        log = (self.folder / f"{len(self._started)}.log").open("w")
        options.setdefault("env", self.environment)
        process = subprocess.Popen(
            arguments, stdout=log, stderr=subprocess.STDOUT, cwd=self.folder, **options
        )
        self._started.append(process)
        return process

    def start_rospy(self, script: str, *arguments: str) -> subprocess.Popen:
        return self.start(PYTHON, "-c", script, *arguments)

    def log(self, process: subprocess.Popen) -> str:
        return (self.folder / f"{self._started.index(process)}.log").read_text()

    def stop(self, process: subprocess.Popen) -> None:
        process.terminate()
        try:
            process.wait(15)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(5)

    def run(self, *arguments: str, timeout: float = 30.0) -> str:
        """A tool's output; it must succeed."""
        assert shutil.which(arguments[0], path="/usr/bin:/bin")
        done = subprocess.run(
            arguments, env=self.environment, capture_output=True, text=True, timeout=timeout, cwd=self.folder
        )
        assert done.returncode == 0, f"{arguments}: {done.stdout}{done.stderr}"
        return done.stdout

    def rospy(self, script: str, *arguments: str, timeout: float = 60.0):
        """What a script printed last, as JSON."""
        done = subprocess.run(
            [PYTHON, "-c", script, *arguments], env=self.environment, capture_output=True, text=True,
            timeout=timeout, cwd=self.folder,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return json.loads(done.stdout.strip().splitlines()[-1])

    def hz(self, topic: str, seconds: float) -> float:
        """What `rostopic hz` says at last."""
        process = self.start("/usr/bin/rostopic", "hz", "--wall-time", topic)
        time.sleep(seconds)
        os.kill(process.pid, 2)
        process.wait(10)
        rates = [line for line in self.log(process).splitlines() if line.startswith("average rate")]
        assert rates, self.log(process)
        return float(rates[-1].split(":")[1])

    def close(self) -> None:
        for process in reversed(self._started):
            if process.poll() is None:
                self.stop(process)


# Types that Debian does not have, made by genpy itself from our definitions' texts: its sums and its bytes.
OURS = """
import json
from genpy.dynamic import generate_dynamic
TEXTS = json.load(open({texts!r}))
MADE = {{}}
def message(name):
    if name not in MADE:
        MADE.update({{k: v for k, v in generate_dynamic(name, TEXTS[name]).items() if k not in MADE}})
    return MADE[name]
def service(name):
    import hashlib
    request, response = message(name + "Request"), message(name + "Response")
    import genmsg.gentools, genmsg.msg_loader
    class Service:
        _type = name
        _request_class, _response_class = request, response
        _md5sum = None
    return Service
"""


@pytest.fixture(scope="module")
def debian_module(tmp_path_factory):
    if why := missing():
        pytest.skip(f"no real ROS 1: {why}")
    real = Debian(tmp_path_factory.mktemp("ros"))
    yield real
    real.close()


@pytest.fixture
def debian(tmp_path):
    if why := missing():
        pytest.skip(f"no real ROS 1: {why}")
    real = Debian(tmp_path)
    yield real
    real.close()
