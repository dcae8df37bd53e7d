"""moveit_msgs and armcell's values: round trips, and messages written by hand read as MoveIt means them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from armcell.cell import load
from armcell.core import (
    SE3,
    SO3,
    Box,
    Capsule,
    Cone,
    ConstraintGoal,
    Constraints,
    Cylinder,
    ErrorCode,
    InputError,
    JointConstraint,
    JointGoal,
    JointTrajectory,
    Mesh,
    OrientationConstraint,
    Plane,
    PoseGoal,
    PositionConstraint,
    Sphere,
    UnknownNameError,
    VisibilityConstraint,
)
from armcell.ros import cdr_codec, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.convert import pose_from_message, pose_message, trajectory_from_message
from armcell.ros.moveit_convert import (
    Components,
    attached_changes,
    cartesian_request_from_message,
    constraints_from_message,
    constraints_message,
    diff_from_message,
    goal_from_message,
    object_changes,
    object_from_message,
    object_message,
    plan_request_from_message,
    robot_state_from_message,
    robot_trajectory_message,
    scene_message,
)
from armcell.scene import CollisionObject, PlanningScene, SceneDiff

S = schema()
TETRAHEDRON = Mesh(
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)
T1 = SE3.from_xyz_rpy((0.1, -0.2, 0.3), (0.4, -0.5, 0.6))
T2 = SE3.from_xyz_rpy((0.0, 0.05, 0.0), (0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def scene() -> PlanningScene:
    return load("panda_pick").scene()


def header(frame="world"):
    return S.new("std_msgs/Header", frame_id=frame)


def new(name, *values, **fields):
    return S.new(f"moveit_msgs/{name}", *values, **fields)


def solid(kind, *sizes):
    return S.new("shape_msgs/SolidPrimitive", kind, list(sizes))


def over_the_wires(message):
    """The message as both encodings bring it."""
    for codec in (ros1_codec(), cdr_codec()):
        yield codec.decode(message._type, bytes(codec.encode(message)))


# --- shapes and objects ---
SHAPES = [Box(0.1, 0.2, 0.3), Sphere(0.4), Cylinder(0.1, 0.5), Cone(0.2, 0.6), Plane(), TETRAHEDRON]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_an_object_comes_back_as_it_went(shape):
    item = CollisionObject("thing", ((shape, T2),), T1, subframes={"tip": T2})
    for message in over_the_wires(object_message(S, header(), item)):
        back = object_from_message(message)
        assert back.name == "thing" and back.T_world_object.isclose(T1, 1e-6, 1e-6)
        found, T = back.shapes[0]
        assert T.isclose(T2, 1e-6, 1e-6) and back.subframes["tip"].isclose(T2, 1e-6, 1e-6)
        if isinstance(shape, Mesh):
            assert np.allclose(found.vertices, shape.vertices) and np.array_equal(found.faces, shape.faces)
        else:
            assert found == shape


def test_dimensions_are_in_the_order_of_shape_msgs():
    message = object_message(S, header(), CollisionObject.single("c", Cylinder(radius=0.1, length=0.5)))
    assert message.primitives[0].type == 3 and list(message.primitives[0].dimensions) == [0.5, 0.1]
    message = object_message(S, header(), CollisionObject.single("c", Cone(radius=0.2, length=0.7)))
    assert message.primitives[0].type == 4 and list(message.primitives[0].dimensions) == [0.7, 0.2]


def test_a_capsule_becomes_solids_that_fill_it():
    message = object_message(S, header(), CollisionObject.single("c", Capsule(0.1, 0.4)))
    low, high = CollisionObject("c", object_from_message(message).shapes).bounds()
    assert np.allclose(high - low, (0.2, 0.2, 0.6))


def test_a_plane_is_where_its_equation_says():
    message = new("CollisionObject", id="floor", planes=[S.new("shape_msgs/Plane", [0.0, 0.0, 2.0, -1.0])])
    item = object_from_message(message)  # 2 z - 1 = 0
    whole = item.T_world_object @ item.shapes[0][1]
    assert np.allclose(whole.translation, (0, 0, 0.5)) and np.allclose(whole.rotation.matrix[:, 2], (0, 0, 1))


def test_one_shape_without_an_object_pose_gives_the_object_its_own():
    message = new("CollisionObject", id="box", primitives=[solid(1, 0.1, 0.1, 0.1)])
    message.primitive_poses = [pose_message(S, T1)]
    item = object_from_message(message)
    assert item.T_world_object.isclose(T1, 1e-9, 1e-9) and item.shapes[0][1].isclose(SE3.identity())


def polygon(*corners):
    return S.new("geometry_msgs/Polygon", [S.new("geometry_msgs/Point32", *c, 7.0) for c in corners])


L_SHAPE = ((0, 0), (2, 0), (2, 1), (1, 1), (1, 3), (0, 3))


@pytest.mark.parametrize("corners", [L_SHAPE, L_SHAPE[::-1], ((0, 0), (1, 0), (1, 1), (0, 1))])
def test_a_prism_of_ros2_is_a_closed_mesh(corners):
    """Extruded by half its height to both sides; either order of the corners."""
    message = new("CollisionObject", id="x", primitives=[S.new("shape_msgs/SolidPrimitive", 5, [0.5])])
    message.primitives[0].polygon = polygon(*corners)
    shape = object_from_message(message).shapes[0][0]
    solid_ = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    assert solid_.is_watertight and solid_.is_winding_consistent
    assert solid_.volume == pytest.approx(0.5 * (4.0 if len(corners) == 6 else 1.0))
    assert solid_.bounds[:, 2] == pytest.approx([-0.25, 0.25])
    for back in over_the_wires(object_message(S, header(), object_from_message(message))):
        assert len(object_from_message(back).shapes[0][0].faces) == len(shape.faces)


@pytest.mark.parametrize(
    "corners", [(), ((0, 0), (1, 0)), ((0, 0), (1, 0), (2, 0)), ((0, 0), (2, 2), (2, 0), (0, 2), (1, 5))]
)
def test_impossible_prisms_are_refused(corners):
    message = S.new("shape_msgs/SolidPrimitive", 5, [0.5], polygon(*corners))
    with pytest.raises(InputError, match="prism"):
        object_from_message(new("CollisionObject", id="x", primitives=[message]))


@pytest.mark.parametrize(
    "kind, sizes",
    [(0, [1.0]), (9, [1.0]), (5, [1.0]), (1, [1.0, 1.0]), (2, [0.0]), (3, [1.0, -1.0]), (2, [np.nan])],
)
def test_impossible_primitives_are_refused(kind, sizes):
    with pytest.raises(InputError):
        object_from_message(new("CollisionObject", id="x", primitives=[solid(kind, *sizes)]))


def test_a_mesh_that_names_no_vertex_is_refused():
    triangle = S.new("shape_msgs/MeshTriangle", [0, 1, 7])
    mesh = S.new("shape_msgs/Mesh", [triangle], [S.new("geometry_msgs/Point")] * 3)
    with pytest.raises(InputError):
        object_from_message(new("CollisionObject", id="x", meshes=[mesh]))


def test_poses_zero_quaternions_and_wrong_ones():
    assert pose_from_message(S.new("geometry_msgs/Pose")).isclose(SE3.identity())
    assert pose_from_message(pose_message(S, T1)).isclose(T1, 1e-9, 1e-9)
    for bad in ((0, 0, 0, 2.0), (np.nan, 0, 0, 1)):
        with pytest.raises(InputError):
            pose_from_message(
                S.new("geometry_msgs/Pose", orientation=S.new("geometry_msgs/Quaternion", *bad))
            )


# --- constraints and goals ---
WANTED = Constraints(
    joints=(JointConstraint("panda_joint1", 0.3, 0.1, 0.2),),
    positions=(
        PositionConstraint(((Box(0.1, 0.2, 0.3), T1), (Sphere(0.1), T2)), "panda_hand", (0, 0, 0.1), "cube"),
    ),
    orientations=(
        OrientationConstraint(
            SO3.from_rpy((0.1, 0.2, 0.3)), (0.1, 0.2, 3.2), "panda_hand", "world", "xyz_euler"
        ),
    ),
    name="all",
    visibilities=(VisibilityConstraint("panda_hand", T1, 0.05, "cube", T2, "x", 0.3, 0.4, 8),),
)


def test_constraints_come_back_as_they_went():
    for message in over_the_wires(constraints_message(S, WANTED)):
        back = constraints_from_message(message)
        assert back.joints == WANTED.joints and back.name == "all"
        mine, its = WANTED.positions[0], back.positions[0]
        assert (its.link, its.point, its.frame) == (mine.link, mine.point, mine.frame)
        for (shape, T), (shape2, T_2) in zip(mine.region, its.region, strict=True):
            assert shape == shape2 and T.isclose(T_2, 1e-6, 1e-6)
        mine, its = WANTED.orientations[0], back.orientations[0]
        assert np.allclose(mine.rotation.matrix, its.rotation.matrix)
        assert (its.tolerance, its.link, its.parameterization) == (mine.tolerance, mine.link, "xyz_euler")
        its = back.visibilities[0]
        assert (its.sensor, its.frame, its.view_axis, its.cone_sides) == ("panda_hand", "cube", "x", 8)
        assert its.T_frame_target.isclose(T1, 1e-6, 1e-6) and its.T_link_sensor.isclose(T2, 1e-6, 1e-6)


def test_what_moveit_commander_sends_for_a_pose_is_a_pose_goal(scene):
    turned = S.new("geometry_msgs/Quaternion", x=1.0)
    at = S.new("geometry_msgs/Pose", S.new("geometry_msgs/Point", 0.1, 0.0, 0.2))
    volume = new("BoundingVolume", [solid(2, 0.003)], [at], [], [])
    tcp, offset = "panda_hand_tcp", S.new("geometry_msgs/Vector3")
    message = new(
        "Constraints",
        position_constraints=[new("PositionConstraint", header("cube"), tcp, offset, volume, 1.0)],
        orientation_constraints=[new("OrientationConstraint", header("cube"), turned, tcp, 0.01, 0.01, 0.01)],
    )
    goal = goal_from_message(message, scene)
    cube = scene.objects["cube"].T_world_object
    assert isinstance(goal, PoseGoal) and goal.link == tcp
    assert goal.position_tolerance == 0.003 and goal.orientation_tolerance == 0.01
    assert np.allclose(goal.T_world_link.translation, cube.apply(np.array([0.1, 0, 0.2])))
    assert np.allclose(goal.T_world_link.rotation.matrix, cube.rotation.matrix @ np.diag([1, -1, -1.0]))


def joints(*rows):
    return new("Constraints", joint_constraints=[new("JointConstraint", *row, 1.0) for row in rows])


def test_joint_goals_and_regions(scene):
    goal = goal_from_message(
        joints(("panda_joint1", 0.1, 0.001, 0.001), ("panda_joint2", 0.2, 0.001, 0.001)), scene
    )
    assert isinstance(goal, JointGoal) and goal.tolerance == 0.001
    assert goal.state.as_dict() == {"panda_joint1": 0.1, "panda_joint2": 0.2}
    assert isinstance(goal_from_message(joints(("panda_joint1", 0.1, 0.5, 0.0)), scene), ConstraintGoal)
    with pytest.raises(InputError, match="no constraints"):
        goal_from_message(new("Constraints"), scene)


# --- requests ---
def request(**fields):
    goal = joints(("panda_joint1", 0.1, 1e-4, 1e-4))
    return new("MotionPlanRequest", group_name="arm", goal_constraints=[goal], **fields)


def test_a_goal_as_moveit_commander_sends_it(scene):
    """Empty pipeline and planner, is_diff, scaling 0.1, empty workspace frame."""
    asked = request(num_planning_attempts=10, allowed_planning_time=5.0, max_velocity_scaling_factor=0.1)
    asked.start_state.is_diff = True
    made = plan_request_from_message(asked, scene)
    assert (made.group, made.attempts, made.planning_time, made.velocity_scaling) == ("arm", 10, 5.0, 0.1)
    assert made.start is None and made.workspace is None and "fix_start_state_collision" in made.adapters


def test_what_is_left_out_is_what_move_group_takes_for_it(scene):
    made = plan_request_from_message(request(), scene)
    assert (made.attempts, made.planning_time) == (1, 5.0)
    assert (made.velocity_scaling, made.acceleration_scaling) == (1.0, 1.0)
    assert plan_request_from_message(request(max_velocity_scaling_factor=7.0), scene).velocity_scaling == 1.0


def test_a_partial_start_state_merges_with_the_present_one(scene):
    asked = request()
    asked.start_state.joint_state.name = ["panda_joint3", "panda_finger_joint2"]
    asked.start_state.joint_state.position = [0.5, 0.01]
    start = plan_request_from_message(asked, scene).start
    assert start is not None and start.as_dict() == {
        "panda_joint3": 0.5
    }  # the second finger mimics the first
    asked.start_state.joint_state.name[0] = "elbow"
    with pytest.raises(UnknownNameError, match="elbow"):
        plan_request_from_message(asked, scene)
    assert robot_state_from_message(new("RobotState"), scene) is None


def test_workspaces_of_scripts_count_and_those_of_rviz_do_not(scene):
    asked = request()
    asked.workspace_parameters.min_corner = S.new("geometry_msgs/Vector3", -1.0, -1.0, 0.0)
    asked.workspace_parameters.max_corner = S.new("geometry_msgs/Vector3", 1.0, 1.0, 1.0)
    assert plan_request_from_message(asked, scene).workspace == ((-1, -1, 0), (1, 1, 1))
    asked.workspace_parameters.header.frame_id = "world"
    assert plan_request_from_message(asked, scene).workspace is None


def test_scalings_of_a_cartesian_request_which_only_ros2_has(scene):
    asked = new("GetCartesianPathRequest", group_name="arm", max_step=0.01)
    asked.waypoints = [pose_message(S, SE3.identity())]
    made = cartesian_request_from_message(asked, scene)
    assert (made.velocity_scaling, made.acceleration_scaling) == (1.0, 1.0)
    asked.max_velocity_scaling_factor, asked.max_acceleration_scaling_factor = 0.25, 0.5
    made = cartesian_request_from_message(asked, scene)
    assert (made.velocity_scaling, made.acceleration_scaling) == (0.25, 0.5)


def test_the_speed_link_has_another_name_in_humble(scene):
    asked = new("MotionPlanRequest", group_name="arm", max_cartesian_speed=0.1)
    asked.goal_constraints = [new("Constraints", joint_constraints=[new("JointConstraint", "panda_joint1")])]
    asked.cartesian_speed_end_effector_link = "panda_hand"
    assert plan_request_from_message(asked, scene).speed_link == "panda_hand"
    asked.cartesian_speed_limited_link = "panda_link8"
    assert plan_request_from_message(asked, scene).speed_link == "panda_link8"


def test_a_cartesian_request(scene):
    asked = new("GetCartesianPathRequest", group_name="arm", max_step=0.01, avoid_collisions=True)
    asked.header.frame_id = "cube"
    asked.waypoints = [pose_message(S, T1)]
    made = cartesian_request_from_message(asked, scene)
    assert made.waypoints[0].isclose(scene.objects["cube"].T_world_object @ T1, 1e-9, 1e-9)
    assert made.jump_threshold == 0.2 and made.relative_jump_threshold == 0.0
    asked.jump_threshold = 3.0
    made = cartesian_request_from_message(asked, scene)
    assert (made.relative_jump_threshold, made.jump_threshold) == (3.0, 0.0)
    asked.max_step = 0.0
    with pytest.raises(InputError, match="step"):
        cartesian_request_from_message(asked, scene)


def test_a_trajectory_comes_back_as_it_went(scene):
    names = scene.model.group("arm").joint_names
    q = scene.state.reindexed(names).positions + np.random.default_rng(0).uniform(-0.1, 0.1, (3, 7))
    sent = JointTrajectory(names, np.array([0.0, 0.5, 1.25]), q, 2 * q, 3 * q)
    for message in over_the_wires(robot_trajectory_message(S, header(), sent)):
        back = trajectory_from_message(message.joint_trajectory, scene.model, scene.state)
        assert back.joint_names == names and np.allclose(back.times, sent.times, atol=1e-9)
        for a, b in ((back.positions, q), (back.velocities, 2 * q), (back.accelerations, 3 * q)):
            assert np.array_equal(a, b)


# --- scenes ---
def test_a_scene_comes_back_as_it_went(scene):
    held = scene.with_attached("cube", "panda_hand", ("panda_leftfinger",))
    held = held.with_padding(0.01, {"panda_hand": 0.03}).with_fixed_frame("camera", T1)
    held = held.with_allowed("wall", "panda_link5")
    for message in over_the_wires(scene_message(S, header(), held)):
        back = scene.apply(diff_from_message(message, scene))
        assert set(back.objects) == set(held.objects) and set(back.attached) == {"cube"}
        mine, its = held.attached["cube"], back.attached["cube"]
        assert its.T_link_object.isclose(mine.T_link_object, 1e-6, 1e-6)
        assert its.touch_links == mine.touch_links
        assert its.object.mass == scene.objects["cube"].mass  # what messages lack is kept
        assert back.fixed_frames["camera"].isclose(T1, 1e-6, 1e-6)
        bodies = [n for n, link in scene.model.links.items() if link.collisions] + list(back.objects)
        for a in bodies:
            assert all(back.is_allowed(a, b) == held.is_allowed(a, b) for b in bodies if a != b), a
        assert back.link_padding["panda_hand"] == 0.03 and back.link_padding["panda_link5"] == 0.01


def test_components_that_are_not_asked_for_are_not_sent(scene):
    message = scene_message(S, header(), scene, Components.WORLD_OBJECT_NAMES)
    assert [o.id for o in message.world.collision_objects] == list(scene.objects)
    assert not message.world.collision_objects[0].primitives and not message.robot_state.joint_state.name
    message = scene_message(S, header(), scene, Components.ROBOT_STATE)
    assert not message.world.collision_objects
    assert "panda_finger_joint2" in message.robot_state.joint_state.name  # mimic joints as well


def test_components_are_moveits():
    constants = {n: v for n, _, v in S.definition("moveit_msgs/PlanningSceneComponents").constants}
    assert constants == {c.name: int(c) for c in Components}


def test_operations_of_collision_objects(scene):
    def applied(**fields):
        return scene.apply(SceneDiff(tuple(object_changes(new("CollisionObject", **fields), scene))))

    ball, T_cube = [solid(2, 0.1)], scene.objects["cube"].T_world_object
    added = applied(id="ball", header=header("cube"), pose=pose_message(S, T1), primitives=ball, operation=0)
    assert added.objects["ball"].T_world_object.isclose(T_cube @ T1, 1e-9, 1e-9)
    assert "wall" not in applied(id="wall", operation=1).objects
    assert not applied(id="", operation=1).objects
    assert applied(id="nobody", operation=1).objects.keys() == scene.objects.keys()
    assert len(applied(id="wall", primitives=ball, operation=2).objects["wall"].shapes) == 2
    moved = applied(id="wall", pose=pose_message(S, T1), operation=3)
    assert moved.objects["wall"].T_world_object.isclose(T1, 1e-9, 1e-9)
    with pytest.raises(InputError, match="operation 7"):
        applied(id="wall", operation=7)
    with pytest.raises(InputError, match="nowhere"):
        applied(id="ball", header=header("nowhere"), primitives=ball)


def test_attaching_and_detaching(scene):
    def change(into, link, touch=(), **fields):
        message = new("AttachedCollisionObject", link, new("CollisionObject", **fields), list(touch))
        return into.apply(SceneDiff(tuple(attached_changes(message, into))))

    held = change(scene, "panda_hand", ("panda_leftfinger",), id="cube")
    assert held.attached["cube"].link == "panda_hand"
    assert held.attached["cube"].touch_links == {"panda_hand", "panda_leftfinger"}
    tool = {"id": "tool", "primitives": [solid(1, 0.1, 0.1, 0.1)], "pose": pose_message(S, T1)}
    more = change(held, "panda_hand", header=header("panda_hand"), **tool)
    assert more.attached["tool"].T_link_object.isclose(T1, 1e-9, 1e-9)
    assert set(change(more, "", id="cube", operation=1).attached) == {"tool"}
    assert not change(more, "panda_hand", operation=1).attached
    assert "cube" in change(more, "", operation=1).objects  # it stays in the world


def test_a_diff_leaves_what_it_does_not_name_and_a_whole_scene_does_not(scene):
    message = new("PlanningScene", is_diff=True)
    message.world.collision_objects = [new("CollisionObject", id="box", primitives=[solid(1, 0.1, 0.1, 0.1)])]
    assert set(scene.apply(diff_from_message(message, scene)).objects) == {*scene.objects, "box"}
    message.is_diff = False
    assert set(scene.apply(diff_from_message(message, scene)).objects) == {"box"}
    assert scene.apply(diff_from_message(new("PlanningScene"), scene)).objects == scene.objects


def test_allowing_the_target_in_a_diff(scene):
    """Way B of Unity tutorials: the matrix in the request names hand and target only."""
    Entry = S.message("moveit_msgs/AllowedCollisionEntry")
    names, rows = ["panda_leftfinger", "cube"], [Entry([False, True]), Entry([True, False])]
    message = new("PlanningScene", is_diff=True)
    message.allowed_collision_matrix = new(
        "AllowedCollisionMatrix", names, rows, ["tray", "nobody"], [True, True]
    )
    after = scene.apply(diff_from_message(message, scene))
    assert after.is_allowed("panda_leftfinger", "cube") and not scene.is_allowed("panda_leftfinger", "cube")
    assert after.is_allowed("panda_link0", "panda_link1")  # as before
    message.allowed_collision_matrix.entry_values.pop()
    with pytest.raises(InputError, match="2 by 2"):
        diff_from_message(message, scene)


@pytest.mark.slow  # the reader is compiled
def test_an_octomap_in_a_scene(scene):
    """Eight cells of 0.1 m in OctoMap's binary form: in fifteen nodes the first child alone has children."""
    data = b"\x03\x00" * 15 + b"\xaa\xaa"  # 10 10 10 10 ... as stored: occupied
    message = new("PlanningScene", is_diff=True)
    octomap = message.world.octomap.octomap
    octomap.binary, octomap.id, octomap.resolution = True, "OcTree", 0.1
    octomap.data = np.frombuffer(data, np.int8)
    message.world.octomap.origin = pose_message(S, SE3.from_xyz(1.0, 0.0, 0.0))
    found = scene.apply(diff_from_message(message, scene)).objects["<octomap>"]
    shape = found.shapes[0][0]
    assert len(shape.sizes) == 8 and np.allclose(shape.sizes, 0.1)
    assert np.allclose(found.T_world_object.translation, (1, 0, 0))
    seen = scene.apply(diff_from_message(message, scene))
    out = scene_message(S, S.new("std_msgs/Header"), seen, Components.OCTOMAP).world.octomap
    assert bytes(np.asarray(out.octomap.data, np.int8)) == data and out.octomap.resolution == 0.1
    assert out.octomap.binary and out.octomap.id == "OcTree" and out.origin.position.x == 1.0
    octomap.data = octomap.data[:-1]
    with pytest.raises(InputError, match="cut off"):
        diff_from_message(message, scene)


def test_error_codes_are_moveits():
    constants = {n: v for n, _, v in S.definition("moveit_msgs/MoveItErrorCodes").constants}
    assert constants == {code.name: int(code) for code in ErrorCode}
