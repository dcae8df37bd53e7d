"""doctor: what is there, what is not, and the hint; without guessing."""

from __future__ import annotations

import re
import socket
import tomllib
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path

import pytest
from tests.cli.helpers import call, cell_file, read_json

from armcell.cli import doctor
from armcell.cli.doctor import EXTRAS, NEEDED

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def lines(capsys, tmp_path, *arguments) -> dict[str, dict]:
    said = call(capsys, "doctor", *arguments, "--json", tmp_path / "d.json")
    found = read_json(tmp_path / "d.json")
    assert said.status == (1 if any(line["verdict"] == "no" for line in found) else 0)
    assert all(line["found"] in said.words or len(line["found"]) > 150 for line in found)
    return {line["check"]: line for line in found}


def test_the_lists_are_those_of_the_project():
    project = tomllib.loads(PROJECT.read_text())["project"]

    def names(requirements):
        return {re.split(r"[><=\[;]", r)[0].strip() for r in requirements}

    assert set(NEEDED) == names(project["dependencies"])
    users = {k: v for k, v in project["optional-dependencies"].items() if k not in ("dev", "docs")}
    assert {k: set(v) for k, v in EXTRAS.items()} == {k: names(v) for k, v in users.items()}


@pytest.mark.slow
def test_this_machine(capsys, tmp_path):
    found = lines(capsys, tmp_path)
    assert found["packages"]["verdict"] == "ok" and f"numpy {version('numpy')}" in found["packages"]["found"]
    assert "writable" in found["cache folder"]["found"]
    assert {"Python", "machine", "OpenGL", "compiled kernels", "port 10000", "port 11311"} <= set(found)


@pytest.mark.slow
def test_a_port_that_is_taken(capsys, tmp_path, monkeypatch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        number = taken.getsockname()[1]
        monkeypatch.setattr(doctor, "PORTS", {number: "a test"})
        found = lines(capsys, tmp_path)
    assert found[f"port {number}"]["verdict"] == "note" and "taken" in found[f"port {number}"]["found"]


def test_a_cache_that_cannot_be_written(capsys, tmp_path, monkeypatch):
    file = tmp_path / "a file"
    file.write_text("")
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(file / "below"))
    found = lines(capsys, tmp_path)
    assert found["cache folder"]["verdict"] == "no" and "ARMCELL_CACHE_DIR" in found["cache folder"]["found"]


def test_a_file_that_another_process_deletes_meanwhile_does_not_count(tmp_path, monkeypatch):
    (tmp_path / "kept.npz").write_bytes(b"1234")
    walked = [(str(tmp_path), [], ["gone.lock", "kept.npz"])]
    monkeypatch.setattr(doctor.os, "walk", lambda root: iter(walked))
    assert doctor._size_of(tmp_path) == 4


@pytest.mark.slow
def test_a_package_that_is_missing(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "NEEDED", ("numpy", "no-such-package"))
    found = lines(capsys, tmp_path)
    assert (
        found["packages"]["verdict"] == "no" and "pip install no-such-package" in found["packages"]["found"]
    )


# --- endpoints ---
def test_an_endpoint_that_is_up_and_one_that_is_down():
    with socket.socket() as up:
        up.bind(("127.0.0.1", 0))
        up.listen()
        port = up.getsockname()[1]
        assert doctor.check_endpoint(f"127.0.0.1:{port}").verdict == "ok"
    line = doctor.check_endpoint(f"127.0.0.1:{port}")
    assert line.verdict == "no" and "nothing listens there" in line.found


def test_a_wrong_address_and_a_silent_one(monkeypatch):
    line = doctor.check_endpoint("no-such-host.invalid:10000")
    assert line.verdict == "no" and ("wrong address" in line.found or "cannot be reached" in line.found)
    monkeypatch.setattr(doctor, "PATIENCE", 0.3)
    with socket.socket() as silent, ExitStack() as waiting:  # its queue is full: no further one is answered
        silent.bind(("127.0.0.1", 0))
        silent.listen(0)
        for _ in range(4):
            client = waiting.enter_context(socket.socket())
            client.setblocking(False)
            client.connect_ex(silent.getsockname())
        line = doctor.check_endpoint(f"127.0.0.1:{silent.getsockname()[1]}")
    assert line.verdict == "no" and "firewall" in line.found


# --- cells ---
@pytest.mark.slow
def test_a_sound_cell(capsys, tmp_path):
    found = lines(capsys, tmp_path, "panda_pick")
    for check in ("cell file", "start state", "pick cube", "robot's files", "TF tree", "gains"):
        assert found[check]["verdict"] == "ok", found[check]
    assert "panda_joint7" in found["controller arm_controller"]["found"]
    assert found["TF tree"]["found"].startswith("13 frames")


URDF = """<robot name="two">
<link name="base"/>
<link name="arm"><inertial><mass value="MASS"/><origin xyz="0.5 0 0"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>VISUAL
  <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="20"/></joint>
</robot>"""
SRDF = '<robot name="two"><group name="arm"><chain base_link="base" tip_link="arm"/></group></robot>'


@pytest.fixture
def hinge(tmp_path):
    """A cell with one hinge and a weight at its end."""

    def make(mass: float, visual: str = "") -> Path:
        (tmp_path / "two.urdf").write_text(URDF.replace("MASS", str(mass)).replace("VISUAL", visual))
        (tmp_path / "two.srdf").write_text(SRDF)
        return cell_file(tmp_path, "robot: two.urdf\n")

    return make


@pytest.mark.slow
@pytest.mark.cases("6.0-no-147%")
@pytest.mark.parametrize(("mass", "verdict", "share"), [(2.0, "ok", "49%"), (6.0, "no", "147%")])
def test_a_drive_that_is_too_weak(capsys, tmp_path, hinge, mass, verdict, share):
    """20 Nm hold m * 9.81 * 0.5 m: 2 kg take 49 % of them, 6 kg 147 %."""
    found = lines(capsys, tmp_path, hinge(mass))
    assert found["gains"]["verdict"] == verdict and share in found["gains"]["found"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("physics", "check", "verdict", "words"),
    [
        ("{}", "physics step", "ok", "2 ms: hinge is off by"),
        ("{timestep: 0.05, arm_kp: 20000, arm_kv: 2000}", "physics step", "no", "50 ms is too coarse: hinge"),
        ("{arm_kv: 100000}", "drives", "no", "with a finer step as well: look at the gains"),
    ],
)
def test_step_and_drives_are_told_apart(capsys, tmp_path, hinge, physics, check, verdict, words):
    file = hinge(2.0)
    file.write_text(file.read_text() + f"physics: {physics}\n")
    found = lines(capsys, tmp_path, file)
    assert found[check]["verdict"] == verdict and words in found[check]["found"]
    if "too coarse" in words:  # the hint that is named hints
        finer = found[check]["found"].rpartition("timestep: ")[2].partition("`")[0]
        file.write_text(file.read_text().replace("timestep: 0.05", f"timestep: {finer}"))
        assert lines(capsys, tmp_path, file)[check]["verdict"] == "ok"


@pytest.mark.slow
def test_a_mesh_that_is_missing(capsys, tmp_path, hinge):
    mesh = '<visual><geometry><mesh filename="package://gone/arm.stl"/></geometry></visual>'
    found = lines(capsys, tmp_path, hinge(1.0, mesh))
    assert (
        found["robot's files"]["verdict"] == "no"
        and "package://gone/arm.stl" in found["robot's files"]["found"]
    )
