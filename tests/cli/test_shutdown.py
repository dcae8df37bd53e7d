"""SIGTERM and Ctrl-C end every command that can run long: in time, in order, with a status of their own."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from tests import programs
from tests.cli.helpers import Said, cell_file, finished, start
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts, free_port
from tests.programs import Program

from armcell.cell.built_in import LIBRARY
from armcell.records import read_record
from armcell.ros.ros1.xmlrpc import call_method

TERM, INT = signal.SIGTERM, signal.SIGINT
AT_ONCE = 20.0  # [s] limit on a busy machine; an idle one takes below 2 s
WITH_ARMS = 40.0  # [s] while an arm moves
LAST_LINE = {TERM: "armcell: terminated", INT: "armcell: interrupted"}

# --- neither signal gets lost ---
LOST = """
import ctypes, gc, os, signal, sys, time, weakref
from armcell import _interrupts

def fire(*_):
    global fired
    if not fired:
        fired = True
        os.kill(os.getpid(), number)
        sum(range(100_000))  # the handler runs here

class Dying:
    def __del__(self):
        fire()

def swallowed_by(what):
    if what == "gc":
        gc.callbacks.append(fire)
        gc.collect()
    elif what == "del":
        Dying()
    elif what == "weakref":
        one = Dying.__base__.__subclasses__  # anything that is alive
        class Referred: pass
        one = Referred()
        reference = weakref.ref(one, fire)
        del one
    elif what == "ctypes":
        ctypes.CFUNCTYPE(None)(fire)()
    elif what == "except":
        try:
            fire()
        except:
            pass

def waits(how):
    end = time.monotonic() + 8.0
    if how == "works":
        while time.monotonic() < end:
            pass
    elif how == "sleeps":
        time.sleep(8.0)
    else:
        _interrupts.sleep(8.0)

kinds = [(w, h) for w in ("gc", "del", "weakref", "ctypes", "except") for h in ("works", "sleeps", "watches")]
lost = []
for one in range(50):
    what, how = kinds[one % len(kinds)]
    number = (signal.SIGTERM, signal.SIGINT)[one % 2]
    child = os.fork()
    if child == 0:
        fired = False
        _interrupts.install()
        try:
            swallowed_by(what)
            waits(how)
        except _interrupts.Interrupted:
            os._exit(_interrupts.status())
        os._exit(0)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status != 128 + number:
        lost.append((what, how, number, status))
print(lost)
"""


@pytest.mark.slow
def test_a_signal_that_python_swallows_is_not_lost():
    done = subprocess.run([sys.executable, "-c", LOST], capture_output=True, text=True, timeout=120)
    assert done.stdout == "[]\n" and done.stderr == ""


IN_A_CALLBACK = """
import gc, os, sys
collections = 0
def fire(phase, info):
    global collections
    collections += "armcell.cell" in sys.modules  # the command is under way
    if collections == 1:  # a command collects garbage a few times only
        os.kill(os.getpid(), {number})
        sum(range(100_000))
gc.callbacks.append(fire)
from armcell.__main__ import main
sys.argv = ["armcell", "check", "panda_pick"]
main()
"""


@pytest.mark.slow
@pytest.mark.cases("2")
@pytest.mark.parametrize("number", [TERM, INT])
def test_a_command_interrupted_in_a_garbage_collection(number):
    code = IN_A_CALLBACK.format(number=int(number))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 128 + number, (done.stdout, done.stderr)
    assert done.stderr.splitlines() == [LAST_LINE[number]]


def test_an_interrupted_wait_may_wait_again_while_it_ends_in_order():
    """In a `finally` the waits wait; the holder of a `SteadyLock` is not interrupted."""
    code = """
import os, signal, time
from armcell import _interrupts as i
i.install()
lock = i.SteadyLock()
try:
    with lock:
        os.kill(os.getpid(), signal.SIGTERM)
        i.sleep(0.3)
        print("whole", flush=True)
    print("not reached")
except i.Interrupted:
    began = time.monotonic()
    i.sleep(2.0)
    print("rested", time.monotonic() - began >= 2.0, flush=True)
i.end()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (done.stdout, done.returncode) == ("whole\nrested True\n", 143)


