"""moveit_commander: every public method, with the defaults, returns and exceptions of the original."""

from __future__ import annotations

import inspect
import re
import time

import numpy as np
import pytest

from armcell.core import SE3
from armcell.kinematics import kinematic_tree
from armcell.ros.convert import pose_from_message

GROUP_METHODS = """
get_name stop get_active_joints get_joints get_variable_count has_end_effector_link
get_end_effector_link set_end_effector_link get_interface_description get_pose_reference_frame
set_pose_reference_frame get_planning_frame get_current_joint_values get_current_pose
get_current_rpy get_random_joint_values get_random_pose set_start_state_to_current_state
set_start_state get_current_state_bounded get_current_state get_joint_value_target
set_joint_value_target set_rpy_target set_orientation_target set_position_target set_pose_target
set_pose_targets shift_pose_target clear_pose_target clear_pose_targets set_random_target
get_named_targets set_named_target get_named_target_values remember_joint_values
get_remembered_joint_values forget_joint_values get_goal_tolerance get_goal_joint_tolerance
set_goal_joint_tolerance get_goal_position_tolerance set_goal_position_tolerance
get_goal_orientation_tolerance set_goal_orientation_tolerance set_goal_tolerance allow_looking
allow_replanning get_known_constraints get_path_constraints set_path_constraints
clear_path_constraints get_trajectory_constraints set_trajectory_constraints
clear_trajectory_constraints set_constraints_database get_planning_time set_planning_time
get_planning_pipeline_id set_planning_pipeline_id get_planner_id set_planner_id
set_num_planning_attempts set_workspace set_max_velocity_scaling_factor
set_max_acceleration_scaling_factor limit_max_cartesian_link_speed clear_max_cartesian_link_speed go
plan construct_motion_plan_request compute_cartesian_path execute attach_object detach_object pick
place set_support_surface_name retime_trajectory get_jacobian_matrix enforce_bounds
"""  # moveit_commander's documentation (Noetic)
SCENE_METHODS = """
add_object add_sphere add_cylinder add_cone add_mesh add_box add_plane attach_object attach_mesh
attach_box attach_sphere attach_cylinder clear remove_world_object remove_attached_object
get_known_object_names get_known_object_names_in_roi get_object_poses get_objects
get_attached_objects get_planning_scene apply_planning_scene make_box make_mesh make_sphere
make_cylinder make_cone make_plane
"""
ROBOT_METHODS = """
get_planning_frame get_robot_markers get_root_link get_active_joint_names get_joint_names
get_link_names get_group_names get_current_state get_current_variable_values get_joint get_link
get_group has_group get_default_owner_group
"""
HOME = (0.0, -0.785398163, 0.0, -2.35619449, 0.0, 1.570796327, 0.785398163)


@pytest.fixture
def mc(session):
    import moveit_commander

    moveit_commander.roscpp_initialize([])
    return moveit_commander


@pytest.fixture
def arm(mc):
    """The arm, at home, as fast as it can."""
    group = mc.MoveGroupCommander("panda_arm")
    group.set_max_velocity_scaling_factor(1.0)
    group.set_max_acceleration_scaling_factor(1.0)
    group.set_named_target("home")
    assert group.go()
    yield group
    mc.PlanningSceneInterface().remove_attached_object()
    for name in mc.PlanningSceneInterface().get_known_object_names():
        if name not in ("table", "cube"):
            mc.PlanningSceneInterface().remove_world_object(name)


@pytest.fixture
def scene(mc):
    return mc.PlanningSceneInterface()


def stamped(x, y, z, frame="world"):
    from geometry_msgs.msg import PoseStamped

    pose = PoseStamped()
    pose.header.frame_id = frame
    pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = x, y, z
    pose.pose.orientation.x = 1.0
    return pose


# --- the surface ---
def test_every_public_method_is_there(mc):
    for cls, names in (
        (mc.MoveGroupCommander, GROUP_METHODS),
        (mc.PlanningSceneInterface, SCENE_METHODS),
        (mc.RobotCommander, ROBOT_METHODS),
    ):
        missing = [n for n in re.findall(r"\w+", names) if not callable(getattr(cls, n, None))]
        assert not missing, (cls.__name__, missing)


