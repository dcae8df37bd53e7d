"""Gains of single joints: armcell's own format and ros_control's controllers.yaml."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.cli.helpers import call, read_json

import armcell
from armcell.cell import gains_as_values, with_values
from armcell.core import InputError, UnknownNameError
from armcell.records.reader import read_record
from armcell.sim import PhysicsSettings, SimWorld
from armcell.sim.gain_files import gain_values, with_gains
from armcell.sim.joint_gains import GainTable, JointGains
from armcell.sim.settings import effective_gains

SEEDS = Path(__file__).parents[3] / "shared/seeds"
ELBOW, WRIST = "left_elbow_joint", "left_wrist_3_joint"
ARM = [f"left_{n}_joint" for n in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]


@pytest.fixture(scope="module")
def scene():
    return armcell.load("dual_ur10").scene()


def written(folder: Path, data) -> Path:
    file = folder / "controllers.yaml"
    file.write_text(data if isinstance(data, str) else yaml.safe_dump(data))
    return file


def table(scene, folder: Path, data) -> GainTable:
    return with_gains(PhysicsSettings(), written(folder, data), scene.model).joint_gains


P = {"p": 60.0, "i": 0.5, "d": 1.2, "i_clamp": 4.0}
TRAJECTORY = {"type": "effort_controllers/JointTrajectoryController", "joints": [ELBOW], "gains": {ELBOW: P}}
FORMS = {
    "trajectory controller": {"arm": TRAJECTORY},
    "in a namespace": {"cell": {"arm_left": {"arm": TRAJECTORY}}},
    "position controller of one joint": {
        "elbow": {"type": "effort_controllers/JointPositionController", "joint": ELBOW, "pid": P}
    },
    "group controller": {
        "g": {
            "type": "effort_controllers/JointGroupPositionController",
            "joints": [ELBOW],
            ELBOW: {"pid": P},
        }
    },
    "Gazebo plugin": {"gazebo_ros_control": {"pid_gains": {ELBOW: P}}},
    "Gazebo plugin, flat key": {"/gazebo_ros_control": {"pid_gains": {ELBOW: P}}},
    "ROS 2": {
        "controller_manager": {
            "ros__parameters": {
                "update_rate": 500,
                "arm": {"type": "joint_trajectory_controller/JointTrajectoryController"},
            }
        },
        "arm": {
            "ros__parameters": {"joints": [ELBOW], "command_interfaces": ["effort"], "gains": {ELBOW: P}}
        },
    },
    "ROS 2 with a wildcard": {"/**": {"arm": {"ros__parameters": {"joints": [ELBOW], "gains": {ELBOW: P}}}}},
}


@pytest.mark.parametrize("data", FORMS.values(), ids=FORMS)
def test_every_form_of_ros_control_gives_the_gains(scene, tmp_path, data):
    assert dict(table(scene, tmp_path, data)) == {ELBOW: JointGains(60.0, 0.5, 1.2, 4.0, antiwindup=False)}


def test_a_flat_parameter_path_of_gazebo(scene, tmp_path):
    """`rosparam dump` and many tutorials write the whole path as one key."""
    data = {f"/gazebo_ros_control/pid_gains/{ELBOW}": P, f"gazebo_ros_control/pid_gains/{WRIST}": P}
    assert set(table(scene, tmp_path, data)) == {ELBOW, WRIST}


def test_the_document_s_controllers_yaml(tmp_path, scene, caplog):
    """The dual UR10 document's file, with the line breaks and colons that its text export lost."""
    if not SEEDS.is_dir():
        pytest.skip("../shared/seeds is not there")
    text = (SEEDS / "002_cba75de1d491e95b.txt").read_text()
    block = text[text.index("arm_left_joint_trajectory_controller: type:") :]
    block = block[: re.search(r"left_wrist_3_joint: \{[^}]*\}", block).end()]
    kind = re.search(r"type: (\S+)", block)[1]
    joints = re.findall(r"- (\w+)", block)
    gains = re.findall(r"(\w+): (\{p[^}]*\})", block)
    lines = ["arm_left_joint_trajectory_controller:", f"  type: {kind}", "  joints:"]
    lines += [*(f"    - {j}" for j in joints), "  gains:", *(f"    {j}: {g}" for j, g in gains)]
    found = table(scene, tmp_path, "\n".join(lines))
    assert list(found) == joints == ARM
    assert [g.p for g in found.values()] == [80.0, 80.0, 60.0, 30.0, 30.0, 20.0]
    assert [(g.i, g.d) for g in found.values()][1:4] == [(0.5, 1.5), (0.5, 1.2), (0.2, 0.8)]
    assert "ros_control does not use its gains" in caplog.text and "i = 0.5 does nothing" in caplog.text
    assert "right_elbow_joint" in caplog.text  # keeps the cell's


