"""CHOMP and STOMP: distances and gradients against references, what they answer, and CHOMP as a smoother."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from tests.planning.helpers import judge, panda_wall, request, ur10_wall, walled_in
from tests.planning.test_plan import beyond_panda
from tests.scene.helpers import box, mesh_of, open_bin, panda

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    Capsule,
    Constraints,
    Cylinder,
    InputError,
    JointConstraint,
    JointGoal,
    JointState,
    Sphere,
    UnknownNameError,
)
from armcell.core.requests import ADAPTERS
from armcell.kinematics import kinematic_tree
from armcell.planning import plan
from armcell.planning.planners.distance_field import FAR, STEP, DistanceField
from armcell.planning.planners.obstacle_cost import ObstacleCost, RobotSpheres
from armcell.planning.planners.trajectory_optimization import resample_path, smooth_metric
from armcell.scene import CollisionObject

AROUND = np.full(3, -1.0), np.full(3, 1.0)
POSE = SE3.from_xyz_rpy((0.1, -0.2, 0.15), (0.3, -0.4, 0.8))
SOLIDS = {
    "cylinder": (Cylinder(0.12, 0.3), coal.Cylinder(0.12, 0.3)),
    "capsule": (Capsule(0.1, 0.3), coal.Capsule(0.1, 0.3)),
    "sphere": (Sphere(0.2), coal.Sphere(0.2)),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_the_field_has_coal_s_distances(name):
    shape, reference = SOLIDS[name]
    field = DistanceField((CollisionObject.single("it", shape, POSE),), *AROUND)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (400, 3)).astype(np.float32)
    found = field.distances(points)
    here, there = coal.Transform3s(), coal.Transform3s()
    here.setTransform(POSE.rotation.matrix, POSE.translation)
    ball = coal.Sphere(1e-6)
    for point, value in zip(points, found, strict=True):
        there.setTransform(np.eye(3), point.astype(float))
        result = coal.DistanceResult()
        wanted = coal.distance(reference, here, ball, there, coal.DistanceRequest(), result) + 1e-6
        # Linear between grid points: off by at most a part of a step, where the distance has a kink.
        if wanted > 0:
            assert value == pytest.approx(min(wanted, FAR), abs=0.6 * STEP)
        else:  # coal's depths are not always the least
            assert max(wanted, -0.2) - 0.6 * STEP <= value <= 0.6 * STEP


def test_a_surface_is_drawn_and_filled_where_it_is_closed():
    """An open bin: its walls are solid, its inside is not; of a closed box of triangles the inside is."""
    bin_ = CollisionObject.single("bin", mesh_of(open_bin(0.4, 0.2, 0.05)), SE3.identity())
    field = DistanceField((bin_,), *AROUND)
    ask = np.array([[0.0, 0.0, 0.15], [0.175, 0.0, 0.1], [0.0, 0.0, 0.0], [0.5, 0.0, 0.1]], np.float32)
    # In the middle: 0.1 m above the floor; in a wall; at the lower face; 0.3 m outside (capped).
    found = field.distances(ask)
    assert found[0] == pytest.approx(0.1, abs=1.5 * STEP)
    assert found[1] < 0.5 * STEP and abs(found[2]) < 1.5 * STEP and found[3] == pytest.approx(FAR)
    import trimesh

    solid = CollisionObject.single("box", mesh_of(trimesh.creation.box((0.3, 0.3, 0.3))), SE3.identity())
    inside = DistanceField((solid,), *AROUND).distances(np.zeros((1, 3), np.float32))
    assert inside[0] == pytest.approx(-0.15, abs=1.5 * STEP)


def test_gradients_of_the_field_are_its_differences():
    field = DistanceField((CollisionObject.single("it", Capsule(0.1, 0.3), POSE),), *AROUND)
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.3, 0.3, (200, 3)).astype(np.float32)
    _, gradient = field.gradients(points)
    h = 1e-4
    numeric = np.stack(
        [
            (field.distances(points + h * e) - field.distances(points - h * e)) / (2 * h)
            for e in np.eye(3, dtype=np.float32)
        ],
        axis=1,
    )
    apart = np.abs(numeric - gradient).max(axis=1)
    assert np.quantile(apart, 0.95) < 5e-3  # a few points lie on the border of two cells


def test_spheres_are_carried_by_their_links():
    scene = panda()
    checker = KernelChecker(scene, scene.model.group("arm").joint_names)
    spheres, tree = RobotSpheres(checker), kinematic_tree(scene.model)
    rng, relative = np.random.default_rng(2), []
    for _ in range(3):
        q = rng.uniform(checker.model.lower[checker.columns], checker.model.upper[checker.columns])
        x = spheres.centers(*spheres.frame_poses(q[None]))[0]
        full = scene.positions.copy()
        full[checker.columns] = q
        poses = [tree.link_pose(full, name) for name in checker.names.bodies]
        relative.append([poses[b].inverse().apply(p) for b, p in zip(spheres.body, x, strict=True)])
    np.testing.assert_allclose(relative[0], relative[1], atol=2e-6)
    np.testing.assert_allclose(relative[0], relative[2], atol=2e-6)


def test_pulls_on_spheres_become_joint_gradients():
    scene = panda()
    checker = KernelChecker(scene, scene.model.group("arm").joint_names)
    spheres, rng = RobotSpheres(checker), np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (4, 7))
    R, o = spheres.frame_poses(q)
    x = spheres.centers(R, o)
    pull = rng.normal(size=x.shape).astype(np.float32)
    found = spheres.joint_gradient(R, o, x, pull)
    h = 1e-3
    for j in range(7):
        step = h * np.eye(7)[j]
        ahead, behind = (spheres.centers(*spheres.frame_poses(q + s)).astype(float) for s in (step, -step))
        numeric = ((ahead - behind) / (2 * h) * pull).sum(axis=(1, 2))
        np.testing.assert_allclose(found[:, j], numeric, rtol=2e-3, atol=0.05)


def test_a_step_along_the_covariant_gradient_costs_less():
    """Of a line straight through the wall."""
    scene = panda_wall()
    checker = KernelChecker(scene, scene.model.group("arm").joint_names)
    cost = ObstacleCost(checker, 0.05)
    start = scene.positions[checker.columns]
    goal = start * np.array([-1, 1, 1, 1, 1, 1, 1])
    path = resample_path(np.vstack([start, goal]), 40)
    value, gradient, least = cost.gradient(path)
    assert least < 0.0 < value
    step = smooth_metric(40)[0] @ gradient[1:-1]
    nearer = path.copy()
    nearer[1:-1] -= 0.05 * step / np.abs(step).max()
    after, _, farther = cost.gradient(nearer)
    assert after < value and farther > least
    assert cost.of_paths(nearer[None]).sum() < cost.of_paths(path[None]).sum()


UR_GOAL = JointGoal(JointState(("shoulder_pan_joint",), [0.8]))


@pytest.mark.slow
@pytest.mark.cases("chomp-*")
@pytest.mark.parametrize(("pipeline", "seconds"), [("chomp", 20.0), ("stomp", 60.0)])
def test_they_go_over_a_wall(pipeline, seconds):
    for scene, goal in ((panda_wall(), beyond_panda()), (ur10_wall(), UR_GOAL)):
        result = plan(scene, request(goal, pipeline_id=pipeline, planner_id="", planning_time=seconds))
        assert result.ok and result.planner_id == pipeline.upper(), result.message
        judge(scene, result.trajectory)


@pytest.mark.slow
@pytest.mark.parametrize("pipeline", ["chomp", "stomp"])
def test_the_same_seed_gives_the_same_motion(pipeline):
    asked = request(beyond_panda(), pipeline_id=pipeline, planner_id="", planning_time=60.0, seed=3)
    a, b = (plan(panda_wall(), asked) for _ in range(2))
    np.testing.assert_array_equal(a.trajectory.positions, b.trajectory.positions)


@pytest.mark.parametrize("pipeline", ["chomp", "stomp"])
def test_what_they_cannot_free_they_say(pipeline):
    scene, goal = walled_in()
    few = {"max_starts": 1, ("max_iterations" if pipeline == "chomp" else "num_iterations"): 5}
    result = plan(
        scene, request(goal, pipeline_id=pipeline, planner_id="", planning_time=60.0, parameters=few)
    )
    assert not result.ok and "no free path after 5 iterations from 1 first paths" in result.message
    assert result.trajectory is None and result.evidence["iterations"] == 5.0


def test_their_parameters_are_checked():
    with pytest.raises(InputError, match="learning_rate"):
        plan(
            panda_wall(),
            request(
                beyond_panda(), pipeline_id="chomp", planner_id="CHOMP", parameters={"learning_rate": -1.0}
            ),
        )
    with pytest.raises(UnknownNameError, match="CHOMP"):  # a planner that is named is not replaced
        plan(panda_wall(), request(beyond_panda(), pipeline_id="chomp", planner_id="RRTConnect"))


# --- as a smoother ---
@pytest.mark.slow
@pytest.mark.cases("chomp_smoothing")
@pytest.mark.parametrize("name", ["chomp_smoothing", "chomp/OptimizerAdapter"])
def test_smoothing_after_another_planner_leads_away_from_obstacles(name):
    scene = panda_wall()
    plain = plan(scene, request(beyond_panda()))
    smooth = plan(scene, request(beyond_panda(), adapters=(*ADAPTERS, name), planning_time=60.0))
    assert smooth.ok and smooth.planner_id == "RRTConnect" and smooth.evidence["smoothed"]
    judge(scene, smooth.trajectory)
    np.testing.assert_allclose(smooth.path.waypoints[[0, -1]], plain.path.waypoints[[0, -1]])
    assert smooth.min_clearance > plain.min_clearance

    def bend(path):  # squared accelerations at equal steps
        return np.square(np.diff(resample_path(path.waypoints, 60), n=2, axis=0)).sum()

    assert bend(smooth.path) < bend(plain.path)


def test_smoothing_does_not_go_with_path_constraints():
    corridor = Constraints(joints=(JointConstraint("panda_joint3", 0.0, 2.0, 2.0),))
    with pytest.raises(InputError, match="chomp_smoothing"):
        plan(
            panda(box("far", (0.1, 0.1, 0.1), (0.0, 0.9, 0.9))),
            request(beyond_panda(), path_constraints=corridor, adapters=(*ADAPTERS, "chomp_smoothing")),
        )
