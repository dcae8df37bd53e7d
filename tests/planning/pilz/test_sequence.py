"""Sequences: MoveIt's unittest_trajectory_blender_transition_window and its command list manager."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.planning.helpers import judge
from tests.planning.pilz.reference import Watched, tip, tip_of, told
from tests.scene.helpers import box, panda, ur10

from armcell.core import ErrorCode, InputError, JointGoal, JointState, PlanRequest, SequenceRequest
from armcell.model import load_robot
from armcell.planning import plan, plan_sequence
from armcell.scene import PlanningScene


def corner(scene, radius: float, first: str = "LIN", second: str = "LIN", **scaling) -> SequenceRequest:
    """0.2 m along y, then 0.2 m down."""
    a = tip(scene).shifted(y=0.2)
    b = a.shifted(z=-0.2)
    bent = {"interim": tuple(a.shifted(y=-0.03, z=-0.1).translation)}
    parameters = bent if second == "CIRC" else {}
    return SequenceRequest(
        ((told(first, a, **scaling), radius), (told(second, b, parameters=parameters, **scaling), 0.0))
    )


each_pair = pytest.mark.parametrize(
    ("first", "second"), [("LIN", "LIN"), ("LIN", "CIRC"), ("PTP", "LIN"), ("LIN", "PTP"), ("PTP", "PTP")]
)


@pytest.mark.slow
@pytest.mark.cases("LIN-LIN-panda", "LIN-CIRC-panda", "PTP-LIN-panda")
@pytest.mark.parametrize("robot", [panda, ur10])
@each_pair
def test_a_blend_is_continuous_and_inside_its_sphere(robot, first, second):
    """testLinLinBlending and its kin: bounds are kept; joints and tip are continuous."""
    scene, radius = robot(), 0.06
    sequence = corner(scene, radius, first, second)
    result = plan_sequence(scene, sequence)
    assert result.ok, result.message
    judge(scene, result.trajectory)
    seen = Watched(scene, result.trajectory, tip_of(scene), step=0.001)
    # Joint positions and velocities fit each other, and neither jumps.
    np.testing.assert_allclose(np.gradient(seen.q, 0.001, axis=0)[2:-2], seen.v[2:-2], atol=2e-4)
    limit = scene.model.limits(result.trajectory.joint_names, "acceleration")
    assert np.all(np.abs(np.diff(seen.v, axis=0)) <= limit * 0.001 * 1.01)
    # Of the tip, too (MoveIt's checkBlendingCartSpaceContinuity).
    velocity = np.diff(seen.points, axis=0) / 0.001
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() < 6.0 * 0.001  # [m/s] per ms
    middle = tip(scene).shifted(y=0.2).translation
    times, (window,) = seen.times, result.evidence["blends"]
    during = (times >= window["begin"]) & (times <= window["end"])
    away = np.linalg.norm(seen.points - middle, axis=1)
    assert away[during].max() <= radius * (1 + 1e-6)
    assert away.min() > 1e-3  # the corner is cut
    speed = np.linalg.norm(seen.v, axis=1)
    assert speed[during].min() > 0.05  # and there is no stop
    if (first, second) == ("LIN", "LIN"):  # outside of the sphere it is the lines
        before, after = times < window["begin"], times > window["end"]
        start = tip(scene).translation
        assert np.abs(seen.points[before][:, [0, 2]] - start[[0, 2]]).max() < 1e-6
        assert np.abs(seen.points[after][:, [0, 1]] - middle[[0, 1]]).max() < 1e-6
    assert seen.end.isclose(sequence.items[1][0].goals[0].T_world_link, 1e-4, 1e-3)


def test_a_blend_saves_the_time_of_the_stop():
    scene = panda()
    stop, blend = (plan_sequence(scene, corner(scene, r)).trajectory.duration for r in (0.0, 0.06))
    parts = []
    at = scene
    for request, _ in corner(scene, 0.0).items:
        result = plan(at, request)
        parts.append(result.trajectory.duration)
        at = at.with_state(result.trajectory.end)
    assert stop == pytest.approx(sum(parts), abs=1e-9) and blend < stop - 0.2


def test_the_window_is_moveit_s():
    """Both motions at once, the longer one in the sphere gives the length: seen at the middle of it."""
    scene = ur10()
    sequence = corner(scene, 0.05)
    result = plan_sequence(scene, sequence)
    (window,) = result.evidence["blends"]
    first = plan(scene, sequence.items[0][0]).trajectory
    second = plan(scene.with_state(first.end), sequence.items[1][0]).trajectory
    leaves, length = window["begin"], window["end"] - window["begin"]
    joins = second.duration - (result.trajectory.duration - window["end"])
    assert length == pytest.approx(max(first.duration - leaves, joins), abs=1e-9)
    for s in (0.2, 0.5, 0.8):
        t = s * length
        a = tip(scene.with_state(JointState(first.joint_names, first.sample(leaves + t)[0])))
        b = tip(scene.with_state(JointState(first.joint_names, second.sample(t - (length - joins))[0])))
        share = 6 * s**5 - 15 * s**4 + 10 * s**3
        q = result.trajectory.sample(leaves + t)[0]
        at = tip(scene.with_state(JointState(first.joint_names, q)))
        assert at.isclose(a.interpolate(b, share), 1e-6, 1e-6)


@pytest.mark.slow
def test_three_motions_with_their_own_speeds():
    scene = ur10()
    a = tip(scene).shifted(y=0.2)
    b, c = a.shifted(z=-0.2), a.shifted(y=-0.25, z=-0.2)
    slow, fast = {"velocity": 0.1, "acceleration": 0.2}, {"velocity": 0.3, "acceleration": 0.2}
    items = ((told("LIN", a, **fast), 0.05), (told("LIN", b, **slow), 0.05), (told("LIN", c, **fast), 0.0))
    result = plan_sequence(scene, SequenceRequest(items))
    assert result.ok, result.message
    judge(scene, result.trajectory)
    seen = Watched(scene, result.trajectory, tip_of(scene))
    speed, t = seen.speed, seen.times[:-1]
    peaks = []
    for item in result.evidence["items"]:
        peaks.append(speed[(t >= item["begin"]) & (t <= item["end"])].max())
    assert peaks == pytest.approx([0.3, 0.1, 0.3], rel=1e-3)
    assert result.min_clearance > 0


# --- what is wrong ---
@pytest.mark.slow
def test_overlapping_radii_are_refused_with_both_named():
    scene = ur10()
    a = tip(scene).shifted(y=0.2)
    items = ((told("LIN", a), 0.08), (told("LIN", a.shifted(z=-0.15)), 0.08), (told("LIN", tip(scene)), 0.0))
    result = plan_sequence(scene, SequenceRequest(items))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN and result.trajectory is None
    assert "motions 1 (80 mm) and 2 (80 mm) overlap: their ends are 150 mm apart" in result.message
    helped = result.explain(60.0).suggestions[0]
    assert plan_sequence(*helped.apply(scene, SequenceRequest(items))).ok


@pytest.mark.parametrize("which", ["first", "second"])
def test_a_motion_all_inside_the_sphere(which):
    """testTraj1InsideBlendRadius, testTraj2InsideBlendRadius."""
    scene = panda()
    a = tip(scene).shifted(y=0.05 if which == "first" else 0.2)
    b = a.shifted(z=-0.2 if which == "first" else -0.05)
    result = plan_sequence(scene, SequenceRequest(((told("LIN", a), 0.06), (told("LIN", b), 0.0))))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN
    assert f"too large: the {which} motion" in result.message


def test_radii_that_cannot_be():
    scene = panda()
    good = corner(scene, 0.05).items
    with pytest.raises(InputError, match="no requests"):
        plan_sequence(scene, SequenceRequest(()))
    with pytest.raises(InputError, match=r"last request has blend radius 0\.1 m"):
        plan_sequence(scene, SequenceRequest((good[0], (good[1][0], 0.1))))
    for radius in (-0.1, np.nan):
        with pytest.raises(InputError, match="request 1 of 2 has blend radius"):
            plan_sequence(scene, SequenceRequest(((good[0][0], radius), good[1])))


def test_only_the_first_request_may_have_a_start():
    scene = panda()
    (a, radius), (b, _) = corner(scene, 0.05).items
    start = JointState(("panda_joint7",), [0.9])
    result = plan_sequence(scene, SequenceRequest(((replace(a, start=start), radius), (b, 0.0))))
    assert result.ok and result.trajectory.positions[0][6] == 0.9
    with pytest.raises(InputError, match="request 2 of 2 has a start state"):
        plan_sequence(scene, SequenceRequest(((a, radius), (replace(b, start=start), 0.0))))


@pytest.mark.slow
def test_a_motion_that_fails_is_named_and_explained():
    scene = panda()
    (a, radius), (b, _) = corner(scene, 0.05).items
    where = tip(scene).shifted(y=0.2, z=-0.15).translation
    blocked = scene.with_object(box("block", (0.03, 0.03, 0.03), where))
    result = plan_sequence(blocked, SequenceRequest(((a, radius), (b, 0.0))))
    assert result.code in (ErrorCode.INVALID_MOTION_PLAN, ErrorCode.GOAL_IN_COLLISION)
    assert result.message.startswith("motion 2 of 2: ") and "block" in result.message
    assert result.evidence["item"] == 1 and result.trajectory is None and result.path is None
    assert result.explain(60.0).contacts


@pytest.mark.slow
def test_a_blend_that_touches_is_not_returned():
    """A held stick goes around a corner; a pin inside of it is free of both lines, 3 mm beside each."""
    scene = panda()
    T = tip(scene)
    hand = ("panda_leftfinger", "panda_rightfinger", "panda_hand")
    stick = box("stick", (0.004, 0.004, 0.3), T.shifted(z=-0.1).translation)
    scene = scene.with_object(stick).with_attached("stick", "panda_hand_tcp", hand)
    sequence = corner(scene, 0.09)
    assert plan_sequence(scene, sequence).ok
    inside = T.shifted(y=0.2 - 0.002 - 0.004, z=-0.25 - 0.004).translation
    pinned = scene.with_object(box("pin", (0.01, 0.002, 0.002), inside))
    assert plan_sequence(pinned, corner(scene, 0.0)).ok
    result = plan_sequence(pinned, sequence)
    assert result.code is ErrorCode.INVALID_MOTION_PLAN and result.trajectory is None
    assert result.message.startswith("the blend between motions 1 and 2: it touches at")
    assert "pin" in result.message
    helped = result.explain(60.0).suggestions[0]
    assert helped.text.startswith("give motion 1 a blend radius of ")
    again = plan_sequence(*helped.apply(pinned, sequence))
    assert again.ok
    judge(pinned, again.trajectory)


def test_groups_one_after_the_other():
    robot = load_robot("panda")
    scene = PlanningScene.of(robot)
    hand = next(g for g in robot.groups.values() if g.tip_link is None)
    q = scene.positions[robot.columns(hand.joint_names)]
    open_ = JointGoal(JointState(hand.joint_names, q * 0.5 + 0.005))
    grip = PlanRequest(hand.name, (open_,), pipeline_id="pilz", planner_id="PTP")
    down, up = told("LIN", tip(scene).shifted(z=-0.1)), told("LIN", tip(scene))
    result = plan_sequence(scene, SequenceRequest(((down, 0.0), (grip, 0.0), (up, 0.0))))
    assert result.ok, result.message
    judge(scene, result.trajectory)
    assert set(result.trajectory.joint_names) == {*robot.group("arm").joint_names, *hand.joint_names}
    fingers = [result.trajectory.joint_names.index(n) for n in hand.joint_names]
    begin, end = (result.evidence["items"][1][k] for k in ("begin", "end"))
    arm = [k for k in range(len(result.trajectory.joint_names)) if k not in fingers]
    still, grasp = (result.trajectory.sample(t)[1] for t in (begin / 2, (begin + end) / 2))
    assert not still[fingers].any() and not grasp[arm].any() and grasp[fingers].any()
    with pytest.raises(InputError, match="moves group"):
        plan_sequence(scene, SequenceRequest(((down, 0.05), (grip, 0.0))))


def test_a_searched_motion_may_be_part_of_it():
    scene = panda()
    (a, _), (b, _) = corner(scene, 0.0).items
    free = PlanRequest("arm", a.goals, velocity_scaling=0.2, acceleration_scaling=0.1)
    result = plan_sequence(scene, SequenceRequest(((free, 0.05), (b, 0.0))))
    assert result.ok, result.message
    judge(scene, result.trajectory)


@pytest.mark.slow
def test_what_a_blend_would_break_is_refused():
    scene = ur10()
    (a, _), (b, _) = corner(scene, 0.1).items
    fast = plan_sequence(scene, SequenceRequest(((a, 0.1), (b, 0.0))))
    peak = Watched(scene, fast.trajectory, tip_of(scene)).speed.max()
    assert peak > 0.31  # as in MoveIt: two motions at once are faster than one, whose limit is 0.3 m/s
    bound = replace(b, max_cartesian_speed=0.3)
    result = plan_sequence(scene, SequenceRequest(((a, 0.1), (bound, 0.0))))
    assert result.code is ErrorCode.PLANNING_FAILED and "max_cartesian_speed is 0.3 m/s" in result.message
    helped = result.explain(60.0).suggestions[0]
    again = plan_sequence(*helped.apply(scene, SequenceRequest(((a, 0.1), (bound, 0.0)))))
    (window,) = again.evidence["blends"]
    seen = Watched(scene, again.trajectory, tip_of(scene))
    during = (seen.times[:-1] >= window["begin"]) & (seen.times[:-1] <= window["end"])
    assert again.ok and seen.speed[during].max() <= 0.3 * 1.002
    with pytest.raises(InputError, match="request 1 has jerk_limits"):
        free = PlanRequest("arm", a.goals, jerk_limits=True)
        plan_sequence(scene, SequenceRequest(((free, 0.1), (b, 0.0))))