def test_controllers_of_velocities_are_left_out_and_said(scene, tmp_path, caplog):
    both = {
        "v": {**TRAJECTORY, "type": "velocity_controllers/JointTrajectoryController"},
        "e": {**TRAJECTORY, "gains": {ELBOW: {"p": 7}}},
    }
    assert table(scene, tmp_path, both)[ELBOW].p == 7
    assert "v (velocity_controllers/JointTrajectoryController) is left out" in caplog.text
    with pytest.raises(InputError, match="has no PID gains of an arm joint: v .* left out"):
        table(scene, tmp_path, {"v": both["v"]})


def test_the_gains_that_the_simulator_uses_come_first(scene, tmp_path):
    """With a position interface Gazebo's PID is what drives the joint; with an effort interface it is not."""
    gazebo = {"gazebo_ros_control": {"pid_gains": {ELBOW: {"p": 1000}}}}
    position = {**TRAJECTORY, "type": "position_controllers/JointTrajectoryController"}
    assert table(scene, tmp_path, {"arm": position, **gazebo})[ELBOW].p == 1000
    assert table(scene, tmp_path, {"arm": TRAJECTORY, **gazebo})[ELBOW].p == 60


WRONG = {
    "unknown joint": (
        {"arm": {"joints": ["elbow_joint"], "gains": {"elbow_joint": P}}},
        UnknownNameError, r"arm/gains: unknown joint 'elbow_joint'.*did you mean '\w+_elbow_joint'",
    ),
    "joint that the controller does not have": (
        {"arm": {"joints": [ELBOW], "gains": {"left_elbov_joint": P}}},
        UnknownNameError, f"arm/gains: .*did you mean '{ELBOW}'",
    ),
    "unknown gain": (
        {"arm": {"joints": [ELBOW], "gains": {ELBOW: {"p": 1, "i_clmp": 2}}}},
        UnknownNameError, f"arm/gains/{ELBOW}: unknown gain 'i_clmp'.*did you mean 'i_clamp'",
    ),
    "no p": (
        {"arm": {"joints": [ELBOW], "gains": {ELBOW: {"d": 1}}}}, InputError, f"arm/gains: {ELBOW} lacks p"
    ),
    "not a number": (
        {"arm": {"joints": [ELBOW], "gains": {ELBOW: {"p": "high"}}}},
        InputError, f"{ELBOW}/p is 'high', a number",
    ),
    "negative": (
        {"arm": {"joints": [ELBOW], "gains": {ELBOW: {"p": 1, "d": -2}}}},
        InputError, f"{ELBOW}: d is -2, it must be",
    ),
    "infinite": ({"arm": {"joints": [ELBOW], "gains": {ELBOW: {"p": float("inf")}}}}, InputError, "p"),
    "not a mapping": (
        {"arm": {"joints": [ELBOW], "gains": {ELBOW: 3}}}, InputError, f"{ELBOW} is 3, a mapping such as"
    ),
    "gains not a mapping": ({"arm": {"joints": [ELBOW], "gains": 3}}, InputError, "'gains' is not a mapping"),
    "two controllers": (
        {"a": TRAJECTORY, "b": {**TRAJECTORY, "gains": {ELBOW: {"p": 1}}}},
        InputError, f"b/gains/{ELBOW}: joint '{ELBOW}' has other gains here than in a/gains/{ELBOW}",
    ),
    "no gains": ({"arm": {"joints": [ELBOW]}}, InputError, "has no PID gains of an arm joint"),
}  # fmt: skip


