"""What MoveIt's own public tests expect of moveit_commander and MoveGroupInterface, asked of armcell.

From moveit/moveit: moveit_commander/test/python_moveit_commander.py and python_time_parameterization.py;
moveit_ros/planning_interface/test: python_move_group.py, robot_state_update.py,
move_group_interface_cpp_test.cpp, planning_scene_interface_clearScene.cpp;
moveit_core/robot_state/test: robot_state_test.cpp, test_cartesian_interpolator.cpp.
The names of tests are theirs where they have one. `SAME` is their tolerance of a pose that was reached.
"""

from __future__ import annotations

import numpy as np
import pytest
from tests.execution.helpers import make
from tests.execution.ungated import execute
from tests.model.helpers import PinRobot, joint, link, model_of, pin_library
from tests.planning.helpers import ends_at
from tests.scene.helpers import box, panda

import armcell
from armcell.core import (
    SE3,
    SO3,
    CartesianRequest,
    Constraints,
    ErrorCode,
    InputError,
    JointGoal,
    JointState,
    NamedGoal,
    OrientationConstraint,
    PlanRequest,
    PoseGoal,
    UnknownNameError,
)
from armcell.kinematics import kinematic_tree
from armcell.planning import goal_of, plan, plan_cartesian
from armcell.scene import AddObject, AttachObject, PlanningScene, RemoveAllObjects, SceneDiff
from armcell.timing import BlendedPath, parameterize

SAME = 1e-2
LINK = "panda_link8"  # the tip of MoveIt's panda_arm
PANDA = armcell.load_robot("panda")
ARM = PANDA.group("arm").joint_names


# --- python_moveit_commander.py, python_move_group.py ---
def set_target(target) -> np.ndarray:
    """set_joint_value_target, then get_joint_value_target."""
    goal = goal_of(PANDA, "arm", target)
    assert isinstance(goal, JointGoal)
    return PlanningScene.of(PANDA).state.updated(goal.state).reindexed(ARM).positions


def test_target_setting():
    n = len(ARM)
    for target in ([0.1] * n, (0.2,) * n, np.zeros(n)):
        np.testing.assert_array_equal(set_target(target), target)
    np.testing.assert_array_equal(set_target(dict.fromkeys(ARM, 0.3)), [0.3] * n)
    np.testing.assert_array_equal(set_target(JointState(ARM, [0.1] * n)), [0.1] * n)
    backwards = JointState(ARM[::-1], np.arange(n) / 10)
    np.testing.assert_array_equal(set_target(backwards), np.arange(n)[::-1] / 10)
    one = set_target({ARM[0]: 0.5})
    assert one[0] == 0.5
    np.testing.assert_array_equal(one[1:], PlanningScene.of(PANDA).state.reindexed(ARM[1:]).positions)


def test_targets_of_the_other_kinds():
    pose = SE3.from_xyz(0.5, 0.0, 0.5)
    goal = goal_of(PANDA, "arm", pose)
    assert isinstance(goal, PoseGoal) and goal.T_world_link is pose and goal.link is None
    assert goal_of(PANDA, "arm", "extended") == NamedGoal("extended")
    assert goal_of(PANDA, "arm", goal) is goal


@pytest.mark.parametrize(
    ("target", "error", "said"),
    [
        ([0.1] * 6, InputError, "7 joints"),
        ([0.1] * 9, InputError, "panda_joint1, panda_joint2"),
        ([[0.1] * 7], InputError, r"\(1, 7\)"),
        ([0.1] * 6 + [np.nan], InputError, "panda_joint7 is not finite"),
        (["a"] * 7, InputError, "a list is not a valid target"),
        (None, InputError, "no target|joint values"),
        ("raedy", UnknownNameError, "extended"),
        ({"panda_joint": 0.1}, UnknownNameError, "panda_joint1"),
    ],
)
def test_targets_that_are_refused(target, error, said):
    with pytest.raises(error, match=said):
        goal_of(PANDA, "arm", target)


def planned(driver, target):
    scene = PlanningScene.of(PANDA).with_state(driver.joint_state())
    return plan(scene, PlanRequest("arm", (goal_of(PANDA, "arm", target),)))


