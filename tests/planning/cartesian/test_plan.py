"""plan_cartesian: straight, and honest about how far it comes."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from tests.planning.helpers import judge
from tests.scene.helpers import box, panda, ur10
from tests.timing.helpers import distance_to_polyline

from armcell.core import SE3, SO3, CartesianRequest, ErrorCode, InputError, JointState, UnknownNameError
from armcell.planning import plan_cartesian


def tip(scene) -> SE3:
    return scene.frame_pose(scene.model.group("arm").tip_link)


def run(scene, *waypoints: SE3, **options):
    return plan_cartesian(scene, CartesianRequest("arm", waypoints, **options))


def tip_poses(scene, trajectory, step: float = 0.005) -> list[SE3]:
    times = np.append(np.arange(0.0, trajectory.duration, step), trajectory.duration)
    names = trajectory.joint_names
    return [tip(scene.with_state(JointState(names, trajectory.sample(t)[0]))) for t in times]


MOVES = {
    "down": lambda T: [T.shifted(z=-0.2)],
    "aside": lambda T: [T.shifted(x=0.05, y=0.25, z=-0.1)],
    "turn": lambda T: [SE3(T.rotation @ SO3.from_rpy((0.0, 0.0, 0.6)), T.translation)],
    "move and turn": lambda T: [
        T.shifted(0.05, 0.1, -0.15) @ SE3.from_xyz_rpy((0, 0, 0), (0.2, 0.1, 0.5)),
    ],
    "corner": lambda T: [T.shifted(z=-0.15), T.shifted(y=0.15, z=-0.15)],
    "there and back": lambda T: [T.shifted(z=-0.15), T],
}


@pytest.mark.slow
@pytest.mark.cases("*-panda")
@pytest.mark.parametrize("robot", [panda, ur10])
@pytest.mark.parametrize("move", MOVES)
def test_the_tip_keeps_its_line_and_its_turn(robot, move):
    scene = robot()
    start = tip(scene)
    waypoints = MOVES[move](start)
    result = run(scene, *waypoints)
    assert result.ok and result.fraction == 1.0, result.message
    judge(scene, result.trajectory)
    poses = tip_poses(scene, result.trajectory)
    line = np.array([start.translation, *(w.translation for w in waypoints)])
    off = distance_to_polyline(np.array([p.translation for p in poses]), line)
    assert off.max() <= 1e-3
    assert poses[-1].isclose(waypoints[-1], 1e-5, 1e-4)
    if len(waypoints) == 1:  # the orientation goes with the position, one fraction for both
        meters, radians = start.distance_to(waypoints[0])
        for pose in poses:
            gone = start.distance_to(pose)
            fraction = gone[0] / meters if meters > 1e-9 else gone[1] / radians
            assert pose.distance_to(start.interpolate(waypoints[0], fraction))[1] <= 0.01
    for w in waypoints:  # corners are passed
        assert min(p.distance_to(w)[0] for p in poses) <= 5e-3


def test_another_link_can_lead():
    scene = panda()
    target = scene.frame_pose("panda_link8").shifted(x=0.1)
    result = run(scene, target, link="panda_link8")
    assert result.ok
    last = scene.with_state(JointState(result.trajectory.joint_names, result.trajectory.positions[-1]))
    assert last.frame_pose("panda_link8").isclose(target, 1e-5, 1e-4)


@pytest.mark.parametrize("lower", [0.1, 0.2])
def test_an_obstacle_stops_it_and_is_named(lower):
    """A plate below the fingers: they come as far as the plate and no farther."""
    start = tip(panda())
    top = start.translation[2] - lower
    scene = panda(box("plate", (0.3, 0.3, 0.02), (start.translation[0], 0.0, top - 0.01)))
    result = run(scene, start.shifted(z=-0.3))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN and 0.0 < result.fraction < 1.0
    pair = {result.evidence["contacts"][0].body_a, result.evidence["contacts"][0].body_b}
    assert "plate" in pair and pair & {"panda_leftfinger", "panda_rightfinger"}
    assert all(name in result.message for name in pair) and "stops at" in result.message
    judge(scene, result.trajectory)
    reached = tip_poses(scene, result.trajectory)[-1]
    assert start.distance_to(reached)[0] == pytest.approx(0.3 * result.fraction, abs=1e-3)
    # Franka's finger tips are 9.5 mm beyond the tip frame (robot.yaml); a step is 5 mm.
    assert 0.0 <= reached.translation[2] - 0.0095 - top <= 0.006


def test_not_asked_to_avoid_it_goes_through():
    start = tip(panda())
    scene = panda(box("plate", (0.3, 0.3, 0.02), start.translation - (0, 0, 0.1)))
    result = run(scene, start.shifted(z=-0.2), avoid_collisions=False)
    assert result.ok and result.fraction == 1.0
    assert tip_poses(scene, result.trajectory)[-1].isclose(start.shifted(z=-0.2), 1e-5, 1e-4)


def test_not_asked_to_avoid_it_may_touch_itself():
    scene = panda().with_allowed("panda_link1", "panda_link2", allow=False)  # these always touch
    result = run(scene, tip(scene).shifted(z=-0.1), avoid_collisions=False)
    assert result.ok and result.fraction == 1.0


@pytest.mark.parametrize("robot", [panda, ur10])
def test_the_end_of_reach_stops_it(robot):
    scene = robot()
    start = tip(scene)
    result = run(scene, start.shifted(x=1.5))
    assert result.code is ErrorCode.NO_IK_SOLUTION and 0.0 < result.fraction < 1.0
    assert "stops at" in result.message and "short" in result.message
    judge(scene, result.trajectory)
    gone = start.distance_to(tip_poses(scene, result.trajectory)[-1])[0]
    assert gone == pytest.approx(1.5 * result.fraction, abs=1e-3)


def test_a_joint_limit_stops_it_and_is_named():
    """Turning the hand on and on about its own axis: joint 7 ends at 2.8973 rad."""
    scene = panda(joint7=2.5)
    T = tip(scene)
    result = run(scene, SE3(T.rotation @ SO3.from_rpy((0, 0, 0.9)), T.translation), jump_threshold=0.1)
    if result.ok:  # the redundant arm may help out: then it did not jump
        assert np.max(np.abs(np.diff(result.path.waypoints, axis=0))) <= 0.1
    T = tip(ur := ur10())
    stuck = ur.with_state(
        JointState(("wrist_3_joint",), [ur.model.joint("wrist_3_joint").limits.upper - 0.2])
    )
    T = tip(stuck)
    result = run(stuck, SE3(T.rotation @ SO3.from_rpy((0, 0, 0.9)), T.translation))
    assert result.code is ErrorCode.NO_IK_SOLUTION and result.evidence["joints_at_limit"] == ["wrist_3_joint"]
    assert "wrist_3_joint at the limit" in result.message
    assert result.fraction == pytest.approx(0.2 / 0.9, abs=0.06)


def test_a_jump_stops_it_and_names_the_joint():
    scene = panda()
    result = run(scene, tip(scene).shifted(z=-0.2), jump_threshold=1e-3)
    assert result.code is ErrorCode.PLANNING_FAILED and result.fraction == 0.0
    assert "would jump" in result.message and result.evidence["joint"] in result.message
    assert result.path is None and result.trajectory is None


def test_the_speed_of_the_tip_is_held():
    scene = panda()
    result = run(scene, tip(scene).shifted(z=-0.2), max_cartesian_speed=0.05)
    positions = np.array([p.translation for p in tip_poses(scene, result.trajectory, 0.01)])
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / 0.01
    assert 0.045 <= speeds.max() <= 0.0505


def test_scaling_and_start_count():
    scene = panda()
    moved = JointState(("panda_joint1",), [0.5])
    target = tip(scene.with_state(moved)).shifted(z=-0.1)
    result = run(scene, target, start=moved, velocity_scaling=0.1, acceleration_scaling=0.1)
    assert result.ok and result.path.waypoints[0][0] == 0.5
    judge(scene.with_state(moved), result.trajectory, 0.1, 0.1)


def test_nowhere_to_go():
    result = run(panda(), tip(panda()))
    assert result.ok and result.fraction == 1.0


@pytest.mark.parametrize("value", [0.0, -0.1, np.nan, np.inf])
def test_the_step_must_be_positive(value):
    with pytest.raises(InputError, match="max_step"):
        run(panda(), tip(panda()).shifted(z=-0.1), max_step=value)


def test_a_step_that_would_take_forever_is_refused():
    with pytest.raises(InputError, match="divides a line"):
        run(panda(), tip(panda()).shifted(z=-0.1), max_step=1e-9)


@pytest.mark.slow
def test_a_long_line_is_cancelled():
    scene, cancel = panda(), threading.Event()
    start = tip(scene)
    request = CartesianRequest("arm", (start.shifted(z=-0.2),), max_step=1e-5)
    plan_cartesian(scene, replace(request, max_step=0.01))  # compiled and kept
    threading.Timer(0.3, cancel.set).start()
    result = plan_cartesian(scene, request, cancel)
    assert result.code is ErrorCode.PREEMPTED and "cancelled" in result.message
    assert result.fraction == 0.0 and result.trajectory is None


@pytest.mark.parametrize("value", [0.0, -0.1, np.nan])
def test_the_speed_must_be_positive(value):
    with pytest.raises(InputError, match="max_cartesian_speed"):
        run(panda(), tip(panda()).shifted(z=-0.1), max_cartesian_speed=value)


def test_misuse_raises():
    with pytest.raises(InputError, match="no waypoints"):
        run(panda())
    with pytest.raises(UnknownNameError, match="known: "):
        run(panda(), tip(panda()), link="hand")
    with pytest.raises(UnknownNameError, match="known: arm"):
        plan_cartesian(panda(), CartesianRequest("arms", (tip(panda()),)))
    with pytest.raises(InputError, match="velocity scaling"):
        run(panda(), tip(panda()), velocity_scaling=0.0)
    with pytest.raises(UnknownNameError, match="nope"):
        run(panda(), tip(panda()), start=JointState(("nope",), [0.0]))
