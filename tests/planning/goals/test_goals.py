"""Goals with tolerances, turns and constraints, and the plain evaluator; judged by pinocchio and scipy."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from tests.model.helpers import pin_library
from tests.planning.helpers import down, ends_at, judge, panda_wall, request, ur10_wall
from tests.scene.helpers import DOWN, box, panda, ur10

from armcell.collision.kernel.checker import KernelChecker
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
    JointState,
    Mesh,
    OrientationConstraint,
    Plane,
    PoseGoal,
    PositionConstraint,
    Sphere,
    UnknownNameError,
)
from armcell.planning import constraint_errors, describe_violations, plan, satisfies_constraints
from armcell.planning.constraints.evaluation import distance_to_shape, rotation_error, rotation_of

TIP = "panda_hand_tcp"


def tip_pose(result) -> np.ndarray:
    """T_world_tip (4, 4) at the end of a Panda's motion, by pinocchio."""
    model = pin_library("panda")
    q = pin.neutral(model)
    names = (*result.trajectory.joint_names,)
    for name, value in zip(names, result.trajectory.positions[-1], strict=True):
        q[model.joints[model.getJointId(name)].idx_q] = value
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(TIP, pin.FrameType.BODY)].homogeneous


def in_box(center, size=(0.2, 0.2, 0.2)) -> PositionConstraint:
    return PositionConstraint(((Box(*size), SE3.from_xyz(*center)),))


@pytest.mark.parametrize("kind", ["joints", "pose"])
def test_a_goal_that_only_the_kernel_rejects_names_the_nearest_bodies(monkeypatch, kind):
    """The kernel's convex pieces enclose the meshes, so that a narrow gap can count as contact."""
    scene, turned = panda(), JointState(("panda_joint1",), [0.5])
    pose = scene.with_state(turned).frame_pose(TIP)
    home = scene.positions[:7]
    monkeypatch.setattr(KernelChecker, "is_free", lambda self, q: bool(np.allclose(q[:7], home)))
    result = plan(scene, request(JointGoal(turned) if kind == "joints" else PoseGoal(pose)))
    assert result.code is ErrorCode.GOAL_IN_COLLISION
    named = r"panda_\w+ is \d+\.\d mm from \w+, which is nearer than the kernel's convex pieces"
    assert re.search(named, result.message)
    assert all(c.distance > 0 for c in result.evidence["contacts"])


# --- tolerances ---


def test_a_joint_goal_in_collision_is_reached_elsewhere_within_its_tolerance():
    scene = panda_wall()
    names = ("panda_joint1", "panda_joint2")
    state = JointState(names, [0.0, 0.6])
    exact = plan(scene, request(JointGoal(state)))
    assert exact.code is ErrorCode.GOAL_IN_COLLISION
    result = plan(scene, request(JointGoal(state, tolerance=0.6)))
    assert result.ok, result.message
    judge(scene, result.trajectory)
    last = JointState(result.trajectory.joint_names, result.trajectory.positions[-1])
    off = np.array([last[name] for name in names]) - state.positions
    assert np.max(np.abs(off)) <= 0.6 and np.max(np.abs(off)) > 1e-3
    for name in last.joint_names[2:]:
        assert last[name] == pytest.approx(scene.state[name])


def test_a_joint_goal_slightly_out_of_limits_is_taken_at_the_limit():
    scene = panda_wall()
    state = JointState(("panda_joint7",), [2.91])  # the limit is 2.8973
    assert plan(scene, request(JointGoal(state))).code is ErrorCode.GOAL_STATE_INVALID
    result = plan(scene, request(JointGoal(state, tolerance=0.02)))
    assert result.ok and result.trajectory.positions[-1][6] == pytest.approx(2.8973, abs=1e-4)


def test_a_pose_within_a_wall_is_reached_within_its_position_tolerance():
    scene, target = panda_wall(), down(0.55, 0.0, 0.25)
    assert plan(scene, request(PoseGoal(target))).code is ErrorCode.GOAL_IN_COLLISION
    result = plan(scene, request(PoseGoal(target, position_tolerance=0.2)))
    assert result.ok, result.message
    reached = tip_pose(result)
    assert 0.01 < np.linalg.norm(reached[:3, 3] - target.translation) <= 0.2
    assert Rotation.from_matrix(target.rotation.matrix.T @ reached[:3, :3]).magnitude() <= 2e-3