def test_signatures_are_the_documented_ones(mc):
    def defaults(method):
        parameters = list(inspect.signature(method).parameters.values())[1:]
        return {p.name: p.default for p in parameters if p.default is not p.empty}

    group, scene = mc.MoveGroupCommander, mc.PlanningSceneInterface
    assert defaults(group.__init__) == {
        "robot_description": "robot_description",
        "ns": "",
        "wait_for_servers": 5.0,
    }
    assert defaults(group.go) == {"joints": None, "wait": True} and defaults(group.execute) == {"wait": True}
    assert defaults(group.retime_trajectory) == {
        "velocity_scaling_factor": 1.0, "acceleration_scaling_factor": 1.0,
        "algorithm": "iterative_time_parameterization",
    }  # fmt: skip
    assert defaults(scene.__init__) == {"ns": "", "synchronous": True, "service_timeout": 5.0}
    assert defaults(scene.add_plane) == {"normal": (0, 0, 1), "offset": 0}
    assert defaults(scene.add_box) == {"size": (1, 1, 1)} and defaults(scene.add_sphere) == {"radius": 1}
    assert defaults(mc.RobotCommander.__init__) == {"robot_description": "robot_description", "ns": ""}


def test_defaults(mc):
    arm = mc.MoveGroupCommander("panda_arm")
    assert arm.get_goal_tolerance() == (1e-4, 1e-4, 1e-3) and arm.get_planning_time() == 5.0
    request = arm.construct_motion_plan_request()
    assert request.num_planning_attempts == 1 and request.start_state.is_diff
    assert (request.max_velocity_scaling_factor, request.max_acceleration_scaling_factor) == (0.1, 0.1)
    assert (request.pipeline_id, request.planner_id) == ("", "")
    assert arm.get_known_constraints() == [] and arm.get_remembered_joint_values() == {}
    with pytest.raises(RuntimeError, match="Group 'leg' was not found"):
        mc.MoveGroupCommander("leg")


def test_information(arm, mc):
    assert arm.get_name() == "panda_arm" and arm.get_end_effector_link() == "panda_hand_tcp"
    assert (
        arm.get_active_joints() == [f"panda_joint{i}" for i in range(1, 8)] and arm.get_variable_count() == 7
    )
    assert arm.get_planning_frame() == arm.get_pose_reference_frame() == "world"
    assert arm.get_interface_description().planner_ids
    hand = mc.MoveGroupCommander("hand")
    assert not hand.has_end_effector_link() and hand.get_variable_count() == 2
    with pytest.raises(mc.MoveItCommanderException, match="no end effector"):
        hand.get_current_pose()
    with pytest.raises(mc.MoveItCommanderException, match="Unable to set end effector link"):
        arm.set_end_effector_link("tail")


# --- state ---
def test_the_present_state(arm, session):
    assert np.allclose(arm.get_current_joint_values(), HOME, atol=1e-3)
    T = session.served.cell.scene().frame_pose("panda_hand_tcp")
    pose = arm.get_current_pose()
    assert pose.header.frame_id == "world" and pose_from_message(pose.pose).isclose(T, 1e-6, 1e-6)
    assert np.allclose(arm.get_current_rpy(), T.rotation.rpy)
    assert arm.get_current_pose("panda_link4").pose != pose.pose
    state = arm.get_current_state()
    assert "panda_finger_joint2" in state.joint_state.name
    state.joint_state.position = tuple(9.0 for _ in state.joint_state.position)
    bounded = dict(zip(state.joint_state.name, arm.enforce_bounds(state).joint_state.position))
    assert bounded["panda_joint1"] == pytest.approx(2.8973)
    model = session.model
    for _ in range(20):
        model.check_positions(arm.get_random_joint_values(), arm.get_active_joints())
    assert arm.get_random_pose().header.frame_id == "world"


def test_the_jacobian_by_finite_differences(arm, session):
    q = np.array(arm.get_current_joint_values())
    J = np.asarray(arm.get_jacobian_matrix(list(q), [0.0, 0.0, 0.1]))
    tree, positions = kinematic_tree(session.model), session.served.cell.scene().positions.copy()
    columns = session.model.columns(arm.get_active_joints())

    def point(values):
        positions[columns] = values
        return tree.link_pose(positions, "panda_hand_tcp").apply(np.array([0, 0, 0.1]))

    for k in range(7):
        step = 1e-6 * (np.arange(7) == k)
        assert np.allclose(J[:3, k], (point(q + step) - point(q - step)) / 2e-6, atol=1e-6)