@pytest.mark.slow
@pytest.mark.parametrize("handler", ["ignore", "own"])
def test_a_program_that_uses_armcell_keeps_its_handlers(handler):
    code = f"""
import signal, os, time
told = []
signal.signal(signal.SIGTERM, lambda *_: told.append(1))
before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
import armcell
cell = armcell.load("panda_pick")
with cell.connect("fake") as live:
    os.kill(os.getpid(), signal.SIGTERM)
    assert live.arm.move_to("home").ok
assert told == [1] and before == [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)], {handler!r}
"""
    programs.run([sys.executable, "-c", code], check=True, timeout=120)


# --- every command ---
class Running:
    """`armcell ARGUMENTS` in a process group of its own; what it says is read as it comes."""

    def __init__(self, *arguments: object, **options):
        self.process = start(*arguments, **options)
        self.out: list[str] = []
        self.err: list[str] = []
        self._readers = [
            threading.Thread(target=self._read, args=pair, daemon=True)
            for pair in ((self.process.stdout, self.out), (self.process.stderr, self.err))
        ]
        for reader in self._readers:
            reader.start()

    def _read(self, stream, lines: list[str]) -> None:
        lines.extend(iter(stream.readline, "")) if False else [lines.append(s) for s in stream]

    def until(self, condition, timeout: float = 120.0):
        """Wait for a text on standard output, or for what is true; gives what the condition gave."""
        end = time.monotonic() + timeout
        while True:
            found = re.search(condition, "".join(self.out)) if isinstance(condition, str) else condition()
            if found:
                return found
            assert self.process.poll() is None, ("it ended", self.out, self.err)
            assert time.monotonic() < end, ("it did not get that far", self.out, self.err)
            time.sleep(0.02)

    def ended_by(self, number: signal.Signals, within: float = AT_ONCE) -> Said:
        """Send a signal; what is true of every command afterwards."""
        family = _family(self.process.pid)
        began = time.monotonic()
        self.process.send_signal(number)
        try:
            self.process.wait(60)
        finally:
            self.kill()
        took = time.monotonic() - began
        for reader in self._readers:
            reader.join(5.0)
        said = Said(self.process.returncode, "".join(self.out), "".join(self.err))
        assert said.status == 128 + number, said
        assert said.err.splitlines()[-1:] == [LAST_LINE[number]], said
        assert "Traceback" not in said.err + said.out and "internal error" not in said.err, said
        assert took < within, took
        end = time.monotonic() + 3.0
        while left := [pid for pid in family if _alive(pid)]:
            assert time.monotonic() < end, [Path(f"/proc/{pid}/cmdline").read_bytes() for pid in left]
            time.sleep(0.02)
        return said

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()


