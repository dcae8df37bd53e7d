"""Two ways to tell a planner of the world: objects before each plan, or a diff with the request."""

from __future__ import annotations

import numpy as np
from tests.planning.helpers import down, judge, request
from tests.scene.helpers import box, panda

from armcell.core import SE3, ErrorCode, Octree, PoseGoal
from armcell.planning import plan
from armcell.scene import (
    OCTOMAP,
    AddObject,
    AllowCollision,
    AllowCollisionByDefault,
    MoveObject,
    SceneDiff,
    SetOctomap,
)

TABLE = box("table", (0.5, 0.8, 0.02), (0.55, 0.0, 0.2))
OBSTACLE = box("obstacle", (0.1, 0.1, 0.3), (0.5, 0.0, 0.361))
START = {"joint1": -0.5, "joint2": -0.3, "joint4": -2.0, "joint6": 1.8}


def test_way_a_objects_before_each_plan():
    scene = panda(TABLE, OBSTACLE, **START)
    goal = PoseGoal(down(0.5, 0.25, 0.4))
    first = plan(scene, request(goal))
    assert first.ok
    judge(scene, first.trajectory)
    moved = scene.with_object_pose("obstacle", SE3.from_xyz(0.5, 0.25, 0.361))  # now at the goal
    assert plan(moved, request(goal)).code is ErrorCode.GOAL_IN_COLLISION
    assert plan(moved.without_object("obstacle"), request(goal)).ok


def test_way_b_a_diff_with_the_request():
    """The hand goes around a cube that it is to grasp: only if that contact is allowed."""
    scene = panda(TABLE, **START)
    target = box("target", (0.1, 0.1, 0.05), (0.5, 0.25, 0.3))  # too wide for the fingers
    goal = PoseGoal(down(0.5, 0.25, 0.3))
    diff = SceneDiff.of(AddObject(OBSTACLE), AddObject(target))
    assert plan(scene.apply(diff), request(goal)).code is ErrorCode.GOAL_IN_COLLISION
    hand = ["panda_hand", "panda_leftfinger", "panda_rightfinger"]
    allowed = diff + SceneDiff(tuple(AllowCollision("target", link) for link in hand))
    result = plan(scene.apply(allowed), request(goal))
    assert result.ok
    judge(scene.apply(allowed), result.trajectory)
    assert list(scene.objects) == ["table"]  # the scene itself is as it was


def test_an_octomap_in_the_way():
    scene = panda(TABLE, **START)
    goal = PoseGoal(down(0.5, 0.25, 0.4))
    cells = Octree(np.array([[0.5, 0.25, 0.4]]), np.array([0.1]))
    there = scene.apply(SceneDiff.of(SetOctomap(cells)))
    failed = plan(there, request(goal))
    assert failed.code is ErrorCode.GOAL_IN_COLLISION and OCTOMAP in failed.message
    for change in (
        SetOctomap(None),
        AllowCollisionByDefault(OCTOMAP),
        MoveObject(OCTOMAP, SE3.from_xyz(0, 0, 5)),
    ):
        assert plan(there.apply(SceneDiff.of(change)), request(goal)).ok