# --- targets ---
def test_joint_targets_in_all_their_forms(arm, mc):
    from sensor_msgs.msg import JointState

    values = [v + 0.1 for v in HOME]
    names = arm.get_active_joints()
    for target in (
        values,
        tuple(values),
        np.array(values),
        dict(zip(names, values)),
        JointState(name=names, position=values),
    ):
        arm.set_joint_value_target(list(HOME))
        assert arm.set_joint_value_target(target) is None
        assert np.allclose(arm.get_joint_value_target(), values)
    arm.set_joint_value_target("panda_joint1", 0.5)
    assert arm.get_joint_value_target()[0] == 0.5
    state = arm.get_current_state()
    arm.set_joint_value_target(state)
    assert np.allclose(arm.get_joint_value_target(), HOME, atol=1e-3)
    arm.set_joint_value_target(stamped(0.45, 0.1, 0.4))
    arm.go()
    p = arm.get_current_pose().pose.position
    assert np.allclose((p.x, p.y, p.z), (0.45, 0.1, 0.4), atol=2e-3)


@pytest.mark.parametrize(
    "arguments, text",
    [
        ((["a"],), "joint"), (([0.1, 0.2],), "7 joints"), (("panda_joint1",), "Joint value expected"),
        (("elbow", 0.1), "elbow"), (("panda_joint1", 4.0), "within bounds"),
        (("panda_joint1", 90.0), "degrees"),
        ((3.0,), "Unsupported argument"), (([0.0] * 7, 1), "Too many arguments"),
    ],
)  # fmt: skip
def test_joint_targets_that_cannot_be(arm, mc, arguments, text):
    with pytest.raises(mc.MoveItCommanderException, match=text):
        arm.set_joint_value_target(*arguments)


def test_pose_targets_in_all_their_forms(arm, mc):
    pose = stamped(0.4, 0.1, 0.3)
    for target in (pose, pose.pose, [0.4, 0.1, 0.3, np.pi, 0, 0], [0.4, 0.1, 0.3, 1, 0, 0, 0]):
        arm.clear_pose_targets()
        arm.set_pose_target(target)
        ok, trajectory, seconds, code = arm.plan()
        assert ok and code.val == 1 and seconds > 0 and trajectory.joint_trajectory.points
    cube = pose_from_message(mc.PlanningSceneInterface().get_object_poses(["cube"])["cube"])
    arm.set_pose_target(stamped(0.0, 0.0, 0.2, "cube"))  # in another frame
    assert arm.go()
    at = pose_from_message(arm.get_current_pose().pose)
    assert np.allclose(at.translation, cube.apply(np.array([0, 0, 0.2])), atol=2e-3)
    arm.set_pose_targets([[3.0, 0, 0, np.pi, 0, 0], pose.pose])  # any one of them
    assert arm.plan()[0]
    with pytest.raises(mc.MoveItCommanderException):
        arm.set_pose_target([1, 2])
    with pytest.raises(mc.MoveItCommanderException, match="roll, pitch, yaw"):
        arm.set_rpy_target([1, 2])


def test_a_pose_that_changes_after_it_was_given_changes_nothing(arm):
    pose = stamped(0.4, 0.1, 0.3)
    arm.set_pose_target(pose)
    pose.pose.position.z = 5.0
    assert arm.plan()[0]


def test_position_orientation_and_shifts(arm):
    arm.set_position_target([0.4, 0.0, 0.4])
    assert arm.go()
    assert np.allclose(pose_from_message(arm.get_current_pose().pose).translation, (0.4, 0, 0.4), atol=2e-3)
    arm.set_rpy_target([np.pi, 0.0, 0.5])
    assert arm.go()
    assert np.allclose(np.abs(arm.get_current_rpy()), (np.pi, 0, 0.5), atol=5e-3)
    before = pose_from_message(arm.get_current_pose().pose)
    arm.shift_pose_target(2, -0.05)
    assert arm.go()
    moved = pose_from_message(arm.get_current_pose().pose)
    assert np.allclose(moved.translation - before.translation, (0, 0, -0.05), atol=2e-3)