def test_orientation_tolerance_about_one_axis_only():
    """A pose that only a turned hand reaches: turning about z is allowed, tilting is not."""
    scene = panda(joint1=0.0)
    target = down(0.5, 0.2, 0.3)
    wall = box("beside", (0.4, 0.03, 0.06), (0.5, 0.27, 0.36))
    blocked = scene.with_object(wall)
    exact = plan(blocked, request(PoseGoal(target)))
    assert exact.code is ErrorCode.GOAL_IN_COLLISION, exact.message
    result = plan(blocked, request(PoseGoal(target, orientation_tolerance=(0.01, 0.01, np.pi))))
    assert result.ok, result.message
    judge(blocked, result.trajectory)
    reached = tip_pose(result)
    axis = reached[:3, 2]
    assert np.arccos(-axis[2]) < 0.02  # still down
    assert np.linalg.norm(reached[:3, 3] - target.translation) < 2e-4
    assert Rotation.from_matrix(target.rotation.matrix.T @ reached[:3, :3]).magnitude() > 0.3


def test_position_only_by_tolerance():
    target = SE3(SO3.identity(), np.array([0.6, 0.1, 0.05]))  # upright: out of reach there
    scene = panda()
    assert not plan(scene, request(PoseGoal(target)))
    result = plan(scene, request(PoseGoal(target, orientation_tolerance=np.pi)))
    assert result.ok and np.linalg.norm(tip_pose(result)[:3, 3] - target.translation) < 2e-4


@pytest.mark.parametrize(
    "goal",
    [
        PoseGoal(down(0.5, 0, 0.3), position_tolerance=-1.0),
        PoseGoal(down(0.5, 0, 0.3), orientation_tolerance=(0.1, 0.1)),
        PoseGoal(down(0.5, 0, 0.3), orientation_tolerance=float("nan")),
        JointGoal(JointState((), []), tolerance=-0.1),
    ],
)
def test_impossible_tolerances_are_misuse(goal):
    with pytest.raises(InputError, match="tolerance"):
        plan(panda_wall(), request(goal))


# --- several goals, whole turns ---


def test_any_of_several_poses():
    scene = panda_wall()
    goals = (PoseGoal(down(3.0, 0, 0)), PoseGoal(down(0.55, 0.0, 0.2)), PoseGoal(down(0.5, 0.25, 0.2)))
    result = plan(scene, request(goals))
    assert result.ok, result.message
    np.testing.assert_allclose(tip_pose(result)[:3, 3], (0.5, 0.25, 0.2), atol=2e-4)


def test_turns_take_the_nearest_equivalent():
    scene = ur10().with_state(JointState(("wrist_3_joint", "shoulder_pan_joint"), [2.9, 2.9]))
    state = JointState(("wrist_3_joint", "shoulder_pan_joint"), [-2.9, -2.9])
    far = plan(scene, request(JointGoal(state)))
    near = plan(scene, request(JointGoal(state, turns=True)))
    assert far.ok and near.ok
    names = list(near.trajectory.joint_names)
    for joint in state.joint_names:
        k = names.index(joint)
        assert far.trajectory.positions[-1][k] == pytest.approx(-2.9)
        assert near.trajectory.positions[-1][k] == pytest.approx(2 * np.pi - 2.9)
    assert near.path.length < 0.2 * far.path.length


def test_turns_stay_within_limits():
    scene = panda_wall().with_state(JointState(("panda_joint7",), [2.8]))
    result = plan(scene, request(JointGoal(JointState(("panda_joint7",), [-2.8]), turns=True)))
    assert result.ok and result.trajectory.positions[-1][6] == pytest.approx(
        -2.8
    )  # a turn on is out of limits


# --- constraint sets ---


def test_a_region_alone():
    scene = panda_wall()
    result = plan(scene, request(ConstraintGoal(Constraints(positions=(in_box((0.5, 0.3, 0.3)),)))))
    assert result.ok, result.message
    judge(scene, result.trajectory)
    assert np.all(np.abs(tip_pose(result)[:3, 3] - (0.5, 0.3, 0.3)) <= 0.1 + 1e-5)


def test_an_orientation_alone():
    scene = panda_wall()
    wanted = OrientationConstraint(SO3(DOWN.matrix @ SO3.exp((0, 0, 1.0)).matrix), (0.05, 0.05, 0.05))
    result = plan(scene, request(ConstraintGoal(Constraints(orientations=(wanted,)))))
    assert result.ok, result.message
    error = Rotation.from_matrix(wanted.rotation.matrix.T @ tip_pose(result)[:3, :3]).as_rotvec()
    assert np.all(np.abs(error) <= 0.05 + 1e-5)


