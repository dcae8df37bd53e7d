"""Path constraints are kept all along the motion, by pinocchio's kinematics and the exact checker."""

from __future__ import annotations

import threading
import time

import numpy as np
import pinocchio as pin
import pytest
from benchmarks.constraints import AHEAD, Cell, carrying, cells, upright
from tests.model.helpers import REFERENCES, PinRobot
from tests.scene.helpers import box, panda

from armcell.collision import ExactChecker
from armcell.core import (
    SE3,
    SO3,
    Box,
    Capsule,
    Cone,
    Constraints,
    Cylinder,
    ErrorCode,
    InputError,
    JointConstraint,
    JointGoal,
    JointState,
    OrientationConstraint,
    Plane,
    PlanRequest,
    PoseGoal,
    PositionConstraint,
    Sphere,
    UnknownNameError,
)
from armcell.kinematics import ik_solver, kinematic_tree
from armcell.planning import plan
from armcell.planning.constraints.manifold import ConstraintManifold

pytestmark = pytest.mark.slow

CELLS = {cell.name: cell for cell in cells()}
EDGE = 1e-4  # what a motion may pass a tolerance by where its start or goal is on the tolerance's edge


def signed_distance(shape, p: np.ndarray) -> float:
    """Of a point in the shape's frame, by formula [m]."""
    match shape:
        case Box():
            d = np.abs(p) - shape.half_extents
            return float(np.linalg.norm(np.maximum(d, 0)) + min(d.max(), 0.0))
        case Sphere():
            return float(np.linalg.norm(p)) - shape.radius
        case Cylinder():
            d = np.array([np.hypot(p[0], p[1]) - shape.radius, abs(p[2]) - shape.length / 2])
            return float(np.linalg.norm(np.maximum(d, 0)) + min(d.max(), 0.0))
        case Capsule():
            end = np.clip(p[2], -shape.length / 2, shape.length / 2)
            return float(np.linalg.norm(p - (0, 0, end))) - shape.radius
        case Plane():
            return float(p[2])
    raise AssertionError(shape)


def excess(robot: PinRobot, constraints: Constraints, tip: str) -> float:
    """The most [rad or m] by which the pose that pinocchio is at passes a tolerance; negative: inside."""
    worst = -np.inf
    for turn in constraints.orientations:
        error = turn.rotation.matrix.T @ robot.pose(turn.link or tip)[:3, :3]
        if turn.parameterization == "xyz_euler":
            angles = np.array([
                np.arctan2(-error[1, 2], error[2, 2]), np.arcsin(np.clip(error[0, 2], -1, 1)),
                np.arctan2(-error[0, 1], error[0, 0]),
            ])  # fmt: skip
        else:
            angles = pin.log3(error)
        over = np.abs(angles) - np.array(turn.tolerance)
        worst = max(worst, *(o for o, t in zip(over, turn.tolerance, strict=True) if t < np.pi))
    for point in constraints.positions:
        at = robot.pose(point.link or tip) @ np.append(point.point, 1.0)
        worst = max(
            worst, min(signed_distance(s, T.inverse().apply(at[:3])) for s, T in point.region)
        )  # fmt: skip
    return worst


def judge(scene, request: PlanRequest, result, step: float = 1e-3) -> float:
    """The largest excess along the timed motion, every ms; no contact every 5 ms."""
    assert result.ok, result.message
    model, names, trajectory = scene.model, result.trajectory.joint_names, result.trajectory
    reference = next(r for key, r in REFERENCES.items() if key == model.name)
    robot = PinRobot(reference()[1], model)
    tree, full, columns = kinematic_tree(model), scene.positions.copy(), model.columns(names)
    tip = model.group(request.group).tip_link
    checker = ExactChecker(scene.with_padding(0.0), names)
    worst = -np.inf
    np.testing.assert_allclose(trajectory.positions[0], full[columns], atol=1e-9)
    for k, t in enumerate(np.append(np.arange(0.0, trajectory.duration, step), trajectory.duration)):
        q = trajectory.sample(t)[0]
        full[columns] = q
        robot.place(tree.full_positions(full))
        worst = max(worst, excess(robot, request.path_constraints, tip))
        for joint in request.path_constraints.joints:
            value = q[names.index(joint.joint)] - joint.position
            worst = max(worst, value - joint.tolerance_above, -value - joint.tolerance_below)
        if k % 5 == 0:
            assert checker.is_free(q), checker.contacts(q)
    return worst