def test_named_and_remembered_targets(arm, mc):
    assert {"home", "extended"} <= set(arm.get_named_targets())
    assert arm.get_named_target_values("home")["panda_joint4"] == pytest.approx(-2.35619449)
    arm.set_named_target("home")
    with pytest.raises(mc.MoveItCommanderException, match="Unable to set target nowhere"):
        arm.set_named_target("nowhere")
    arm.remember_joint_values("here")
    arm.remember_joint_values("there", [v + 0.1 for v in HOME])
    assert arm.go("there")
    assert np.allclose(arm.get_current_joint_values(), np.array(HOME) + 0.1, atol=2e-3)
    arm.set_named_target("here")
    assert arm.go() and set(arm.get_remembered_joint_values()) == {"here", "there"}
    arm.forget_joint_values("here")
    assert "here" not in arm.get_named_targets()


# --- settings ---
def test_settings_reach_the_request(arm, mc):
    from moveit_msgs.msg import Constraints, OrientationConstraint

    arm.set_goal_tolerance(0.005)
    assert arm.get_goal_tolerance() == (0.005, 0.005, 0.005)
    arm.set_planning_time(2.0)
    arm.set_num_planning_attempts(4)
    arm.set_planner_id("RRTConnectkConfigDefault")
    arm.set_planning_pipeline_id("ompl")
    arm.set_workspace([-1, -1, 1, 1])
    arm.limit_max_cartesian_link_speed(0.2, "panda_hand")
    level = Constraints(orientation_constraints=[OrientationConstraint(link_name="panda_hand")])
    arm.set_path_constraints(level)
    request = arm.construct_motion_plan_request()
    assert (request.allowed_planning_time, request.num_planning_attempts) == (2.0, 4)
    assert (request.planner_id, request.pipeline_id) == ("RRTConnectkConfigDefault", "ompl")
    assert request.workspace_parameters.min_corner.x == -1 and request.max_cartesian_speed == 0.2
    assert arm.get_path_constraints() == level == request.path_constraints
    arm.clear_path_constraints()
    assert not arm.get_path_constraints().orientation_constraints
    for bad in (0.0, 1.5, -1):
        with pytest.raises(mc.MoveItCommanderException, match="range from 0 to 1"):
            arm.set_max_velocity_scaling_factor(bad)
    with pytest.raises(mc.MoveItCommanderException, match="0, 4 or 6"):
        arm.set_workspace([1, 2])
    with pytest.raises(mc.MoveItCommanderException, match="path constraints"):
        arm.set_path_constraints("upright")


# --- acting ---
def test_plan_and_execute(arm):
    ok, trajectory, _, code = arm.plan(dict(zip(arm.get_active_joints(), np.array(HOME) + 0.2)))
    assert ok and code.val == 1
    assert arm.execute(trajectory) is True
    assert np.allclose(arm.get_current_joint_values(), np.array(HOME) + 0.2, atol=2e-3)
    assert arm.execute(trajectory) is False  # from where it no longer is


def test_a_plan_that_fails_says_so_and_is_not_executed(arm, session):
    arm.set_pose_target(stamped(3.0, 0.0, 0.0))
    plan = arm.plan()
    assert plan[0] is False and plan[3].val < 0
    assert plan  # the tuple itself is true, as in MoveIt
    assert arm.execute(plan) is False and "plan tuple" in session.hints


def test_the_tuple_of_plan_is_executed_as_its_trajectory(arm):
    arm.set_named_target("extended")
    assert arm.execute(arm.plan()) is True


def test_async_motion_and_stop(arm):
    arm.set_max_velocity_scaling_factor(0.02)
    before = arm.get_current_joint_values()
    assert arm.go([v + 0.5 for v in HOME], wait=False) is True
    end = time.monotonic() + 20
    while arm.get_current_joint_values()[0] < before[0] + 2e-3 and time.monotonic() < end:
        time.sleep(0.005)
    arm.stop()
    time.sleep(0.2)
    there = arm.get_current_joint_values()
    assert there[0] > before[0] + 1e-3 and there[0] < before[0] + 0.45
    time.sleep(0.1)
    assert np.allclose(arm.get_current_joint_values(), there, atol=1e-3)


def test_a_start_state_of_ones_own(arm):
    state = arm.get_current_state()
    state.joint_state.position = tuple(
        0.5 if n == "panda_joint1" else p for n, p in zip(state.joint_state.name, state.joint_state.position)
    )
    arm.set_start_state(state)
    arm.set_named_target("home")
    first = arm.plan()[1].joint_trajectory.points[0]
    assert first.positions[0] == pytest.approx(0.5)
    arm.set_start_state_to_current_state()
    assert arm.plan()[1].joint_trajectory.points[0].positions[0] == pytest.approx(0.0, abs=1e-3)


