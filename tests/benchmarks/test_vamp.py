"""VAMP as a peer of the planning benchmark, wherever it is installed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.planning.peers import UnsupportedRobot
from benchmarks.planning.problems import Problem, Robot

from armcell.core import SE3

peer = pytest.importorskip("benchmarks.planning.peers.vamp", exc_type=ImportError)

JOINTS = tuple(f"panda_joint{i}" for i in range(7, 0, -1))  # not VAMP's order
HOME = np.array([0.8, 1.6, 0.0, -2.0, 0.0, -0.5, 0.0])
TURNED = HOME + np.array([0, 0, 0, 0, 0, 0, 1.6])
TILTED = {"name": "slab", "type": "box", "position": [0.4, 0.35, 0.5],
          "quat_xyzw": [0.2, 0.3, 0.1, np.sqrt(0.86)], "size": [0.4, 0.06, 0.5]}  # fmt: skip
LYING = {"name": "can", "type": "cylinder", "position": [0.35, -0.3, 0.4],
         "quat_xyzw": [0.5, 0.1, -0.3, np.sqrt(0.65)], "radius": 0.08, "length": 0.4}  # fmt: skip


@pytest.fixture
def panda():
    vamp = peer.Vamp()
    vamp.load(Robot("panda", Path("panda.urdf"), JOINTS, {}))
    return vamp


def test_it_plans_in_the_robots_joint_order(panda):
    panda.set_problem(Problem("any", 1, HOME, TURNED, [TILTED, LYING]))
    result = panda.plan(0, 1.0)
    for path in (result.raw, result.waypoints):
        assert path.shape[1] == 7 and np.allclose(path[[0, -1]], [HOME, TURNED], atol=1e-5)
    assert result.plan_us > 0 and result.simplify_us > 0 and result.certify_us == 0
    again = panda.plan(0, 1.0)
    assert np.array_equal(again.waypoints, result.waypoints)


@pytest.mark.parametrize("obstacle", [TILTED, LYING])
def test_obstacles_are_where_they_belong(panda, obstacle):
    """VAMP's answers against distances between its spheres and the obstacle."""
    panda.set_problem(Problem("any", 1, HOME, HOME, [obstacle]))
    T_world_obstacle = SE3.from_quat_xyzw(obstacle["position"], obstacle["quat_xyzw"]).matrix
    answers = []
    lower, upper = panda.module.lower_bounds(), panda.module.upper_bounds()
    for q in np.random.default_rng(0).uniform(lower, upper, (2000, 7)).astype(np.float32):
        if not panda.module.validate(q):  # touches itself
            continue
        spheres = [(s.x, s.y, s.z, s.r) for s in panda.module.fk(q)]
        centers, radii = np.array(spheres)[:, :3], np.array(spheres)[:, 3]
        local = (centers - T_world_obstacle[:3, 3]) @ T_world_obstacle[:3, :3]
        gap = _distances(obstacle, local) - radii
        if abs(gap.min()) > 1e-4:
            answers.append((panda.module.validate(q, panda._environment), bool(gap.min() > 0)))
    vamp, ours = np.array(answers).T
    assert len(ours) > 500 and 0.05 < ours.mean() < 0.99
    assert np.array_equal(vamp, ours)


def test_a_goal_that_touches_its_spheres_is_not_solved(panda):
    at_hand = {**TILTED, "position": [0.3, 0.0, 0.6]}
    panda.set_problem(Problem("any", 1, HOME, TURNED, [at_hand]))
    result = panda.plan(0, 1.0)
    assert result.waypoints is None and result.total_us == 0


def test_other_robots_are_not_supported():
    for robot in (Robot("planar", Path(), ("shoulder",), {}), Robot("panda", Path(), ("shoulder",), {})):
        with pytest.raises(UnsupportedRobot, match="panda"):
            peer.Vamp().load(robot)


def _distances(obstacle, points):
    """Of points (n, 3) in the obstacle's frame to the box, or to the capsule that stands for a cylinder."""
    if obstacle["type"] == "box":
        return np.linalg.norm(np.maximum(np.abs(points) - np.array(obstacle["size"]) / 2, 0), axis=1)
    half = obstacle["length"] / 2
    on_axis = points - np.column_stack([0 * points[:, :2], np.clip(points[:, 2], -half, half)])
    return np.linalg.norm(on_axis, axis=1) - obstacle["radius"]