@pytest.mark.cases("Panda*")
@pytest.mark.parametrize("name", CELLS)
def test_the_timed_motion_keeps_to_the_constraints(name):
    cell = CELLS[name]
    request = cell.request(seed=3)
    result = plan(cell.scene, request)
    assert judge(cell.scene, request, result) <= 1e-7
    # It goes at a good speed: no crawling through its many waypoints.
    q = result.path.waypoints
    length = np.linalg.norm(np.diff(q, axis=0), axis=1).sum()
    assert length / result.trajectory.duration > 0.8  # [rad/s] on average
    T = ik_solver(cell.scene.model, "arm").tree.link_pose(_full(cell.scene, result), _tip(cell.scene))
    assert T.isclose(cell.goal, 1e-4, 1e-3)


def _tip(scene) -> str:
    return scene.model.group("arm").tip_link


def _full(scene, result) -> np.ndarray:
    full = scene.positions.copy()
    full[scene.model.columns(result.trajectory.joint_names)] = result.trajectory.positions[-1]
    return full


def at(x: float, y: float, z: float) -> SE3:
    return SE3(AHEAD, np.array([x, y, z]))


@pytest.fixture(scope="module")
def free_panda():
    return carrying("panda", [], at(0.5, -0.3, 0.5))


REGIONS = {
    "box": (Box(0.2, 0.8, 0.1), (0.5, 0.0, 0.5)),
    "sphere": (Sphere(0.33), (0.5, 0.0, 0.5)),
    "cylinder": (Cylinder(0.35, 0.06), (0.5, 0.0, 0.5)),
    "capsule": (Capsule(0.32, 0.2), (0.5, 0.0, 0.5)),
    "half space": (Plane(), (0.5, 0.0, 0.505)),
}


@pytest.mark.parametrize("name", REGIONS)
def test_each_kind_of_region(free_panda, name):
    shape, where = REGIONS[name]
    region = PositionConstraint(((shape, SE3.from_xyz(*where)),), point=(0.0, 0.0, 0.02))
    request = PlanRequest(
        "arm", (PoseGoal(at(0.5, 0.29, 0.5)),), path_constraints=Constraints(positions=(region,))
    )
    assert judge(free_panda, request, plan(free_panda, request)) <= 1e-7


def test_a_region_of_several_shapes(free_panda):
    """An L of two overlapping bars: the way leads around its corner."""
    bars = (
        (Box(0.06, 0.36, 0.06), SE3.from_xyz(0.5, -0.15, 0.5)),
        (Box(0.06, 0.06, 0.36), SE3.from_xyz(0.5, 0.0, 0.35)),
    )
    request = PlanRequest(
        "arm", (PoseGoal(at(0.5, 0.0, 0.22)),),
        path_constraints=Constraints(positions=(PositionConstraint(bars),)),
    )  # fmt: skip
    assert judge(free_panda, request, plan(free_panda, request)) <= 1e-7


@pytest.mark.cases("0.02-*", "0.002-xyz_euler")
@pytest.mark.parametrize("parameterization", ["rotation_vector", "xyz_euler"])
@pytest.mark.parametrize("tolerance", [0.3, 0.02, 2e-3])
def test_orientations_down_to_small_tolerances(free_panda, tolerance, parameterization):
    keep = OrientationConstraint(AHEAD, (np.pi, tolerance, tolerance), parameterization=parameterization)
    request = PlanRequest(
        "arm", (PoseGoal(at(0.45, 0.3, 0.3)),), path_constraints=Constraints(orientations=(keep,))
    )
    assert judge(free_panda, request, plan(free_panda, request)) <= 1e-7


def test_joint_corridors_and_a_locked_joint(free_panda):
    names = free_panda.model.group("arm").joint_names
    q = free_panda.positions[free_panda.model.columns(names)]
    corridors = Constraints(joints=(
        JointConstraint(names[2], q[2], 0.0, 0.0), JointConstraint(names[4], q[4], 0.4, 0.2),
    ))  # fmt: skip
    goal = q.copy()
    goal[[0, 1, 4]] += (0.9, 0.2, 0.35)
    request = PlanRequest("arm", (JointGoal(JointState(names, goal)),), path_constraints=corridors)
    assert judge(free_panda, request, plan(free_panda, request)) <= EDGE


def test_what_an_attached_object_must_keep(free_panda):
    """The glass's own frame, whose z is its axis: the same as the tip's constraint, said of the glass."""
    keep = OrientationConstraint(SO3.identity(), (0.1, 0.1, np.pi), link="glass")
    error = free_panda.frame_pose("glass").rotation.log()
    flip = keep if np.abs(error[:2]).max() < 0.1 else OrientationConstraint(
        free_panda.frame_pose("glass").rotation, (0.1, 0.1, np.pi), link="glass"
    )  # fmt: skip
    request = PlanRequest(
        "arm", (PoseGoal(at(0.45, 0.3, 0.3)),), path_constraints=Constraints(orientations=(flip,))
    )
    result = plan(free_panda, request)
    assert result.ok, result.message
    wanted = flip.rotation
    for t in np.arange(0.0, result.trajectory.duration, 1e-3):
        there = free_panda.with_state(
            JointState(result.trajectory.joint_names, result.trajectory.sample(t)[0])
        )
        tilt = (wanted.inverse() @ there.frame_pose("glass").rotation).log()
        assert np.abs(tilt[:2]).max() <= 0.1 + 1e-7


