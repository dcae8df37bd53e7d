"""The cell of a Panda and a UR10e: its robot model, and its task in simulation."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.cell import load, run_task
from armcell.drivers.ur.calibration import calibrated_model
from armcell.drivers.ur.wire.kinematics import frames_of
from armcell.drivers.ur.wire.models import ur_model
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot

CELL = "panda_ur10e_handover"


def test_the_ur10e_without_meshes_has_the_controller_s_kinematics():
    model, dh = load_robot("ur10e_gripper"), ur_model("UR10e").dh
    tree, columns = kinematic_tree(model), model.columns(model.group("arm").joint_names)
    for q in np.random.default_rng(0).uniform(-3.0, 3.0, (20, 6)):
        state = np.zeros(model.dof)
        state[columns] = q
        flange = frames_of(dh, q)[6, :3, 3] * (-1.0, -1.0, 1.0)  # base_link is turned by pi
        np.testing.assert_allclose(tree.link_pose(state, "tool0").translation, flange, atol=1e-8)
    calibrated_model(model, "arm", dh, dh)  # its axes are those of a UR10e, or this fails


@pytest.mark.slow
@pytest.mark.cases("0")
@pytest.mark.parametrize("seed", range(4))
def test_the_bar_goes_from_hand_to_hand_into_the_tray(seed):
    cell = load(CELL)
    with cell.connect("sim", seed) as live:
        result = run_task(cell, live, seed, "sim")
        bar = live.driver.object_poses()["bar"].translation
    assert result["success"], result["message"]
    assert not result["unwanted_contacts"] and not result["welds"]
    tray = cell.scene().object("tray").T_world_object.translation
    assert np.linalg.norm(bar[:2] - tray[:2]) < 0.005
