"""A cell's ompl_planning.yaml in the requests of MoveIt's clients."""

import pytest
import yaml

from armcell.cell import load
from armcell.core import SE3, Box, InputError
from armcell.ros import Bus, schema
from armcell.ros.nodes import MoveGroupNode, ServedCell
from armcell.scene import CollisionObject

S = schema()
CELL = "robot: panda\nros: {planners: planners.yaml}\n"
FILE = {
    "planner_configs": {"roadmap": {"type": "geometric::PRM"}, "EST": {"type": "geometric::EST"}},
    "arm": {"default_planner_config": "roadmap", "planner_configs": ["roadmap", "EST"]},
}


def cell_with(folder, planners):
    (folder / "planners.yaml").write_text(yaml.safe_dump(planners))
    (folder / "cell.yaml").write_text(CELL)
    return load(folder / "cell.yaml")


def asked(model, planner=""):
    joints = [
        S.new("moveit_msgs/JointConstraint", n, float(v) + (1.9 if n[-1] == "1" else 0.0), 1e-4, 1e-4, 1.0)
        for n, v in model.named_states["arm"]["home"].items()
    ]
    request = S.new(
        "moveit_msgs/MotionPlanRequest", group_name="arm", planner_id=planner, allowed_planning_time=20.0,
        goal_constraints=[S.new("moveit_msgs/Constraints", joint_constraints=joints)],
    )  # fmt: skip
    request.start_state.is_diff = True
    return request


@pytest.mark.slow
@pytest.mark.parametrize("wrapped", [False, True], ids=["ROS 1", "ROS 2"])
def test_clients_name_the_file_s_planners_and_get_its_default(tmp_path, wrapped):
    planners = {"/**": {"ros__parameters": {"ompl": FILE}}} if wrapped else FILE
    live = cell_with(tmp_path, planners).connect("fake", None, time_scale=20.0)
    rod = CollisionObject("rod", ((Box(0.06, 0.06, 0.5), SE3.identity()),), SE3.from_xyz(0.16, 0.27, 0.6))
    with (
        ServedCell(live, Bus(), plan=False) as served,
        MoveGroupNode(served.cell, Bus(), live.planner_configs) as node,
    ):
        scene = served.cell.edit_scene(lambda now: now.with_object(rod))
        for planner, used in {"": "PRM", "roadmap": "PRM", "EST": "EST", "RRTConnect": "RRTConnect"}.items():
            result = node.plan(asked(live.model, planner), scene)
            assert result.ok and result.planner_id == used, (planner, result)


def test_served_cells_take_the_file(tmp_path):
    bus = Bus()
    with ServedCell(cell_with(tmp_path, FILE).connect("fake", None, time_scale=20.0), bus) as served:
        model = served.live.model
        for planner, ok in (("roadmap", True), ("no_such", False)):
            request = S.new("moveit_msgs/GetMotionPlanRequest", asked(model, planner))
            answer = bus.call("/plan_kinematic_path", request).motion_plan_response
            assert (answer.error_code.val == 1) is ok


def test_a_default_that_does_not_exist_is_named_with_file_and_key(tmp_path):
    wrong = {**FILE, "arm": {"default_planner_config": "fast"}}
    with pytest.raises(InputError, match=r"planners.yaml.*arm/planner_configs.*fast"):
        cell_with(tmp_path, wrong)