# --- the parts ---
@pytest.mark.parametrize("parameterization", ["rotation_vector", "xyz_euler"])
def test_errors_are_pinocchios(free_panda, parameterization):
    region = PositionConstraint(((Box(0.2, 0.3, 0.1), SE3.from_xyz_rpy((0.4, 0.1, 0.5), (0.3, 0.2, 0.1))),))
    turn = OrientationConstraint(
        SO3.from_rpy((0.4, 0.5, -2.0)), (3.0, 3.0, 3.0), parameterization=parameterization
    )
    manifold = ConstraintManifold(free_panda, "arm", Constraints(positions=(region,), orientations=(turn,)))
    robot = PinRobot(REFERENCES["panda"]()[1], free_panda.model)
    rng, model, tip = np.random.default_rng(1), free_panda.model, _tip(free_panda)
    columns = model.columns(manifold.joint_names)
    for _ in range(200):
        full = free_panda.positions.copy()
        full[columns] = rng.uniform(model.lower[columns], model.upper[columns])
        robot.place(kinematic_tree(model).full_positions(full))
        values = manifold.values(full[columns])
        zero = OrientationConstraint(turn.rotation, (0, 0, 0), parameterization=parameterization)
        assert np.abs(values[:3]).max() == pytest.approx(
            excess(robot, Constraints(orientations=(zero,)), tip), abs=1e-9
        )
        assert values[3] == pytest.approx(excess(robot, Constraints(positions=(region,)), tip), abs=1e-9)


def test_no_proof_of_a_motion_that_leaves(free_panda):
    """Random edges near the manifold, by dense samples: what is proven never leaves; most that stay are."""
    for constraints in (
        upright(0.1),
        Constraints(
            orientations=(OrientationConstraint(AHEAD, (0.2, 0.3, 0.4), parameterization="xyz_euler"),)
        ),
        Constraints(positions=(PositionConstraint(((Box(0.1, 1.0, 0.1), SE3.from_xyz(0.5, 0, 0.5)),)),)),
    ):
        manifold = ConstraintManifold(free_panda, "arm", constraints)
        model, rng = free_panda.model, np.random.default_rng(2)
        columns = model.columns(manifold.joint_names)
        low, high = model.lower[columns], model.upper[columns]
        proven = stay = wrong = 0
        for _ in range(1500):
            q = manifold.project(rng.uniform(low, high), low, high)
            if q is None:
                continue
            edge = np.vstack([q, q + rng.normal(size=len(q)) * rng.uniform(0.01, 0.3)])
            good = manifold.first_unproven_edge(edge) < 0
            true = all(
                not manifold.violations(edge[0] + s * (edge[1] - edge[0])) for s in np.linspace(0, 1, 200)
            )
            proven, stay, wrong = proven + good, stay + true, wrong + (good and not true)
        assert wrong == 0 and stay > 50 and proven >= 0.95 * stay


# --- failures ---
def failed(result, code: ErrorCode) -> str:
    assert result.code is code, (result.code, result.message)
    assert result.trajectory is None and result.path is None
    return result.message


def test_a_start_that_violates_says_which_and_by_how_much(free_panda):
    tilted = Constraints(
        orientations=(OrientationConstraint(AHEAD @ SO3.exp((0, 0.3, 0)), (np.pi, 0.1, 0.1)),)
    )
    result = plan(free_panda, PlanRequest("arm", (PoseGoal(at(0.5, 0.3, 0.5)),), path_constraints=tilted))
    text = failed(result, ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS)
    assert "panda_hand_tcp is turned by 0.3 rad about y" in text and "tolerance of 0.1" in text
    (violation,) = result.evidence["violations"]
    assert violation.amount == pytest.approx(0.2, abs=1e-4)


def test_contradictory_constraints_are_a_start_that_violates(free_panda):
    here = PositionConstraint(((Sphere(0.05), SE3.from_xyz(0.5, -0.3, 0.5)),))
    there = PositionConstraint(((Sphere(0.05), SE3.from_xyz(0.5, 0.3, 0.5)),))
    both = Constraints(positions=(here, there))
    result = plan(free_panda, PlanRequest("arm", (PoseGoal(at(0.5, 0.3, 0.5)),), path_constraints=both))
    assert "550 mm outside" in failed(result, ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS)


