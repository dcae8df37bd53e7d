"""Calibration in the model: against the DH formula written here, and against pinocchio on the URDF of it."""

import json
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from tests.drivers.ur.emulated import emulator, free_hosts, free_port

from armcell.cell import load, with_values
from armcell.cell.built_in import LIBRARY
from armcell.cli.main import main
from armcell.core import SE3, InputError
from armcell.drivers.ur.calibration import calibrated_model
from armcell.drivers.ur.wire.models import ur_model
from armcell.drivers.ur.wire.primary import Kinematics
from armcell.emulators.ur.controller import factory_calibration
from armcell.kinematics import kinematic_tree
from armcell.model import MountedRobot, compose, load_robot
from armcell.ros.unity.export import write_urdf

UR10 = ur_model("UR10")


def flange(dh: Kinematics, q) -> np.ndarray:
    """Denavit-Hartenberg's formula, in the model's base_link (turned by pi about z)."""
    T = np.diag([-1.0, -1.0, 1.0, 1.0])
    for t, a, d, al in zip(np.add(dh.theta, q), dh.a, dh.d, dh.alpha, strict=True):
        ct, st, ca, sa = np.cos(t), np.sin(t), np.cos(al), np.sin(al)
        T = T @ [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, d],
            [0, 0, 0, 1],
        ]
    return T


def far_and_back(seed: int) -> Kinematics:
    """As factory files have it: nearly parallel axes meet a hundred meters away."""
    dh = factory_calibration(UR10, seed)
    d, alpha, theta = list(dh.d), list(dh.alpha), list(dh.theta)
    d[1], d[2], d[3] = d[1] + 95.0, d[2] - 140.0, d[3] + 45.0
    alpha[1], alpha[2] = 2e-5, -3e-5
    theta[1], theta[2] = theta[1] + 0.004, theta[2] - 0.006
    return replace(dh, d=tuple(d), alpha=tuple(alpha), theta=tuple(theta))


@pytest.mark.slow
@pytest.mark.cases("own1")
@pytest.mark.parametrize("own", [factory_calibration(UR10, s) for s in (1, 2, 3)] + [far_and_back(4)])
def test_flange_is_the_robot_s_own(own, tmp_path):
    model = load_robot("ur10")
    applied = calibrated_model(model, "arm", UR10.dh, own)
    tree, names = kinematic_tree(applied), applied.group("arm").joint_names
    write_urdf(applied, tmp_path, "own.urdf")
    pin = pinocchio.buildModelFromUrdf(str(tmp_path / "own.urdf"))
    data, frame = pin.createData(), pin.getFrameId("tool0")
    rng, nominal_error = np.random.default_rng(0), []
    T_dh_tool = None  # the model's tool0 is turned against DH's last frame
    for _ in range(20):
        q = rng.uniform(-2.5, 2.5, 6)
        expected = flange(own, q)
        here = tree.link_pose(_positions(applied, names, q), "tool0").matrix
        pinocchio.framesForwardKinematics(pin, data, q)
        np.testing.assert_allclose(data.oMf[frame].homogeneous, here, atol=1e-6)  # a URDF has few digits
        turned = np.linalg.inv(expected) @ here
        T_dh_tool = turned if T_dh_tool is None else T_dh_tool
        np.testing.assert_allclose(turned, T_dh_tool, atol=1e-9)
        np.testing.assert_allclose(here[:3, 3], expected[:3, 3], atol=1e-9)
        nominal = kinematic_tree(model).link_pose(_positions(model, names, q), "tool0").translation
        nominal_error.append(np.linalg.norm(nominal - expected[:3, 3]))
    assert max(nominal_error) > 1e-3  # without it one is wrong
    for name in names:  # and the links stay where meshes are drawn for
        a, b = (m.joints[name].T_parent_joint for m in (model, applied))
        distance, angle = a.distance_to(b)
        assert distance < 0.012 and angle < 0.02, name


def _positions(model, names, q):
    positions = np.zeros(model.dof)
    positions[model.columns(names)] = q
    return positions


def test_nominal_parameters_change_nothing():
    model = load_robot("ur10")
    applied = calibrated_model(model, "arm", UR10.dh, UR10.dh)
    for name, joint in model.joints.items():
        distance, angle = joint.T_parent_joint.distance_to(applied.joints[name].T_parent_joint)
        assert distance < 1e-6 and angle < 1e-6, name


def test_each_of_two_arms_gets_its_own():
    robot = load_robot("ur10")
    pair = compose(
        "pair",
        [
            MountedRobot(robot, f"{s}_", T_parent_root=SE3.from_xyz(0, y, 0.8))
            for s, y in (("l", 1), ("r", -1))
        ],
    )
    own = factory_calibration(UR10, 7)
    applied = calibrated_model(pair, "r_arm", UR10.dh, own)
    q = np.linspace(-1, 1, pair.dof)
    tree, nominal = kinematic_tree(applied), kinematic_tree(pair)
    assert np.array_equal(tree.link_pose(q, "l_tool0").matrix, nominal.link_pose(q, "l_tool0").matrix)
    mine = q[pair.columns(pair.group("r_arm").joint_names)]
    there = tree.link_pose(q, "r_tool0").translation
    np.testing.assert_allclose(there, flange(own, mine)[:3, 3] + [0, -1, 0.8], atol=1e-9)


def test_another_type_or_robot_is_refused():
    model = load_robot("ur10")
    with pytest.raises(InputError, match="not where this type of UR has it"):
        calibrated_model(model, "arm", ur_model("UR10e").dh, ur_model("UR10e").dh)
    with pytest.raises(InputError, match="no calibration is that large"):
        calibrated_model(model, "arm", UR10.dh, replace(UR10.dh, a=(0.0, -0.7, -0.5723, 0.0, 0.0, 0.0)))


@pytest.mark.slow
def test_a_cell_plans_with_what_its_robot_tells(tmp_path, capsys):
    (host,) = free_hosts(1)
    text = (LIBRARY / "six_axis_pick" / "cell.yaml").read_text()
    text += "\nreal:\n  twin: false\n  max_state_age: 0.3\n  watchdog: 0.5\n  calibration: apply\n  arms:\n"
    text += f"    arm: {{host: {host}, port: {free_port()}, model: UR10}}\n"
    file, record = tmp_path / "cell.yaml", tmp_path / "bringup.json"
    file.write_text(text)
    with emulator("--calibration", "5", hosts=[host]):
        apart = {}
        for how, cell in (
            ("apply", load(file)),
            ("compare", with_values(load(file), {"real.calibration": "compare"})),
        ):
            with cell.connect("real") as live:
                x, y, z = live.driver.arms["arm"].state.actual_TCP_pose[
                    :3
                ]  # by the controller's own geometry
                base = live.scene().frame_pose("base_link")
                tool = base.inverse() @ live.scene().frame_pose("tool0")
                apart[how] = np.linalg.norm(tool.translation - [-x, -y, z])
        assert apart["apply"] < 1e-6 and apart["compare"] > 5e-4
        assert main(["bringup", str(file), "--yes", "--record", str(record)]) == 0
    told = [s["text"] for s in json.loads(record.read_text())["steps"] if s["name"] == "geometry"]
    assert told == ["flange 0.00 mm from the model with the robot's own calibration"]
