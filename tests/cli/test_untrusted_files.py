"""Files from other people: looking at them runs nothing, and what runs is said before."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import pytest
from tests import programs
from tests.cli.helpers import call, finished, start

import armcell
from armcell.cell import task_run
from armcell.cli import doctor
from armcell.core import InputError
from armcell.model.xacro import ALLOW_ENV
from armcell.records import read_record

ROBOT = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<link name="tip"><inertial><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.3"/><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="10"/></joint>
HERE</robot>"""
SRDF = """<robot name="r"><group name="arm"><chain base_link="base" tip_link="tip"/></group>
<group_state name="home" group="arm"><joint name="j" value="0"/></group_state></robot>"""
FILES = {
    "r.urdf.xacro": ROBOT.replace("HERE", ""),
    "r.srdf": SRDF,
    "joint_limits.yaml": "joint_limits: {j: {has_acceleration_limits: true, max_acceleration: 2.0}}\n",
    "robot.yaml": "urdf: r.urdf.xacro\nsrdf: r.srdf\njoint_limits: joint_limits.yaml\n",
    "cell.yaml": "robot: .\nscript: task.py\n",
    "task.py": "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n"
    "def task(cell):\n    cell.ctx.emit('note', 'task')\n",
}
SPAWN = "[c for c in ().__class__.__base__.__subclasses__() if c.__name__ == 'Popen'][0](['touch', 'MARK'])"
ATTACKS = [
    "${(lambda: " + SPAWN + ")()}",
    "${[" + SPAWN + " for x in [1]]}",
    "${list(map(lambda x: " + SPAWN + ", [1]))}",
    "${__import__('os').system('touch MARK')}",
    "${[].__class__.__base__.__subclasses__()}",
    "${''.join.__globals__}",
    "${xacro.load_yaml.__globals__['os'].system('touch MARK')}",
    "${(lambda: xacro.load_yaml.__globals__['os'].system('touch MARK'))()}",
    "${(lambda: warning.__closure__)()}",
    "${open('MARK', 'w')}",
    "${xacro.abs_filename.__globals__}",
    "$(eval [x for x in [1].__class__.__base__.__subclasses__])",
    "<xacro:property name=\"p\" value=\"(lambda: __import__('os').system('touch MARK'))(0)\"/>$(eval ${p})",
    '<xacro:property name="f" value="{0.__class__.__base__}"/>${f.format(1)}',
    '<xacro:property name="f" value="{0.__init__.__globals__}"/>${f.format(xacro.load_yaml)}',
    "${xacro.load_yaml('/etc/passwd')}",
    "${xacro.load_yaml('evil.yaml')}",
    "${9**9**9}",
    '<xacro:include filename="/etc/fstab"/>',
    "$(env HOME)",
]


@pytest.fixture
def cell(tmp_path, monkeypatch) -> Path:
    monkeypatch.delenv(ALLOW_ENV, raising=False)
    folder = tmp_path / "cell"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / "evil.yaml").write_text(f"a: !!python/object/apply:os.system ['touch {folder}/MARK']\n")
    return folder


@pytest.fixture
def record(cell, tmp_path, capsys, monkeypatch) -> Path:
    """A recorded run of the cell."""
    assert call(capsys, "run", cell, "--mode", "fake", "--runs", tmp_path / "runs").status == 0
    (cell / "ran").unlink()
    monkeypatch.setattr(task_run, "_announced", set())
    (found,) = (tmp_path / "runs").glob("*/run.mcap")
    return found


def attack(cell: Path, text: str) -> None:
    text = text.replace("MARK", str(cell / "MARK"))
    if not text.startswith("<"):
        text = f"<link>{text}</link>" if '"' in text else f'<link name="{text}"/>'
    (cell / "r.urdf.xacro").write_text(ROBOT.replace("HERE", text))


@pytest.mark.slow
def test_a_robot_from_another_person_runs_nothing(cell, record, tmp_path, capsys, within, monkeypatch):
    monkeypatch.setattr(doctor, "cache", tuple)  # reads no file of the cell, but every file of the cache
    commands = [
        ("setup", cell / "r.urdf.xacro", "-o", tmp_path / "new", "--samples", 100),
        ("check", cell),
        ("doctor", cell),
        ("replay", record.parent),
        ("replay", record.parent, "--execute", "--anyway"),
        ("run", cell, "--mode", "fake", "--runs", tmp_path / "more"),
    ]
    for text in ATTACKS:
        attack(cell, text)
        for command in commands:
            with within(30):
                said = call(capsys, *command)
            words = said.err + said.out
            assert (said.status == 1 and "r.urdf.xacro" in words) or "evil.yaml" in words, (
                text,
                command,
                words,
            )
            assert not (cell / "MARK").exists() and not (cell / "ran").exists()
        with pytest.raises(InputError):
            armcell.load(cell)
        with pytest.raises(InputError):
            armcell.load_robot(cell / "r.urdf.xacro")
        assert not (cell / "MARK").exists()