def _processor_time(pid: int) -> float:
    """[s]"""
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def _family(pid: int) -> list[int]:
    """The process and all below it."""
    children = [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    for task in Path(f"/proc/{pid}/task").iterdir():
        children += [int(one) for one in (task / "children").read_text().split()]
    return [pid, *(below for child in set(children) for below in _family(child))]


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@contextmanager
def running(*arguments: object, **options):
    command = Running(*arguments, **options)
    try:
        yield command
    finally:
        command.kill()


def port_is_free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        return probe.connect_ex(("127.0.0.1", port)) != 0


def whole_record(runs: Path):
    """The only run's record, which has its footer and no temporary file beside it."""
    (folder,) = runs.iterdir()
    assert not list(folder.glob("*.part"))
    record = read_record(folder)
    assert not record.cut and len(record.states) > 0
    return record


MASTER = """
import sys, time
from armcell.ros.ros1.master import Ros1Master
from armcell.ros.ros1.settings import Ros1Settings
with Ros1Master(Ros1Settings("master", master=sys.argv[1])):
    print("up", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(scope="module")
def master():
    """A ROS master in a process of its own: its address."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        uri = f"http://127.0.0.1:{free.getsockname()[1]}"
    process = Program(
        [sys.executable, "-c", MASTER, uri], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdin is not None
    assert process.stdout.readline() == "up\n"
    yield uri
    process.stdin.close()
    process.wait(10)


@pytest.fixture
def graph(master, monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", master)
    for name in ("ROS_IP", "ROS_HOSTNAME", "ROS_NAMESPACE"):
        monkeypatch.delenv(name, raising=False)
    return master


def nodes_of(uri: str) -> set[str]:
    state = call_method(uri, "getSystemState", "/test", timeout=5.0)
    return {node for kind in state for _, nodes in kind for node in nodes}


@pytest.fixture
def real_cell(tmp_path):
    """six_axis_pick with a real arm, and the arm's address."""
    (host,) = free_hosts(1)
    text = (LIBRARY / "six_axis_pick" / "cell.yaml").read_text()
    text += "\nreal:\n  max_state_age: 0.5\n  watchdog: 0.8\n  arms:\n"
    text += f"    arm: {{host: {host}, port: {free_port()}, model: UR10, gripper: {{kind: socket}}}}\n"
    folder = tmp_path / "cell"
    folder.mkdir()
    return cell_file(folder, text), host


@pytest.mark.slow
def test_run_while_the_arm_moves(tmp_path):
    with running("run", "panda_pick", "--time-scale", "1", "--runs", tmp_path) as command:
        command.until(lambda: list(tmp_path.glob("*/run.mcap.part")))
        time.sleep(1.5)
        command.ended_by(TERM)
    record = whole_record(tmp_path)
    assert record.result is None


@pytest.mark.slow
@pytest.mark.cases("2")
@pytest.mark.parametrize("number", [TERM, INT])
def test_serve_on_all_wires_while_the_arm_moves(number, graph, tmp_path):
    port = free_port()
    wires = ("--unity", "--port", port, "--ros1", "--no-own-master", "--ros2", "--domain", 208)
    runs = tmp_path / "runs"
    with running("serve", "panda_pick", *wires, "--runs", runs, "__name:=cell_served") as command:
        command.until("ROS 2: node")
        assert "/cell_served" in nodes_of(graph)
        script = "{joint_names: [panda_joint1], points: [{positions: [2.0], time_from_start: {sec: 8}}]}"
        sent = start(
            "topic", "pub", "/planned_trajectory", "trajectory_msgs/JointTrajectory", script,
            "--connect", f"127.0.0.1:{port}",
        )  # fmt: skip
        assert finished(sent).status == 0
        time.sleep(1.0)
        said = command.ended_by(number, WITH_ARMS)
    assert "/cell_served" not in nodes_of(graph) and port_is_free(port)
    record = whole_record(runs)
    assert record.result is not None and "report: " in said.err
    first, last = (s.sample().joints["panda_joint1"] for s in (record.states[0], record.states[-1]))
    assert 0.1 < abs(last - first) < 1.9  # it moved, and was stopped on the way
    velocities = record.states[-1].sample().joints.velocities
    assert velocities is not None and abs(velocities).max() < 0.02  # [rad/s] of 0.25


@pytest.mark.long
def test_sim_as_a_ros1_node(graph, tmp_path):
    with running("sim", "panda_pick", "--ros1", "--no-own-master", "--runs", tmp_path) as command:
        command.until("ROS 1: node /armcell_sim")
        assert "/armcell_sim" in nodes_of(graph)
        command.ended_by(TERM)
    assert "/armcell_sim" not in nodes_of(graph)
    whole_record(tmp_path)


SPINS = """
import rospy
rospy.init_node("spinner")
rospy.on_shutdown(lambda: print("hook", rospy.is_shutdown(), flush=True))
print("spins", flush=True)
rospy.spin()
print("returned", rospy.is_shutdown(), flush=True)
"""
SLEEPS = """
import rospy
rospy.init_node("sleeper")
print("sleeps", flush=True)
while not rospy.is_shutdown():
    try:
        rospy.sleep(100.0)
    except rospy.ROSInterruptException:
        print("interrupted", rospy.is_shutdown(), flush=True)
"""
DEAF = """
import time
import rospy
rospy.init_node("deaf")
print("deaf", flush=True)
while True:
    try:
        time.sleep(0.1)
    except:
        pass
"""


@pytest.mark.slow
@pytest.mark.cases("sleep-15", "deaf-2")
@pytest.mark.parametrize("number", [TERM, INT])
@pytest.mark.parametrize(
    ("script", "ready", "after"),
    [
        (SPINS, "spins", "spins\nhook True\nreturned True\n"),
        (SLEEPS, "sleeps", "sleeps\ninterrupted True\n"),
        (DEAF, "deaf", "deaf\n"),
    ],
    ids=["spin", "sleep", "deaf"],
)
def test_scripts_end_as_in_ros(number, script, ready, after, graph, tmp_path):
    """A script that catches everything does not live on either."""
    (tmp_path / "script.py").write_text(script)
    runs, own = tmp_path / "runs", ("--mode", "fake", "--ros1", "--no-own-master")
    command = ("run", tmp_path / "script.py", "--cell", "panda_table", *own, "--runs", runs)
    with running(*command) as process:
        process.until(ready)
        assert "/armcell" in nodes_of(graph)
        time.sleep(0.3)
        said = process.ended_by(number)
    assert said.out == after
    assert "/armcell" not in nodes_of(graph)
    whole_record(runs)


LINK = '<link name="{0}"><collision><geometry><box size=".05 .05 .2"/></geometry></collision>{1}</link>'
INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
JOINT = (
    '<joint name="{0}_{1}" type="revolute"><parent link="{0}"/><child link="{1}"/><origin xyz="0 0 .3"/>'
    '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="1"/></joint>'
)
URDF = (
    "<robot name='two'>" + "".join(LINK.format(n, INERTIAL) for n in "abc")
    + JOINT.format("a", "b") + JOINT.format("b", "c") + "</robot>"
)  # fmt: skip


@pytest.mark.long
def test_pages_end_and_free_their_ports(tmp_path):
    """The three at once: each spends its time in loading."""
    finished(start("run", cell_file(tmp_path), "--runs", tmp_path / "runs"), 120)
    (run,) = (tmp_path / "runs").iterdir()
    urdf = tmp_path / "two.urdf"
    urdf.write_text(URDF)
    pages = {
        "view": ("view", "panda_pick"),
        "replay": ("replay", run),
        "setup": ("setup", urdf, "-o", tmp_path / "new", "--samples", "200", "--web"),
    }
    for number in (TERM, INT):
        if number == INT:
            del pages["view"]  # as in test_interrupt.py
        ports = {name: free_port() for name in pages}
        opened = {name: Running(*words, "--port", ports[name]) for name, words in pages.items()}
        try:
            for name, page in opened.items():
                page.until(rf"http://[^ ]*:{ports[name]}")
                page.ended_by(number)
                assert port_is_free(ports[name])
        finally:
            for page in opened.values():
                page.kill()
    assert not (tmp_path / "new").exists()


@pytest.mark.long
def test_a_campaign_leaves_no_worker_and_can_be_resumed(tmp_path):
    cell = cell_file(tmp_path)
    runs = tmp_path / "runs"
    with running("campaign", cell, "--trials", 100000, "--workers", 2, "--runs", runs) as command:
        command.until(lambda: any(f.stat().st_size > 0 for f in runs.glob("*-campaign-*/trials.jsonl")), 300)
        os.killpg(command.process.pid, 0)
        said = command.ended_by(TERM)
    assert "--resume" in said.err
    (folder,) = runs.iterdir()
    lines = (folder / "trials.jsonl").read_bytes()
    assert lines.endswith(b"\n") and (folder / "report.html").exists()
    done = lines.count(b"\n")
    again = finished(start("campaign", "--resume", folder, "--trials", done + 1, "--workers", 1), 120)
    assert again.status == 0, again


@pytest.mark.slow
def test_a_signal_to_the_whole_group_is_the_campaigns_alone(tmp_path):
    """Workers do not die of it while they start, each with a traceback."""
    with running("campaign", cell_file(tmp_path), "--trials", 1000, "--runs", tmp_path / "runs") as command:
        command.until(lambda: len(_family(command.process.pid)) > 1, 300)
        os.killpg(command.process.pid, INT)  # and once more, as `timeout` does
        command.ended_by(INT)


@pytest.mark.parametrize(("session", "status"), [("x11", 0), ("wayland", 7)])
def test_the_process_that_glfw_s_import_starts_prints_nothing(session, status):
    """It reads its standard input, and prints a traceback if that ends first. For X11 none is started."""
    script = (
        "import os, subprocess; subprocess.Popen.communicate = lambda *a: os._exit(7)\nimport armcell.sim"
    )
    environment = {**os.environ, "XDG_SESSION_TYPE": session}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, timeout=60, env=environment, check=False
    )
    assert (done.returncode, done.stderr) == (status, b"")


@pytest.mark.interop
def test_a_campaign_on_ray_leaves_no_cluster(tmp_path, monkeypatch):
    pytest.importorskip("ray")
    short = Path(f"/tmp/ac{os.getpid()}")  # Ray's sockets want short names
    short.mkdir()
    monkeypatch.setenv("TMPDIR", str(short))
    runs = tmp_path / "runs"
    options = ("--trials", 100000, "--workers", 2, "--ray", "auto", "--runs", runs)
    with running("campaign", cell_file(tmp_path), *options) as command:
        command.until(lambda: any(f.stat().st_size > 0 for f in runs.glob("*-campaign-*/trials.jsonl")), 300)
        assert "--resume" in command.ended_by(TERM, WITH_ARMS).err
    assert not list(short.glob("armcell-ray-*"))


def speed_of(host: str) -> float:
    """Of the emulated arm's fastest joint [rad/s], by RTDE."""
    from armcell.drivers.ur.rtde_client import RtdeClient

    client = RtdeClient(host, 125.0)
    client.connect()
    try:
        assert client.latest is not None
        return float(np.abs(client.latest.actual_qd).max())
    finally:
        client.close()


@pytest.mark.slow
@pytest.mark.parametrize("number", [TERM, INT])
def test_emulated_controllers_close(number):
    hosts = free_hosts(2)
    with running("ur-controller", "--host", hosts[0], "--host", hosts[1]) as command:
        command.until("Ctrl-C ends it")
        assert "Robotmode" in dashboard(hosts[0], "robotmode")[0]
        command.ended_by(number)
    for host in hosts:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, 29999))