@pytest.mark.parametrize(("data", "error", "words"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_named_with_controller_and_joint(scene, tmp_path, data, error, words):
    with pytest.raises(error, match=words) as caught:
        table(scene, tmp_path, data)
    assert "controllers.yaml: " in str(caught.value)


def test_gains_are_the_law_of_control_toolbox(scene, tmp_path):
    """Effort of every step against a PID written after control_toolbox::Pid::computeCommand."""
    gains = {"p": 800.0, "i": 4000.0, "d": 20.0, "i_clamp": 1.5}
    data = {"arm": {"joints": [ELBOW], "gains": {ELBOW: gains}, "velocity_ff": {ELBOW: 3.0}}}
    settings = with_gains(PhysicsSettings(), written(tmp_path, data), scene.model)
    world = SimWorld(scene, settings)
    start, column = scene.state[ELBOW], world.robot.columns((ELBOW,))[0]
    integral, clamped = 0.0, 0
    for k in range(60):
        target, speed = start + 0.001 * k, 0.5
        state = world.joint_state()
        error = target - state[ELBOW]
        integral += settings.timestep * error
        i_term = float(np.clip(gains["i"] * integral, -1.5, 1.5))
        clamped += abs(i_term) == 1.5
        expected = 800.0 * error + i_term + 20.0 * (speed - state.velocities[column]) + 3.0 * speed
        world.set_arm_target((ELBOW,), [target], [speed])
        world.step()
        assert world.mj_data.actuator(ELBOW).force[0] == pytest.approx(expected, rel=1e-9)
    assert 0 < clamped < 60


@pytest.mark.parametrize("control", ["pid", "position", "torque"])
def test_single_joints_have_their_gains_and_the_others_the_arm_s(scene, control):
    s = PhysicsSettings(arm_control=control, joint_gains=GainTable({ELBOW: JointGains(900.0, d=40.0)}))
    world = SimWorld(scene, s)
    offset = 0.01
    for joint, kp in ((ELBOW, 900.0), (WRIST, 5000.0 * scene.model.joints[WRIST].limits.effort / 50)):
        world.reset()
        world.set_arm_target((joint,), [scene.state[joint] + offset], [0.0])
        world.step()
        assert world.mj_data.actuator(joint).force[0] == pytest.approx(kp * offset, rel=0.35)
    assert effective_gains(scene.model.joints[ELBOW], s)[:3] == (900.0, 0.0, 40.0)


def cell_with(folder: Path, physics: str) -> Path:
    file = folder / "cell.yaml"
    file.write_text(f"robot: dual_ur10\nphysics: {physics}\n")
    return file


def test_the_cell_s_key(tmp_path):
    written(tmp_path, {"arm": {**TRAJECTORY, "joints": [ELBOW, WRIST], "gains": {ELBOW: P, WRIST: P}}})
    cell = armcell.load(
        cell_with(tmp_path, f"{{gains: controllers.yaml, joint_gains: {{{WRIST}: {{p: 5}}}}}}")
    )
    assert cell.physics.arm_control == "torque"
    assert {j: g.p for j, g in cell.physics.joint_gains.items()} == {ELBOW: 60.0, WRIST: 5.0}
    softer = with_values(cell, gains_as_values(cell, "tutorial"))
    assert softer.physics.arm_kp == 80.0 and not softer.physics.joint_gains
    assert armcell.load(cell_with(tmp_path, "{gains: firm, arm_kp: 3000}")).physics.arm_kp == 3000.0


@pytest.mark.parametrize(
    ("physics", "words"),
    [
        ("{gains: fim}", "cell.yaml: physics/gains: unknown set of gains 'fim'.*did you mean 'firm'"),
        ("{gains: none.yaml}", "none.yaml: file not found"),
        ("{gains: 3}", "physics/gains: gains is 3, a name or a file is needed"),
        (
            "{joint_gains: {elbow_joint: {p: 3}}}",
            r"physics/joint_gains: unknown arm joint .*did you mean '\w+elbow",
        ),
        (
            f"{{joint_gains: {{{ELBOW}: {{kp: 3}}}}}}",
            f"physics/joint_gains/{ELBOW}: unknown gain 'kp'",
        ),
        (f"{{joint_gains: {{{ELBOW}: {{p: 3, i: 1}}}}}}", "arm_control: torque"),
        ("{joint_gains: 3}", "joint_gains is 3, a mapping"),
    ],
)
def test_wrong_keys_of_the_cell(tmp_path, physics, words):
    with pytest.raises(InputError, match=words):
        armcell.load(cell_with(tmp_path, physics))


def test_own_format_of_a_file(tmp_path, scene):
    file = written(
        tmp_path, {"arm_control": "torque", "arm_kp": 70.0, "joint_gains": {ELBOW: {"p": 9, "i": 2}}}
    )
    assert gain_values(file, scene.model)["arm_kp"] == 70.0
    assert with_gains(PhysicsSettings(), file, scene.model).joint_gains[ELBOW] == JointGains(9.0, 2.0)
    file.write_text("joint_gains: {left_elbov_joint: {p: 1}}\n")
    with pytest.raises(UnknownNameError, match=f"joint_gains: unknown arm joint .*did you mean '{ELBOW}'"):
        gain_values(file, scene.model)


@pytest.mark.slow
def test_the_commands_take_a_controllers_file(capsys, tmp_path):
    strong, weak = {"p": 4000, "d": 200}, {"p": 2000, "d": 90}
    values = {joint: strong if k < 3 else weak for k, joint in enumerate(ARM)}
    gains = written(tmp_path, {"arm": {"joints": ARM, "gains": values}})
    numbers = tmp_path / "r.json"
    said = call(capsys, "step-response", "dual_ur10", "--gains", gains, "--json", numbers, "--seconds", 1)
    assert said.status == 0 and len(read_json(numbers)) == 12
    assert read_json(numbers)[ELBOW]["kp"] == 4000 and read_json(numbers)["right_elbow_joint"]["kp"] == 5000
    cell = cell_with(tmp_path, "{}")
    with cell.open("a") as file:
        file.write("task: [{hold: 0.1}]\n")
    out = tmp_path / "run.json"
    said = call(capsys, "run", cell, "--gains", gains, "--runs", tmp_path / "runs", "--json", out)
    assert said.status == 0 and f"--gains {gains}" in read_json(out)["command"]
    (folder,) = (tmp_path / "runs").iterdir()
    values = read_record(folder).metadata["values"]  # the record has the gains themselves
    assert values["physics.joint_gains"][ELBOW] == {"p": 4000, "i_clamp": 0, "d": 200, "antiwindup": False}
    wrong = call(capsys, "run", cell, "--gains", "fim", "--headless")
    assert wrong.status == 1 and "did you mean 'firm'" in wrong.err