@pytest.mark.parametrize("kind", ["pose", "joints"])
def test_a_goal_that_violates_says_which_and_by_how_much(free_panda, kind):
    turned = SE3(AHEAD @ SO3.exp((0, 0, 0.5)), np.array([0.5, 0.2, 0.5]))
    goal = PoseGoal(turned)
    if kind == "joints":
        ik = ik_solver(free_panda.model, "arm")
        goal = JointGoal(JointState(ik.joint_names, ik.solve(turned, free_panda.positions).positions))
    result = plan(free_panda, PlanRequest("arm", (goal,), path_constraints=upright(0.2)))
    text = failed(result, ErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS)
    assert "turned by 0.5 rad about z" in text and "0.3 rad more" in text


def test_a_wide_goal_is_moved_onto_the_constraints(free_panda):
    """The goal's middle violates, but within its tolerances there are poses that do not."""
    turned = SE3(AHEAD @ SO3.exp((0, 0, 0.25)), np.array([0.5, 0.2, 0.5]))
    goal = PoseGoal(turned, position_tolerance=0.02, orientation_tolerance=0.2)
    request = PlanRequest("arm", (goal,), path_constraints=upright(0.15))
    assert judge(free_panda, request, plan(free_panda, request)) <= EDGE


def test_same_seed_same_path_and_another_seed_another():
    cell = CELLS["Panda, glass, around the divider, 0.1 rad"]
    one, two, other = (plan(cell.scene, cell.request(seed)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.path.waypoints, two.path.waypoints)
    np.testing.assert_array_equal(one.trajectory.positions, two.trajectory.positions)
    assert one.path.waypoints.shape != other.path.waypoints.shape or not np.allclose(
        one.path.waypoints, other.path.waypoints
    )


def closed_off() -> Cell:
    """A plane to stay in, and a wall across it."""
    scene = carrying("panda", [], at(0.5, -0.3, 0.5)).with_object(
        box("wall", (2.0, 0.02, 2.0), (1.2, 0.0, 0.5))
    )
    ahead = PositionConstraint(((Box(0.4, 2.0, 0.6), SE3.from_xyz(0.5, 0.0, 0.6)),))
    return Cell("closed", scene, at(0.5, 0.3, 0.5), Constraints(positions=(ahead,)))


def test_the_time_limit_and_cancelling():
    cell = closed_off()
    plan(cell.scene, cell.request(planning_time=0.05))  # compiled, fitted
    began = time.monotonic()
    result = plan(cell.scene, cell.request(planning_time=0.3))
    assert "no path found" in failed(result, ErrorCode.TIMED_OUT)
    assert 0.25 < time.monotonic() - began < 20.0
    cancel = threading.Event()
    threading.Timer(0.2, cancel.set).start()
    began = time.monotonic()
    result = plan(cell.scene, cell.request(planning_time=30.0), cancel)
    assert "cancelled" in failed(result, ErrorCode.PREEMPTED) and time.monotonic() - began < 20.0


def test_misuse_raises(free_panda):
    def asked(constraints, **options):
        return plan(
            free_panda,
            PlanRequest("arm", (PoseGoal(at(0.5, 0.3, 0.5)),), path_constraints=constraints, **options),
        )

    with pytest.raises(UnknownNameError, match="panda_hand"):
        asked(Constraints(orientations=(OrientationConstraint(AHEAD, (0.1, 0.1, 0.1), link="panda_hnd"),)))
    with pytest.raises(InputError, match=r"tolerance of 1e-06 rad \(give at least"):
        asked(Constraints(orientations=(OrientationConstraint(AHEAD, (0.1, 1e-6, 0.1)),)))
    with pytest.raises(InputError, match="regions are made of boxes"):
        asked(Constraints(positions=(PositionConstraint(((Cone(0.1, 0.1), SE3.identity()),)),)))
    with pytest.raises(InputError, match="which group 'arm' moves"):
        asked(Constraints(orientations=(OrientationConstraint(AHEAD, (0.1, 0.1, 0.1), frame="panda_link4"),)))
    with pytest.raises(InputError, match="group does not move"):
        asked(Constraints(joints=(JointConstraint("panda_finger_joint1", 0.0, 0.1, 0.1),)))
    with pytest.raises(InputError, match="cannot keep to path constraints.*native"):
        asked(upright(0.1), pipeline_id="ompl", planner_id="RRTstar")


def test_without_constraints_nothing_changes():
    scene = panda()
    goal = JointGoal(JointState(("panda_joint1",), [0.5]))
    assert plan(scene, PlanRequest("arm", (goal,))).planner_id == "straight line"