def test_the_environment_by_option(cell, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("TOOL", "drill")
    monkeypatch.setenv(ALLOW_ENV, "")  # put back afterwards
    attack(cell, "$(env TOOL)")
    said = call(capsys, "check", cell)
    assert said.status == 1 and "--allow-env" in said.err and "drill" not in said.err
    said = call(capsys, "--allow-env", "check", cell)
    assert "root links" in said.err and "drill" in said.err  # it is a second root: the name was read


@pytest.mark.slow
def test_looking_at_a_cell_or_record_does_not_run_its_script(cell, record, tmp_path, capsys):
    second = tmp_path / "runs" / "again"
    second.mkdir()
    (second / "run.mcap").write_bytes(record.read_bytes())
    for command in (("check", cell), ("doctor", cell), ("diff", record.parent, second), ("cells",)):
        call(capsys, *command)
        assert not (cell / "ran").exists(), command
    process = start("replay", record.parent, "--port", 8951)
    try:
        assert process.stdout is not None and "http" in process.stdout.readline()
    finally:
        process.terminate()
        finished(process)
    assert not (cell / "ran").exists()


@pytest.mark.slow
def test_what_will_run_is_said_before(cell, record, tmp_path, capsys, monkeypatch, caplog):
    """By every command that runs a cell's script: the script looks whether it was."""
    (cell / "task.py").write_text(
        "from pathlib import Path\nfrom armcell.cell import task_run\n"
        "assert Path(__file__) in task_run._announced\n" + FILES["task.py"]
    )
    commands = [
        ("run", cell, "--mode", "fake", "--runs", tmp_path / "more"),
        ("replay", record.parent, "--execute", "--anyway", "--runs", tmp_path / "more"),
    ]
    for command in commands:
        monkeypatch.setattr(task_run, "_announced", set())
        caplog.clear()
        assert call(capsys, *command).status in (0, 1) and (cell / "ran").exists()
        (line,) = [m for m in caplog.messages if "runs Python code" in m]
        assert line.endswith(f": {cell / 'task.py'}") and "record" not in line
        (cell / "ran").unlink()


def test_campaigns_say_what_will_run_before_their_workers_do(cell, tmp_path, caplog, monkeypatch):
    from armcell import campaigns

    monkeypatch.setattr(task_run, "_announced", set())
    store = campaigns.begin(campaigns.CampaignSpec(str(cell), trials=2), tmp_path / "runs")
    store.close()
    expected = [f"armcell runs Python code of this cell: {cell / 'task.py'}"]
    assert [m for m in caplog.messages if "Python code" in m] == expected and not (cell / "ran").exists()
    monkeypatch.setattr(task_run, "_announced", set())
    caplog.clear()
    campaigns.resume(store.folder).close()
    assert [m for m in caplog.messages if "Python code" in m] == expected and not (cell / "ran").exists()


@pytest.mark.slow
def test_a_record_from_another_person_is_named_as_one(cell, record, tmp_path, capsys, monkeypatch, caplog):
    from armcell.records import reexecution

    found = read_record(record.parent)
    found.metadata["machine"] = "eve\x1b[2J x86_64"
    reexecution.checked_cell(found)
    (line,) = [m for m in caplog.messages if "Python code" in m]
    assert "named by a record from another computer, eve?[2J x86_64" in line and str(cell / "task.py") in line
    monkeypatch.setattr(task_run, "_announced", set())
    caplog.clear()
    monkeypatch.setattr("os.getuid", lambda: 4711)
    reexecution.checked_cell(read_record(record.parent))
    assert "another user's record" in caplog.text


@pytest.mark.slow
def test_armcell_s_own_cells_are_not_announced(caplog, monkeypatch):
    monkeypatch.setattr(task_run, "_announced", set())
    caplog.set_level(logging.INFO)
    own = [name for name in armcell.cell.cell_names() if armcell.load(name).spec.script is not None]
    assert own
    task_run.announce_code(armcell.load(own[0]))
    assert "Python code" not in caplog.text


CAMPAIGN = """
from pathlib import Path
from armcell import campaigns

store = campaigns.begin(campaigns.CampaignSpec("cell.yaml", trials=1), Path("r"))
campaigns.run(store, workers=1)
print(len(store.rows))
"""


@pytest.mark.slow
def test_modules_in_the_current_folder_are_not_imported(cell):
    """Commands are run in a folder that holds another person's cell, and start Python processes."""
    for name in ("numpy", "json", "armcell", "yaml"):
        mark = "from pathlib import Path\nPath(__file__).with_suffix('.imported').touch()\n"
        (cell / f"{name}.py").write_text(mark)
    done = programs.run(
        [sys.executable, "-P", "-c", CAMPAIGN],
        cwd=cell,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.stdout.strip().endswith("1"), done.stderr
    assert not list(cell.glob("*.imported"))