def test_cartesian_paths_and_the_argument_that_changed_its_meaning(arm, session):
    import copy

    here = arm.get_current_pose().pose
    down = copy.deepcopy(here)
    down.position.z -= 0.1
    for more in ((), (0.0,), (True,), (0.0, True), (0.0, True, None)):
        trajectory, fraction = arm.compute_cartesian_path([down], 0.01, *more)
        assert fraction == 1.0 and trajectory.joint_trajectory.points
    assert "jump_threshold" in session.hints
    assert arm.execute(trajectory)
    at = pose_from_message(arm.get_current_pose().pose)
    assert at.translation[2] == pytest.approx(down.position.z, abs=2e-3)
    through = copy.deepcopy(here)
    through.position.z = -0.05  # into the table
    assert arm.compute_cartesian_path([through], 0.01, 0.0)[1] < 1.0
    assert arm.compute_cartesian_path([through], 0.01, 0.0, False)[1] == 1.0  # collisions not looked at
    assert arm.compute_cartesian_path([through], 0.01, False)[1] == 1.0


def test_retiming(arm):
    arm.set_named_target("extended")
    trajectory = arm.plan()[1]
    fast = arm.retime_trajectory(arm.get_current_state(), trajectory)
    slow = arm.retime_trajectory(arm.get_current_state(), trajectory, velocity_scaling_factor=0.25)

    def seconds(message):
        return message.joint_trajectory.points[-1].time_from_start.to_sec()

    assert seconds(slow) > 2 * seconds(fast)
    ends = [m.joint_trajectory.points[-1].positions for m in (trajectory, fast, slow)]
    assert np.allclose(ends[0], ends[1]) and np.allclose(ends[0], ends[2])
    assert not arm.retime_trajectory(None, trajectory, algorithm="magic").joint_trajectory.points


# --- the scene ---
def test_objects(arm, scene):
    scene.add_box("box", stamped(0.0, 0.6, 0.3), size=(0.1, 0.2, 0.3))
    scene.add_sphere("ball", stamped(0.0, -0.6, 0.3), 0.1)
    scene.add_cylinder("can", stamped(0.3, -0.6, 0.3), 0.2, 0.05)
    scene.add_cone("hat", stamped(0.3, 0.6, 0.3), 0.2, 0.05)
    scene.add_plane("wall", stamped(0, 0, 0), normal=(1, 0, 0), offset=0.8)
    names = set(scene.get_known_object_names())  # at once
    assert {"table", "cube", "box", "ball", "can", "hat", "wall"} <= names
    box = scene.get_objects(["box"])["box"]
    assert list(box.primitives[0].dimensions) == [0.1, 0.2, 0.3]
    assert pose_from_message(scene.get_object_poses(["box"])["box"]).translation[1] == pytest.approx(0.6)
    assert scene.get_known_object_names_in_roi(-0.1, 0.5, 0.2, 0.1, 0.7, 0.4) == ["box"]
    assert scene.get_known_object_names(with_type=True) == []
    scene.remove_world_object("box")
    assert "box" not in scene.get_known_object_names()
    assert scene.get_planning_scene(8).world.collision_objects


def test_a_mesh(arm, scene, mc, tmp_path):
    import trimesh

    file = tmp_path / "block.stl"
    trimesh.creation.box((1, 1, 1)).export(file)
    scene.add_mesh("block", stamped(0.0, 0.7, 0.4), str(file), size=(0.1, 0.2, 0.3))
    vertices = scene.get_objects(["block"])["block"].meshes[0].vertices
    assert max(v.z for v in vertices) == pytest.approx(0.15) and max(v.y for v in vertices) == pytest.approx(
        0.1
    )
    with pytest.raises(mc.MoveItCommanderException):
        scene.add_mesh("none", stamped(0, 0, 0), str(tmp_path / "none.stl"))


def test_attaching(arm, scene):
    scene.attach_box("panda_hand", "tool", stamped(0, 0, 0.2, "panda_hand"), size=(0.02, 0.02, 0.1))
    tool = scene.get_attached_objects()["tool"]
    assert tool.link_name == "panda_hand" and tool.touch_links == ["panda_hand"]
    scene.remove_attached_object("panda_hand", "tool")
    assert "tool" in scene.get_known_object_names()  # it stays in the world
    scene.remove_world_object("tool")
    scene.add_box("part", stamped(0.4, -0.3, 0.3), size=(0.05, 0.05, 0.05))
    assert arm.attach_object("part") is True
    attached = scene.get_attached_objects(["part"])["part"]
    assert attached.link_name == "panda_hand_tcp" and "panda_leftfinger" in attached.touch_links
    assert arm.detach_object("part") is True and arm.detach_object("part") is False
    assert not scene.get_attached_objects()


