"""Requests with torque and jerk limits, judged from outside."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from tests.model.helpers import pin_library
from tests.planning.helpers import down, judge, panda_wall, request, ur10_wall

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, Box, ErrorCode, InputError, JointGoal, JointState, PoseGoal
from armcell.model import load_robot
from armcell.planning import plan
from armcell.planning.certify import certify_and_time, torque_model
from armcell.scene import CollisionObject, PlanningScene
from armcell.timing import BlendedPath, jerk_limited

AROUND = PoseGoal(down(0.5, 0.25, 0.25))


def holding(mass: float) -> PlanningScene:
    """A UR10 stretched out, with a block on its flange."""
    model = load_robot("ur10")
    scene = PlanningScene.of(model, [0.0, -0.3, 0.3, -1.57, -1.57, 0.0])
    link = model.group("arm").tip_link
    block = CollisionObject.single(
        "block",
        Box(0.1, 0.1, 0.1),
        scene.frame_pose(link) @ SE3.from_xyz(0.02, 0, 0.06),
        movable=True,
        mass=mass,
    )
    return scene.with_object(block).with_attached("block", link, ("wrist_3_link", "ee_link", "tool0"))


@pytest.mark.slow
def test_jerk_limits_are_kept_on_a_certified_path():
    scene = panda_wall()
    result = plan(scene, request(AROUND, jerk_limits=True))
    assert result.ok, result.message
    judge(scene, result.trajectory)
    trajectory, step = result.trajectory, 5e-4
    q = np.array([trajectory.sample(t)[0] for t in np.arange(0.0, trajectory.duration + step, step)])
    jerk = scene.model.limits(trajectory.joint_names, "jerk")
    assert np.max(np.abs(np.diff(q, 3, axis=0)) / step**3 / jerk) <= 1.001
    assert len(result.path.waypoints) > 2  # it goes around something
    corners = BlendedPath(result.path.waypoints, 0.05, smooth=True)
    limits = [scene.model.limits(trajectory.joint_names, k) for k in ("velocity", "acceleration", "jerk")]
    assert trajectory.duration >= jerk_limited(corners, trajectory.joint_names, *limits).duration - 1e-9


def test_a_carried_weight_counts_as_pinocchio_counts_it():
    scene = holding(6.0)
    names = scene.model.group("arm").joint_names
    dynamics = torque_model(scene, names)
    reference = pin_library("ur10")
    reference.gravity.linear = np.array([0.0, 0.0, -9.81])
    body = scene.attached["block"]
    frame = reference.frames[reference.getFrameId(body.link, pin.FrameType.BODY)]
    pose = pin.SE3(body.T_link_object.rotation.matrix, body.T_link_object.translation)
    block = pose.act(pin.Inertia.FromBox(6.0, 0.1, 0.1, 0.1))
    reference.inertias[frame.parentJoint] += frame.placement.act(block)
    data, rng = reference.createData(), np.random.default_rng(0)
    for _ in range(5):
        q, v, a = rng.normal(0, 1, (3, 6))
        expected = pin.rnea(reference, data, q, v, a)
        np.testing.assert_allclose(dynamics.torques(q, v, a)[0], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_torque_limits_slow_a_heavy_load():
    goal = JointGoal(JointState(("shoulder_lift_joint",), [-1.4]))
    light, heavy = (plan(holding(m), request(goal, torque_limits=True)) for m in (0.1, 9.5))
    assert light.ok and heavy.ok, (light.message, heavy.message)
    trajectory = heavy.trajectory
    dynamics = torque_model(holding(9.5), trajectory.joint_names)
    times = np.linspace(0.0, trajectory.duration, 2000)
    states = [np.array(x) for x in zip(*(trajectory.sample(t) for t in times), strict=True)]
    assert np.max(np.abs(dynamics.torques(*states)) / dynamics.limits) <= 1.0
    assert heavy.trajectory.duration > light.trajectory.duration + 0.02


def test_too_heavy_to_hold_is_said():
    goal = JointGoal(JointState(("shoulder_pan_joint",), [1.0]))
    result = plan(holding(60.0), request(goal, torque_limits=True))
    assert result.code is ErrorCode.PLANNING_FAILED and result.trajectory is None
    assert result.evidence["joint"] in result.message
    assert result.evidence["torque"] > 0.98 * result.evidence["limit"]
    assert plan(holding(60.0), request(goal)).ok  # nobody asked


def test_not_both():
    scene = panda_wall()
    with pytest.raises(InputError, match="cannot be kept together"):
        plan(scene, request(AROUND, torque_limits=True, jerk_limits=True))


def test_a_robot_without_jerk_limits_says_so():
    scene = ur10_wall()
    checker = KernelChecker(scene, scene.model.group("gripper").joint_names)
    with pytest.raises(InputError, match="has no jerk limit"):
        certify_and_time(checker, [[0.01], [0.02]], 1.0, 1.0, jerk_limits=True)