@pytest.mark.realtime
@pytest.mark.slow
def test_real_arms_are_at_rest(real_cell, tmp_path):
    """`run`, `twin`, `bringup` and `doctor`, each while the emulated arm moves (doctor: while it looks)."""
    file, host = real_cell
    real = ("--mode", "real", "--without-gate", "an emulator")
    commands = (
        ("run", file, *real, "--runs", tmp_path / "runs"),
        ("bringup", file, "--yes", "--record", tmp_path / "bringup.json"),
        ("twin", file, "--yes"),
    )
    with emulator("--cell", "six_axis_pick", hosts=[host]):
        for words in commands:
            with running(*words) as command:
                command.until(lambda: speed_of(host) > 0.03)
                command.ended_by(TERM, WITH_ARMS)
            assert speed_of(host) < 0.01, words
            time.sleep(0.5)
            assert speed_of(host) < 0.01, words
        assert "protective stop" not in dashboard(host, "armcell messages")[0]
    whole_record(tmp_path / "runs")


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", [("doctor", "panda_pick"), ("bench", "ik", "--robot", "panda", "--count", "200000")]
)
def test_commands_that_compute(words):
    with running(*words) as command:
        # Forked from a program that has imported armcell, a warm doctor takes 0.2 s, and prints when it ends.
        command.until(lambda: _processor_time(command.process.pid) > 0.04)
        command.ended_by(TERM)


@pytest.mark.slow
def test_a_second_signal_ends_at_once(tmp_path):
    """A script's hook takes its time; whoever asks twice does not wait for it."""
    text = (
        "import rospy, time\nrospy.on_shutdown(lambda: time.sleep(60))\nprint(0, flush=True)\nrospy.spin()\n"
    )
    (tmp_path / "s.py").write_text(text)
    with running(
        "run", tmp_path / "s.py", "--cell", "panda_table", "--mode", "fake", "--headless"
    ) as command:
        command.until("0")
        time.sleep(0.3)
        command.process.send_signal(TERM)
        time.sleep(1.0)
        assert command.process.poll() is None
        command.ended_by(TERM, 1.5)
