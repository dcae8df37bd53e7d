"""Goals of arms with four and five joints: reached, reduced by tolerances, or refused with a reason."""

from __future__ import annotations

import numpy as np
import pytest
from tests.kinematics.arms import arm
from tests.model.helpers import with_limits

from armcell.core import SE3, ErrorCode, InputError, JointGoal, JointState, PlanRequest, PoseGoal
from armcell.kinematics import ik_solver, kinematic_tree
from armcell.model import RobotModel
from armcell.planning import plan
from armcell.scene import PlanningScene

UP = np.pi / 2
SCARA = [(0.3, 0.3, 0.0), (0.0, 0.25, np.pi), (0.0, 0.0, 0.0), (0.05, 0.0, 0.0)]
FIVE = [(0.1, 0.0, UP), (0.0, 0.3, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, UP), (0.1, 0.0, 0.0)]
ROBOTS = {
    "scara": lambda: arm(SCARA, "rrpr", limit=2.5, limits={2: (0.0, 0.2)}),
    "five joints": lambda: arm(FIVE, "rrrrr", limit=2.5),
}


@pytest.fixture(params=ROBOTS)
def model(request) -> RobotModel:
    return with_limits(ROBOTS[request.param]())


def poses(model: RobotModel, count: int):
    tree, rng = kinematic_tree(model), np.random.default_rng(0)
    for _ in range(count):
        yield tree.link_pose(rng.uniform(model.lower, model.upper), "tool")


def solved(model: RobotModel, goal: PoseGoal) -> SE3 | None:
    result = plan(PlanningScene.of(model), PlanRequest("arm", [goal], planning_time=1.0))
    if not result.ok:
        return None
    return kinematic_tree(model).link_pose(result.trajectory.positions[-1], "tool")


def test_reachable_poses_are_reached_exactly(model):
    ik = ik_solver(model, "arm")
    for pose in poses(model, 30):
        answer = ik.solve(pose, model.default_positions())
        assert answer.ok and max(ik.tree.link_pose(answer.positions, "tool").distance_to(pose)) < 1e-5


def test_a_pose_a_little_off_is_reached_within_the_tolerance(model):
    """The numbers of a real URDF are rounded: its poses miss the arm's reachable poses by a little."""
    ik = ik_solver(model, "arm")
    for pose in poses(model, 10):
        off = pose @ SE3.from_xyz_rpy((0, 0, 0), (1e-5, -1e-5, 1e-5))
        answer = ik.solve(off, model.default_positions())
        assert answer.ok and ik.tree.link_pose(answer.positions, "tool").distance_to(off)[1] < 5e-5


def test_a_free_orientation_is_found(model):
    for pose in poses(model, 5):
        goal = SE3.from_xyz(*pose.translation)
        reached = solved(model, PoseGoal(goal, "tool", orientation_tolerance=np.pi))
        assert reached is not None and reached.distance_to(goal)[0] < 2e-4


def test_a_tolerance_is_kept(model):
    for pose in poses(model, 5):
        goal = pose @ SE3.from_xyz_rpy((0, 0, 0), (0.1, 0.1, 0.0))
        reached = solved(model, PoseGoal(goal, "tool", orientation_tolerance=0.3))
        assert reached is not None and reached.distance_to(goal)[1] < 0.3


def test_an_unreachable_orientation_states_the_reason(model):
    pose = next(iter(poses(model, 1))) @ SE3.from_xyz_rpy((0, 0, 0), (0.5, 0.5, 0.0))
    result = plan(PlanningScene.of(model), PlanRequest("arm", [PoseGoal(pose, "tool")]))
    assert result.code == ErrorCode.NO_IK_SOLUTION
    assert f"{model.dof} joints reach only some orientations" in result.message
    assert "orientation tolerance" in result.message


def test_a_missing_limit_names_the_joint():
    model = ROBOTS["five joints"]()
    goal = JointGoal(JointState(model.joint_names, np.full(5, 0.3)))
    with pytest.raises(InputError, match="joint 'j1' has no acceleration limit .*joint_limits.yaml"):
        plan(PlanningScene.of(model), PlanRequest("arm", [goal]))