def test_a_region_an_orientation_and_a_joint_range_at_once():
    scene = panda_wall()
    wanted = Constraints(
        joints=(JointConstraint("panda_joint7", 0.5, 0.5, 0.5),),
        positions=(in_box((0.5, 0.3, 0.3)),),
        orientations=(OrientationConstraint(DOWN, (0.1, 0.1, np.pi)),),
    )
    result = plan(scene, request(ConstraintGoal(wanted)))
    assert result.ok, result.message
    reached = tip_pose(result)
    assert 0.0 <= result.trajectory.positions[-1][6] <= 1.0
    assert np.all(np.abs(reached[:3, 3] - (0.5, 0.3, 0.3)) <= 0.1 + 1e-5)
    error = Rotation.from_matrix(DOWN.matrix.T @ reached[:3, :3]).as_rotvec()
    assert np.all(np.abs(error[:2]) <= 0.1 + 1e-5)


def test_joint_ranges_leave_other_joints_where_they_can_stay():
    scene = panda_wall()
    wanted = Constraints(joints=(JointConstraint("panda_joint6", 2.0, 0.1, 0.2),))
    result = plan(scene, request(ConstraintGoal(wanted)))
    last = result.trajectory.positions[-1]
    assert result.ok and 1.8 <= last[5] <= 2.1
    np.testing.assert_allclose(np.delete(last, 5), np.delete(result.trajectory.positions[0], 5), atol=1e-9)


def held() -> tuple:
    """A rod in the hand."""
    scene = panda_wall()
    tip = scene.frame_pose(TIP).translation
    rod = box("rod", (0.02, 0.02, 0.1), tip - (0, 0, 0.05))
    return scene.with_object(rod).with_attached("rod", "panda_hand", scene.model.gripper().finger_links)


def test_an_attached_object_may_be_what_is_placed():
    scene = held()
    target = SE3(SO3.identity(), np.array([0.5, 0.25, 0.25]))
    result = plan(scene, request(PoseGoal(target, link="rod"), seed=2))
    assert result.ok, result.message
    assert ends_at(scene, result).frame_pose("rod").isclose(target, 2e-4, 2e-3)
    region = PositionConstraint(((Sphere(0.05), SE3.from_xyz(0.45, 0.3, 0.3)),), link="rod")
    result = plan(scene, request(ConstraintGoal(Constraints(positions=(region,))), seed=2))
    assert result.ok, result.message
    at = ends_at(scene, result).frame_pose("rod").translation
    assert np.linalg.norm(at - (0.45, 0.3, 0.3)) <= 0.05 + 1e-5


def test_a_region_in_an_object_s_frame_is_resolved_by_the_adapter():
    table = box("tray", (0.2, 0.2, 0.02), (0.45, 0.3, 0.05))
    scene = panda_wall().with_object(table)
    above = PositionConstraint(((Box(0.1, 0.1, 0.1), SE3.from_xyz(0, 0, 0.2)),), frame="tray")
    turned = OrientationConstraint(DOWN, (0.1, 0.1, 0.1), frame="tray")
    goal = ConstraintGoal(Constraints(positions=(above,), orientations=(turned,)))
    result = plan(scene, request(goal))
    assert result.ok, result.message
    assert np.all(np.abs(tip_pose(result)[:3, 3] - (0.45, 0.3, 0.25)) <= 0.05 + 1e-5)
    with pytest.raises(InputError, match="add the adapter resolve_constraint_frames"):
        plan(scene, request(goal, adapters=("timing", "validation")))


# --- contradictions ---

