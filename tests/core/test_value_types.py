"""Values of a wrong type in fields of value types: the error names the field and shows how to write it."""

import numpy as np
import pytest

from armcell import (
    SE3,
    Box,
    CartesianRequest,
    CollisionObject,
    InputError,
    JointGoal,
    JointState,
    NamedGoal,
    PlanningScene,
    PlanRequest,
    PoseGoal,
    load_robot,
    plan,
)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: JointGoal({"a": 0.1}), r"JointGoal: state is .*, it must be JointState .*from_mapping"),
        (lambda: PlanRequest("arm", "home"), r"goals is 'home', it must be a tuple of .*NamedGoal\("),
        (lambda: PlanRequest("arm", ["home"]), r"PlanRequest: goals is \['home'\]"),
        (lambda: PlanRequest(7, NamedGoal("home")), "group is 7, it must be text"),
        (lambda: PlanRequest("arm", NamedGoal("home"), start=[0.0]), "it must be JointState or None"),
        (lambda: PoseGoal([0.4, 0, 0.4]), r"T_world_link is \[0.4, 0, 0.4\], it must be SE3 "),
        (lambda: CartesianRequest("arm", np.zeros(3)), "waypoints is .*, it must be a tuple of SE3"),
        (lambda: CollisionObject("a", Box(1, 1, 1)), "CollisionObject: shapes is Box"),
        (lambda: CollisionObject("a", ((Box(1, 1, 1), [0, 0, 0]),)), "CollisionObject: shapes is"),
    ],
)  # fmt: skip
def test_a_field_of_another_type_is_named(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_lists_and_single_goals_and_waypoints_are_accepted():
    goal = JointGoal(JointState.from_mapping({"a": 0.1}))
    assert PlanRequest("arm", goal).goals == (goal,)
    assert PlanRequest("arm", [goal]).goals == [goal]
    pose = SE3.identity()
    assert CartesianRequest("arm", pose).waypoints == (pose,)


def test_planning_without_a_scene_or_request_and_scenes_of_shapes_are_explained():
    model = load_robot("parallel_gripper")
    scene = PlanningScene.of(model)
    with pytest.raises(InputError, match=r"plan\(\) needs a PlanningScene and a PlanRequest, not RobotModel"):
        plan(model, PlanRequest("gripper", NamedGoal("open")))
    with pytest.raises(InputError, match="not PlanningScene and str"):
        plan(scene, "home")
    with pytest.raises(
        InputError, match=r"consists of CollisionObjects, not of Box.*CollisionObject\.single"
    ):
        scene.with_object(Box(1, 1, 1))
