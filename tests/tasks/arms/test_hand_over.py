"""One arm hands a bar to the other, in physics."""

import numpy as np
import pytest

from armcell.cell import load
from armcell.core import SE3, InputError

pytestmark = pytest.mark.slow

CELL = """
robot: dual_ur10
start: {both_arms: home, grippers: open}
physics: {full_gain_effort: 150}
settings: {planning_budget: 200}  # [s], for machines that other programs fill
objects:
  table: {box: [1.6, 0.7, 0.05], pose: [0, 0, 0.875]}
  left_pedestal: {box: [0.3, 0.3, 0.79], pose: [0, 0.75, 0.395]}
  right_pedestal: {box: [0.3, 0.3, 0.79], pose: [0, -0.75, 0.395]}
  bar: {box: [0.36, 0.04, 0.04], pose: [0.1, 0.24, 0.9205], movable: true, mass: 0.4, friction: 0.8}
"""
WEIGHT = 0.4 * 9.81  # [N]


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    file = tmp_path_factory.mktemp("cell") / "cell.yaml"
    file.write_text(CELL)
    return load(file)


@pytest.mark.long
def test_from_hand_to_hand_and_down_on_the_other_side(cell):
    with cell.connect("sim", seed=0) as live:
        assert live["left_arm"].pick("bar")
        given = live.hand_over("bar", to="right_arm")
        assert given, given.message
        left, right = (live.driver.wrench(f"{side}_gripper") for side in ("left", "right"))
        assert np.linalg.norm(left) < 1e-6 and right[2] == pytest.approx(-WEIGHT, abs=0.3)
        assert live.driver.gripper("left_gripper").held is None
        assert live.ctx.holding["bar"].gripper.name == "right_gripper"
        assert live["right_arm"].place("bar", on="table", at=(0.2, -0.2))
        pose = live.driver.object_poses()["bar"]
        np.testing.assert_allclose(pose.translation, (0.2, -0.2, 0.92), atol=2e-3)
        assert live.driver.unwanted_contacts() == []
        assert live["left_arm"].move_to("home") and live["right_arm"].move_to("home")


def test_a_meeting_out_of_reach_says_so_and_nothing_moves(cell):
    with cell.connect("sim", seed=0) as live:
        assert live["left_arm"].pick("bar")
        before = live.driver.joint_state().positions
        outcome = live.hand_over("bar", to="right_arm", at=[SE3.from_xyz(3.0, 0.0, 1.2)])
        assert not outcome and "out of reach" in outcome.message
        np.testing.assert_allclose(live.driver.joint_state().positions, before, atol=1e-4)


def test_misuse(cell):
    with cell.connect("fake", seed=0) as live:
        with pytest.raises(InputError, match="no hand holds 'bar'"):
            live.hand_over("bar", to="right_arm")
        assert live["left_arm"].pick("bar")
        with pytest.raises(InputError, match="holds 'bar' already"):
            live.hand_over("bar", to="left_arm")
        with pytest.raises(InputError, match="unknown arm 'middle_arm'"):
            live.hand_over("bar", to="middle_arm")