CONTRADICTIONS = {
    "ranges apart": (
        Constraints(
            joints=(
                JointConstraint("panda_joint1", 0, 0.1, 0.1),
                JointConstraint("panda_joint1", 1, 0.1, 0.1),
            )
        ),
        r"no position of joint panda_joint1 is in \[-0.1, 0.1\] and \[0.9, 1.1\]",
    ),
    "outside of limits": (
        Constraints(joints=(JointConstraint("panda_joint4", 1.0, 0.1, 0.1),)),
        "panda_joint4 .* within its limits",
    ),
    "out of reach": (
        Constraints(positions=(in_box((2.0, 0, 0.3)),)),
        f"region of {TIP} is out of reach: 1.9",
    ),
    "orientations apart": (
        Constraints(
            orientations=(
                OrientationConstraint(DOWN, (0.1, 0.1, 0.1)),
                OrientationConstraint(SO3.identity(), (0.1, 0.1, 0.1)),
            )
        ),
        "two orientations of panda_hand_tcp are 180 deg apart, their tolerances allow 20 deg",
    ),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_contradictions_are_named_before_planning(name):
    constraints, words = CONTRADICTIONS[name]
    result = plan(panda_wall(), request(ConstraintGoal(constraints), planning_time=60.0))
    assert result.code is ErrorCode.INVALID_GOAL_CONSTRAINTS
    assert result.planning_time < 30.0 and result.trajectory is None
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(result.message)


def mesh() -> Mesh:
    return Mesh(np.eye(3), np.array([[0, 1, 2]]))


MISUSE = {
    "joint": (Constraints(joints=(JointConstraint("elbow", 0, 1, 1),)), "unknown joint 'elbow'"),
    "finger": (
        Constraints(joints=(JointConstraint("panda_finger_joint1", 0, 1, 1),)),
        "group 'arm' does not move",
    ),
    "negative": (Constraints(joints=(JointConstraint("panda_joint1", 0, -1, 1),)), "below zero"),
    "link": (Constraints(positions=(PositionConstraint(((Sphere(1), SE3.identity()),), link="cup"),)),
             "unknown link 'cup'"),
    "frame": (Constraints(orientations=(OrientationConstraint(DOWN, (1, 1, 1), frame="shelf"),)),
              "unknown frame 'shelf'"),
    "fixed link": (
        Constraints(positions=(PositionConstraint(((Sphere(1), SE3.identity()),), link="panda_link0"),)),
        "panda_link0",
    ),
    "no region": (Constraints(positions=(PositionConstraint(()),)), "has no region"),
    "surface": (Constraints(positions=(PositionConstraint(((mesh(), SE3.identity()),)),)), "Mesh cannot be"),
    "angles": (
        Constraints(orientations=(OrientationConstraint(DOWN, (1, 1, 1), parameterization="zyz"),)),
        "unknown parameterization 'zyz'; known: rotation_vector, xyz_euler",
    ),
    "nothing": (Constraints(), "asks nothing"),
}  # fmt: skip


def test_a_tolerance_of_two_angles_is_refused():
    with pytest.raises(InputError, match="tolerance is .* 3 numbers"):
        OrientationConstraint(DOWN, (1, 1))


@pytest.mark.parametrize("name", MISUSE)
def test_misuse_of_constraints_raises(name):
    constraints, words = MISUSE[name]
    with pytest.raises(InputError, match=words):
        plan(panda_wall(), request(ConstraintGoal(constraints)))


# --- the evaluator ---


def test_errors_of_constraints_against_pinocchio_and_scipy():
    scene, rng = panda(), np.random.default_rng(3)
    names = scene.model.group("arm").joint_names
    model = pin_library("panda")
    data, frame = model.createData(), model.getFrameId(TIP, pin.FrameType.BODY)
    wanted, center = SO3.exp((0.3, -0.4, 2.0)), np.array([0.4, 0.1, 0.5])
    constraints = Constraints(
        joints=(JointConstraint("panda_joint2", 0.2, 0.3, 0.1),),
        positions=(PositionConstraint(((Sphere(0.1), SE3.from_xyz(*center)),), point=(0.0, 0.1, 0.02)),),
        orientations=(
            OrientationConstraint(wanted, (0.5, 0.6, np.pi)),
            OrientationConstraint(wanted, (0.5, 0.6, 0.7), parameterization="xyz_euler"),
        ),
    )
    columns = [model.joints[model.getJointId(name)].idx_q for name in names]
    agreed = set()
    for _ in range(50):
        q = rng.uniform(scene.model.lower[:7], scene.model.upper[:7])
        full = pin.neutral(model)
        full[columns] = q
        pin.framesForwardKinematics(model, data, full)
        T = data.oMf[frame]
        joint, position, vector, euler = constraint_errors(scene, "arm", constraints, q)
        assert joint.error[0] == pytest.approx(q[1] - 0.2)
        assert joint.excess[0] == pytest.approx(max(q[1] - 0.5, 0.1 - q[1], 0))
        distance = np.linalg.norm(T.act(np.array([0.0, 0.1, 0.02])) - center) - 0.1
        assert position.error[0] == pytest.approx(max(distance, 0.0), abs=1e-9)
        turn = Rotation.from_matrix(wanted.matrix.T @ T.rotation)
        np.testing.assert_allclose(vector.error, turn.as_rotvec(), atol=1e-8)
        np.testing.assert_allclose(euler.error, turn.as_euler("XYZ"), atol=1e-8)
        excess = np.maximum(np.abs(turn.as_rotvec()) - (0.5, 0.6, 10.0), 0)
        np.testing.assert_allclose(vector.excess, excess, atol=1e-8)
        free = all(e.ok for e in (joint, position, vector, euler))
        assert (
            satisfies_constraints(scene, "arm", constraints, q)
            == free
            == (not describe_violations(scene, "arm", constraints, q))
        )
        agreed |= {("joint", joint.ok), ("vector", vector.ok), ("euler", euler.ok)}
    assert len(agreed) >= 4  # both answers occurred


def test_the_words_say_which_and_how_much():
    scene = panda_wall()
    q = scene.positions[:7]
    constraints = Constraints(
        joints=(
            JointConstraint("panda_joint2", 0.8, 0.1, 0.1),
            JointConstraint("panda_joint6", 2.5, 0.1, 0.1),
        ),
        positions=(in_box((1.0, 0.0, 0.5)),),
    )
    text = describe_violations(scene, "arm", constraints, q)
    assert "joint panda_joint2 at 0.3 is 0.4 outside of [0.7, 0.9]" in text
    assert "panda_hand_tcp is" in text and "mm outside of its region" in text and "panda_joint6" not in text


def test_rotation_of_is_the_inverse_of_rotation_error():
    rng = np.random.default_rng(0)
    for parameterization in ("rotation_vector", "xyz_euler"):
        for error in rng.uniform(-1.4, 1.4, (20, 3)):
            wanted = SO3.exp(rng.normal(size=3))
            present = wanted @ rotation_of(error, parameterization)
            np.testing.assert_allclose(rotation_error(wanted, present, parameterization), error, atol=1e-9)


@pytest.mark.parametrize(
    "shape",
    [Box(0.3, 0.5, 0.2), Sphere(0.3), Cylinder(0.2, 0.5), Capsule(0.2, 0.3), Cone(0.3, 0.6), Plane()],
    ids=lambda s: type(s).__name__,
)
def test_distances_to_shapes_against_coal(shape):
    import coal

    make = {
        Box: lambda s: coal.Box(s.x, s.y, s.z), Sphere: lambda s: coal.Sphere(s.radius),
        Cylinder: lambda s: coal.Cylinder(s.radius, s.length),
        Capsule: lambda s: coal.Capsule(s.radius, s.length), Cone: lambda s: coal.Cone(s.radius, s.length),
        Plane: lambda s: coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
    }  # fmt: skip
    other, rng = make[type(shape)](shape), np.random.default_rng(1)
    radius, outside = 1e-4, 0
    for point in rng.uniform(-0.6, 0.6, (200, 3)):
        answer, ask = coal.DistanceResult(), coal.DistanceRequest()
        at = coal.Transform3s(np.eye(3), point)
        d = coal.distance(other, coal.Transform3s(), coal.Sphere(radius), at, ask, answer) + radius
        assert distance_to_shape(shape, point) == pytest.approx(max(d, 0.0), abs=2e-4)
        outside += d > 0.01
    assert 20 < outside < 200


def test_unknown_names_in_the_evaluator():
    scene = panda()
    with pytest.raises(UnknownNameError, match="link"):
        describe_violations(scene, "arm", Constraints(positions=(
            PositionConstraint(((Sphere(1), SE3.identity()),), link="nothing"),)), np.zeros(7))  # fmt: skip


def test_ur10_regions_use_every_branch():
    scene = ur10_wall()
    goal = ConstraintGoal(
        Constraints(
            positions=(PositionConstraint(((Sphere(0.05), SE3.from_xyz(0.7, 0.5, 0.3)),)),),
            orientations=(OrientationConstraint(DOWN, (0.2, 0.2, np.pi)),),
        )
    )
    result = plan(scene, request(goal))
    assert result.ok, result.message
    judge(scene, result.trajectory)
    assert satisfies_constraints(scene, "arm", goal.constraints, result.trajectory.positions[-1])