def test_validation():
    """The first plan is executed; the second, from the same start, is refused; a new one is executed."""
    with make("fake", PlanningScene.of(PANDA)) as driver:
        current = driver.joint_state().reindexed(ARM).positions
        first, second = planned(driver, current + 0.2), planned(driver, current + 0.2)
        assert first.ok and second.ok
        assert execute(driver, first.trajectory).ok
        refused = execute(driver, second.trajectory)
        assert refused.code is ErrorCode.CONTROL_FAILED and refused.duration == 0.0
        assert "plan again" in refused.message and refused.evidence["error"] == pytest.approx(0.2, abs=1e-6)
        np.testing.assert_allclose(driver.joint_state().reindexed(ARM).positions, current + 0.2, atol=1e-6)
        third = planned(driver, current)
        assert third.ok and execute(driver, third.trajectory).ok


def test_robot_state_update():
    """30 random targets: after an execution the state is the target, else it is what it was."""
    rng = np.random.default_rng(0)
    with make("fake", PlanningScene.of(PANDA)) as driver:
        home, moved = driver.joint_state().reindexed(ARM).positions, 0
        for _ in range(30):
            before = driver.joint_state().reindexed(ARM).positions
            target = home + rng.uniform(-0.5, 0.5, size=len(ARM))
            result = planned(driver, target)
            done = result.ok and execute(driver, result.trajectory).ok
            expected = target if done else before
            np.testing.assert_allclose(driver.joint_state().reindexed(ARM).positions, expected, atol=1e-4)
            moved += done
    assert moved >= 25


def test_gogogo():
    """go() to where the arm is, in every form a target may have."""
    with armcell.load("panda_pick").connect("fake") as live:
        current = live.scene().state.reindexed(ARM)
        q, pose = current.positions, live.scene().frame_pose("panda_hand_tcp")
        for target in (q, list(q), tuple(q), current, current.as_dict(), "home", pose):
            assert live.arm.move_to(target), target
        np.testing.assert_allclose(live.scene().state.reindexed(ARM).positions, q, atol=1e-4)
        with pytest.raises(InputError, match="7 joints"):
            live.arm.move_to(q[:6])


def test_enforce_bounds():
    names, positions = ARM, np.zeros(7)
    positions[0] = 1000
    bounded = PANDA.enforce_bounds(positions, names)
    assert positions[0] == 1000 and bounded[0] == PANDA.joint(ARM[0]).limits.upper
    PANDA.check_positions(bounded, names)
    np.testing.assert_array_equal(PANDA.enforce_bounds(bounded, names), bounded)
    for wrong in ([], [0.0] * 6, [np.nan] * 7):
        with pytest.raises(InputError, match="7 finite positions"):
            PANDA.enforce_bounds(wrong, names)


def test_enforce_bounds_of_a_continuous_joint():
    """robot_state_test.cpp: 0.2 stays, 3.2 becomes -3.083185."""
    model = model_of(link("a"), link("b"), joint("j", "a", "b", "continuous"))
    for given, expected in ((0.2, 0.2), (3.2, -3.083185), (-3.2, 3.083185), (np.pi, np.pi), (9.0, 2.716815)):
        assert model.enforce_bounds([given])[0] == pytest.approx(expected, abs=1e-6)


