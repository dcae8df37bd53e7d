"""Hints name the tool's direction, or the tip link, only where that is the cause."""

from __future__ import annotations

import pytest
from tests.moveit.helpers import stamped


@pytest.fixture
def hints(session):
    """The lines of hints that a test has caused."""
    session.hints.clear()
    first = len(session.lines)
    return lambda: [line for line in session.lines[first:] if "[HINT]" in line]


def upward(pose):
    o = pose.pose.orientation
    o.x, o.w = 0.0, 1.0
    return pose


@pytest.mark.slow
def test_a_tool_that_points_up(arm, hints):
    arm.set_pose_target(upward(stamped(0.41, 0.05, 0.125)))
    assert not arm.go()
    assert any("your tool points up" in line for line in hints())


def test_no_hint_at_the_tool_where_it_is_not_the_cause(arm, hints):
    for pose in (upward(stamped(0.0, 0.0, 2.5)), stamped(0.0, 0.0, 2.5)):  # out of reach either way
        arm.set_pose_target(pose)
        assert not arm.plan()[0]
    arm.set_pose_target(upward(stamped(0.3, 0.0, 0.9)))  # up, and free
    assert arm.plan()[0] and hints() == []


def test_a_pose_of_the_flange(arm, mc, hints):
    cube = mc.PlanningSceneInterface().get_object_poses(["cube"])["cube"].position
    hand = mc.MoveGroupCommander("hand")
    hand.set_max_velocity_scaling_factor(1.0)
    hand.set_named_target("open")
    assert hand.go()
    arm.set_pose_target(stamped(cube.x, cube.y, cube.z + 0.1034))
    assert arm.go()
    hand.set_named_target("closed")
    assert hand.go()
    (line,) = hints()
    assert "closed on nothing: cube" in line and "panda_moveit_config's is panda_link8" in line