def test_what_the_planning_scene_refuses_is_said(scene, session):
    count = len(session.lines)
    scene.add_box("lost", stamped(0, 0, 0, "no_frame"))
    assert "lost" not in scene.get_known_object_names() and "lost" in " ".join(session.lines[count:])


def test_topics_instead_of_services(arm, mc, scene):
    mc.PlanningSceneInterface(synchronous=False).add_box("late", stamped(0.0, 0.6, 0.3), size=(0.1, 0.1, 0.1))
    end = time.monotonic() + 5
    while "late" not in scene.get_known_object_names() and time.monotonic() < end:
        time.sleep(0.01)
    assert "late" in scene.get_known_object_names()


# --- the robot ---
def test_the_robot(arm, mc):
    robot = mc.RobotCommander()
    assert robot.get_root_link() == "panda_link0" and robot.get_planning_frame() == "world"
    assert {"panda_arm", "hand"} <= set(robot.get_group_names()) and robot.has_group("hand")
    assert "panda_finger_joint2" in robot.get_joint_names() and "panda_hand" in robot.get_link_names()
    assert robot.get_active_joint_names("panda_arm") == arm.get_active_joints()
    assert robot.get_default_owner_group("panda_joint1") == "panda_arm"
    joint = robot.get_joint("panda_joint1")
    assert joint.bounds() == [joint.min_bound(), joint.max_bound()] and joint.variable_count() == 1
    assert joint.move(0.3) and joint.value() == pytest.approx(0.3, abs=2e-3)
    assert robot.panda_arm.get_name() == "panda_arm" and robot.panda_joint1.name() == "panda_joint1"
    T = pose_from_message(robot.get_link("panda_link0").pose().pose)
    assert T.isclose(SE3.identity(), 1e-9, 1e-9)
    assert robot.get_current_variable_values()["panda_joint1"] == pytest.approx(0.3, abs=2e-3)
    assert len(robot.get_robot_markers().markers) > 8
    for wrong in (lambda: robot.get_group("leg"), lambda: robot.get_joint("x"), lambda: robot.get_link("x")):
        with pytest.raises(mc.MoveItCommanderException):
            wrong()
    with pytest.raises(AttributeError):
        robot.no_such_part  # noqa: B018


# --- conversions ---
def test_conversions(mc):
    from geometry_msgs.msg import Pose

    values = [0.1, 0.2, 0.3, 0.0, 0.0, 0.6, 0.8]
    pose = mc.conversions.list_to_pose(values)
    assert mc.conversions.pose_to_list(pose) == values
    assert mc.conversions.list_to_pose([0, 0, 0, np.pi, 0, 0]).orientation.x == pytest.approx(1.0)
    assert mc.conversions.list_to_pose_stamped(values, "base").header.frame_id == "base"
    assert mc.conversions.transform_to_list(mc.conversions.list_to_transform(values)) == values
    copy = Pose()
    mc.conversions.msg_from_string(copy, mc.conversions.msg_to_string(pose))
    assert copy == pose
    with pytest.raises(mc.MoveItCommanderException, match="6 or 7"):
        mc.conversions.list_to_pose([1, 2])


# --- grasping, as objects move without physics ---
def test_pick_and_place(arm, scene, mc):
    assert arm.pick("nothing") == -19  # INVALID_OBJECT_NAME
    assert arm.pick("cube") == 1
    assert "cube" in scene.get_attached_objects() and "cube" not in scene.get_known_object_names()
    target = stamped(0.40, -0.15, 0.0255)
    target.pose.orientation.x, target.pose.orientation.w = 0.0, 1.0
    assert arm.place("cube", target) == 1
    assert "cube" in scene.get_known_object_names()
    at = pose_from_message(scene.get_object_poses(["cube"])["cube"]).translation
    assert np.allclose(at[:2], (0.40, -0.15), atol=2e-3)
    assert arm.place("cube", target) == -19
    with pytest.raises(mc.MoveItCommanderException, match="location"):
        arm.place("cube", ["here"])