# The axes of the arm that python_move_group.py runs on (FANUC M-10iA): (xyz [m] from the one before, axis).
FANUC = [
    ("0 0 0.45", "0 0 1"), ("0.15 0 0", "0 1 0"), ("0 0 0.6", "0 -1 0"),
    ("0 0 0.2", "-1 0 0"), ("0.64 0 0", "0 -1 0"), ("0.1 0 0", "-1 0 0"),
]  # fmt: skip
JACOBIAN = [
    [0.0, 0.8, -0.2, 0.0, 0.0, 0.0],
    [0.89, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, -0.74, 0.74, 0.0, 0.1, 0.0],
    [0.0, 0.0, 0.0, -1.0, 0.0, -1.0],
    [0.0, 1.0, -1.0, 0.0, -1.0, 0.0],
    [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
]


def fanuc():
    parts = [link("l0")]
    for k, (xyz, axis) in enumerate(FANUC, 1):
        at = f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        parts += [link(f"l{k}"), joint(f"joint_{k}", f"l{k - 1}", f"l{k}", inside=at)]
    return model_of(*parts)


def test_get_jacobian_matrix():
    """MoveIt's known matrix of the arm at zero."""
    tree = kinematic_tree(fanuc())
    np.testing.assert_allclose(tree.jacobian(np.zeros(6), "l6"), JACOBIAN, atol=1e-12)


def test_get_jacobian_matrix_at_a_reference_point():
    """At (1, 1, 1) in the tip's frame. MoveIt's test writes a matrix down here, and does not compare it: the
    signs of three entries differ from how the point moves, which is what decides here."""
    tree, point, h = kinematic_tree(fanuc()), np.ones(3), 1e-6
    J = tree.jacobian(np.zeros(6), "l6", point=point)
    for k in range(6):
        step = h * np.eye(6)[k]
        moved = tree.link_pose(step, "l6").apply(point) - tree.link_pose(-step, "l6").apply(point)
        np.testing.assert_allclose(J[:3, k], moved / (2 * h), atol=1e-8)
    np.testing.assert_allclose(J[3:], np.array(JACOBIAN)[3:], atol=1e-12)
    np.testing.assert_allclose(J[0], [-1.0, 1.8, -1.2, 0.0, -1.0, 0.0], atol=1e-12)


def test_the_panda_s_jacobian_is_pinocchio_s():
    """At random states, and with MoveIt's layout: linear over angular velocity, a column for each joint."""
    tree, reference, rng = (
        kinematic_tree(PANDA),
        PinRobot(pin_library("panda"), PANDA),
        np.random.default_rng(0),
    )
    for _ in range(20):
        q = rng.uniform(PANDA.lower, PANDA.upper)
        J = tree.jacobian(q, LINK, ARM)
        assert J.shape == (6, 7)
        reference.place(tree.full_positions(q))
        np.testing.assert_allclose(J, reference.jacobian(LINK)[:, PANDA.columns(ARM)], atol=1e-10)
        np.testing.assert_allclose(J[:, 0][3:], [0, 0, 1], atol=1e-12)  # the first axis is the world's z


# --- move_group_interface_cpp_test.cpp ---
START = SE3.from_xyz(0.55, -0.05, 0.8)
TARGET = SE3.from_xyz(0.28, -0.2, 0.5)


def go(scene: PlanningScene, pose: SE3, **options) -> PlanningScene:
    """Plan a pose of panda_link8, and the scene when the motion is done."""
    result = plan(scene, PlanRequest("arm", (PoseGoal(pose, LINK),), **options))
    assert result.ok, result.message
    after = ends_at(scene, result)
    assert np.allclose(after.frame_pose(LINK).matrix, pose.matrix, atol=SAME)
    return after


@pytest.fixture(scope="module")
def started():
    return go(panda(), START)


def test_starting_conditions():
    request = PlanRequest("arm", ())
    assert (request.planning_time, request.attempts) == (5.0, 1)
    assert JointGoal(JointState((), [])).tolerance == 0.0001
    assert PoseGoal(START).position_tolerance == 0.0001 and PoseGoal(START).orientation_tolerance == 0.001
    assert tuple(f"panda_joint{k}" for k in range(1, 8)) == ARM
    assert set(PANDA.named_states["arm"]) == {"home", "extended"}  # theirs: ready, extended
    assert set(PANDA.groups) == {"arm", "hand", "arm_and_hand"}  # theirs: panda_arm, hand, panda_arm_hand
    assert [n for n in PANDA.group("arm").link_names if n[-1].isdigit()][-8:] == [
        f"panda_link{k}" for k in range(1, 9)
    ]


def test_move_to_pose(started):
    go(started, TARGET)


def test_joint_space_goal():
    wanted = [1.2, -1.0, -0.1, -2.4, 0.0, 1.5, 0.6]
    scene = panda()
    result = plan(scene, PlanRequest("arm", (goal_of(PANDA, "arm", wanted),)))
    assert result.ok, result.message
    np.testing.assert_allclose(ends_at(scene, result).state.reindexed(ARM).positions, wanted, atol=SAME)


def test_path_constraint(started):
    keep = OrientationConstraint(SO3.identity(), (0.1, 0.1, 0.1), "panda_link7", "panda_link0", "xyz_euler")
    go(started, TARGET, path_constraints=Constraints(orientations=(keep,)))


def test_cart_path(started):
    """Down, right, up and left: fraction >= 1 - eps, executed, and the last pose is reached."""
    down, right, back = (
        SE3.from_xyz(0.55, -0.05, 0.6), SE3.from_xyz(0.55, -0.25, 0.6), SE3.from_xyz(0.35, -0.05, 0.8)
    )  # fmt: skip
    request = CartesianRequest("arm", (START, down, right, back), LINK, max_step=0.01, jump_threshold=0.0)
    result = plan_cartesian(started, request)
    assert result.ok and result.fraction >= 1 - 1e-9, result.message
    with make("fake", started) as driver:
        assert execute(driver, result.trajectory).ok
        after = started.with_state(driver.joint_state())
    assert np.allclose(after.frame_pose(LINK).matrix, back.matrix, atol=SAME)


def test_collision_objects():
    before = go(panda(), TARGET)
    scene = before.with_object(box("box1", (0.4, 0.1, 0.1), (0.4, -0.2, 0.8)))
    result = plan(scene, PlanRequest("arm", (PoseGoal(SE3.from_xyz(0.4, -0.4, 0.7), LINK),)))
    assert result.ok, result.message
    scene = ends_at(scene, result)
    attached = scene.with_attached("box1", LINK)
    assert len(attached.attached) == 1 and not attached.objects
    detached = attached.with_detached("box1")
    assert not detached.attached and len(detached.objects) == 1
    assert not detached.without_object("box1").objects


# --- test_cartesian_interpolator.cpp, PandaRobot ---
MOVES = {
    "testTranslationGlobal": lambda T: SE3.from_xyz(0.2, 0, 0) @ T,
    "testTranslationLocal": lambda T: T @ SE3.from_xyz(0.2, 0, 0),
    "testRotationLocal": lambda T: T @ SE3(SO3.exp((np.pi / 4, 0, 0)), np.zeros(3)),
}


@pytest.mark.parametrize("name", MOVES)
def test_cartesian_interpolator(name):
    """From "ready": all of it is done, from the very start to the very end."""
    scene = panda()
    before = scene.frame_pose(LINK)
    goal = MOVES[name](before)
    result = plan_cartesian(scene, CartesianRequest("arm", (goal,), LINK, max_step=0.1, jump_threshold=0.0))
    assert result.fraction == 1.0, result.message
    np.testing.assert_array_equal(result.path.waypoints[0], scene.state.reindexed(ARM).positions)
    after = ends_at(scene, result).frame_pose(LINK)
    assert after.isclose(goal, 1e-5, 1e-5)


# --- python_time_parameterization.py ---
def test_plan_and_time_parameterization():
    """A line 0.1 m down, whole; then timed anew, at full and at half speed."""
    scene = panda()
    here = scene.frame_pose(LINK)
    lower = SE3(here.rotation, here.translation - (0, 0, 0.1))
    result = plan_cartesian(scene, CartesianRequest("arm", (here, lower), LINK, jump_threshold=0.0))
    assert result.fraction == 1.0, result.message
    velocity, acceleration = (PANDA.limits(ARM, kind) for kind in ("velocity", "acceleration"))
    durations = []
    for v, a in ((1.0, 1.0), (0.5, 0.25)):
        path = BlendedPath(result.path.waypoints, 2e-3)
        retimed = parameterize(path, ARM, v * velocity, a * acceleration)
        assert np.all(np.abs(retimed.velocities) <= 1.001 * v * velocity)
        assert np.all(np.abs(retimed.accelerations) <= 1.001 * a * acceleration)
        np.testing.assert_allclose(retimed.positions[-1], result.path.waypoints[-1], atol=1e-9)
        durations.append(retimed.duration)
    assert 1.8 * durations[0] < durations[1] <= 2 * durations[0]  # twice, but for the smoothing's window
    with pytest.raises(InputError, match=r"\(0, 1\]"):  # a scaling above 1
        plan(scene, PlanRequest("arm", (NamedGoal("home"),), velocity_scaling=1.5))


# --- planning_scene_interface_clearScene.cpp ---
def crates(numbers) -> list[AddObject]:
    rng = np.random.default_rng(1)
    return [
        AddObject(box(str(k), rng.uniform(0.1, 4, 3), rng.uniform(-4, 4, 3))) for k in numbers
    ]  # fmt: skip


@pytest.mark.parametrize("held", [0, 2, 4])
def test_clear_scene(held):
    """Four objects, of which some are attached: none after clearing."""
    hold = [AttachObject(str(k), "panda_link0") for k in range(held)]
    scene = panda().apply(SceneDiff.of(*crates(range(4)), *hold))
    assert (len(scene.objects), len(scene.attached)) == (4 - held, held)
    cleared = scene.apply(SceneDiff.of(RemoveAllObjects(attached=True)))
    assert len(cleared.objects) + len(cleared.attached) == 0
    assert len(scene.apply(SceneDiff.of(RemoveAllObjects())).attached) == held
    assert (len(scene.objects), len(scene.attached)) == (4 - held, held)  # a value: the old one is as it was
