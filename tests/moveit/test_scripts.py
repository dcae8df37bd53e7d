"""Scripts as users bring them, unchanged and to their goals in physics."""

from __future__ import annotations

import numpy as np
import pytest
from tests.moveit.helpers import SCRIPTS

from armcell.cell import load
from armcell.core import StateSample
from armcell.moveit import run_script
from armcell.moveit.lint import closes_gripper_itself

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not SCRIPTS.is_dir(), reason="the users' scripts are in ../shared"),
]
SCALE = 3.0  # as fast as two busy cores follow


class Watch:
    """Keeps what a driver measures."""

    def __init__(self):
        self.samples: list[StateSample] = []

    def on_state(self, sample):
        self.samples.append(sample)

    def on_event(self, event):
        pass

    def on_trajectory(self, time, trajectory):
        pass


def run(script, cell, seed=None, **kwargs):
    watch = Watch()
    live = load(cell).connect("sim", seed, [watch], time_scale=SCALE)
    status, session = run_script(SCRIPTS / script, live, quiet=True, **kwargs)
    return status, session, live, watch


@pytest.mark.long
def test_the_grasp_server_lifts_the_cube():
    assert not closes_gripper_itself(SCRIPTS / "grasp_action_server.py")
    status, session, live, watch = run("grasp_action_server.py", "panda_table", auto_grip=True)
    assert status == 0 and any("Close gripper now!" in line for line in session.lines)
    before, after = watch.samples[0].object_poses["cube"], live.driver.object_poses()["cube"]
    assert after.translation[2] - before.translation[2] > 0.15
    assert live.driver.gripper("hand").held == "cube"
    assert not live.driver.unwanted_contacts() and not live.driver.welds()


@pytest.mark.long
def test_nobody_closes_the_gripper_when_a_script_only_says_so():
    status, session, live, _ = run("grasp_action_server.py", "panda_table", auto_grip=False)
    assert status == 0 and "auto-grip" in session.hints
    assert live.driver.object_poses()["cube"].translation[2] < 0.03


@pytest.mark.cases("1")
@pytest.mark.parametrize("seed", [None, 1])
def test_pick_and_place_places_the_object(seed):
    assert closes_gripper_itself(SCRIPTS / "pick_and_place.py")
    status, session, live, watch = run("pick_and_place.py", "six_axis_table", seed)
    assert status == 0 and "jump_threshold" in session.hints
    before = watch.samples[0].object_poses["object"].translation
    after = live.driver.object_poses()["object"].translation
    # Its nine places lie up to 0.02 m around 0.25 m to the side of where the object was.
    assert np.all(np.abs(after[:2] - (before[:2] - (0, 0.25))) < 0.025)
    assert abs(after[2] - before[2]) < 2e-3 and live.driver.gripper("gripper").held is None
    assert not live.driver.unwanted_contacts()


def test_two_arms_move_at_once_without_contact():
    status, session, live, watch = run("dual_arm_task.py", "dual_ur10")
    assert status == 0 and any("both arms moved together" in line for line in session.lines)
    names = live.model.joint_names
    moving = np.array([np.abs(s.joints.velocities) > 0.02 for s in watch.samples])
    left = moving[:, [n.startswith("left_") and "finger" not in n for n in names]].any(axis=1)
    right = moving[:, [n.startswith("right_") and "finger" not in n for n in names]].any(axis=1)
    assert left.sum() > 50 and (left & right).sum() > 0.5 * max(left.sum(), right.sum())
    assert not live.driver.unwanted_contacts()
    q0, q1 = watch.samples[0].joints.positions, live.driver.joint_state().positions
    assert np.max(np.abs(q1 - q0)) < 0.05  # up and back
