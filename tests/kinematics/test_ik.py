"""Inverse kinematics: finds what is reachable, within limits, and says honestly what is not."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from tests.kinematics.arms import arm
from tests.model.helpers import MBM, dual, mbm_robot, random_positions

from armcell.core import SE3, SO3, ErrorCode, InputError, UnknownNameError
from armcell.kinematics import (
    IKSettings,
    IKSolver,
    NumericIK,
    ik_solver,
    ik_solvers,
    kinematic_tree,
    poses_about_axis,
)
from armcell.model import load_robot

POSES = 300
ARMS = {"panda": "arm", "ur10": "arm", "ur10_gripper": "arm"}


def solver(robot: str, **settings) -> IKSolver:
    return ik_solver(load_robot(robot), ARMS[robot], settings=IKSettings(**settings))


def numeric(robot: str, **settings) -> NumericIK:
    return NumericIK(load_robot(robot), ARMS[robot], settings=IKSettings(**settings))


def reached(ik: IKSolver, positions: np.ndarray, reference: np.ndarray) -> SE3:
    q = reference.copy()
    q[ik.columns] = positions
    return ik.tree.link_pose(q, ik.tip_link)


@pytest.mark.parametrize("robot", ARMS)
def test_every_reachable_pose_is_solved(robot):
    ik = solver(robot, solutions=1)
    model, rng, missed = ik.model, np.random.default_rng(0), 0
    for _ in range(POSES):
        target = ik.tree.link_pose(random_positions(model, rng), ik.tip_link)
        reference = model.default_positions()
        result = ik.solve(target, reference, rng=rng)
        missed += not result.ok
        if result.ok:
            model.check_positions(result.positions, ik.joint_names)
            assert reached(ik, result.positions, reference).isclose(target, 1e-5, 1e-4)
    assert missed == 0


def test_tips_prefixes_and_other_joints():
    """One arm of two: the other arm's joints stay and its reference counts."""
    model, rng = dual(), np.random.default_rng(1)
    ik = ik_solver(model, "right_arm")
    assert ik.tip_link == "right_gripper_tcp"
    for _ in range(20):
        reference = random_positions(model, rng)
        target = ik.tree.link_pose(random_positions(model, rng), ik.tip_link)
        result = ik.solve(target, reference, rng=rng)
        assert result.ok and reached(ik, result.positions, reference).isclose(target, 1e-5, 1e-4)


@pytest.mark.skipif(not MBM.is_dir(), reason="needs the MotionBenchMaker robots")
def test_a_link_of_a_branching_robot():
    model, rng = mbm_robot("baxter"), np.random.default_rng(2)
    from dataclasses import replace

    from armcell.model import Group

    names = tuple(n for n in model.joint_names if n.startswith("left_") and n[-2] in "sew")
    assert len(names) == 7
    ik = ik_solver(replace(model, groups={"left": Group("left", names, ())}), "left", "left_gripper")
    for _ in range(30):
        reference = random_positions(model, rng)
        q = reference.copy()
        q[ik.columns] = random_positions(model, rng)[ik.columns]
        result = ik.solve(ik.tree.link_pose(q, "left_gripper"), reference, rng=rng)
        assert result.ok


def test_the_solution_is_the_nearest_found():
    ik, rng = solver("ur10"), np.random.default_rng(3)
    for _ in range(10):
        q = random_positions(ik.model, rng)
        near = np.clip(q + rng.normal(0, 0.05, len(q)), ik.model.lower, ik.model.upper)
        result = ik.solve(ik.tree.link_pose(q, ik.tip_link), near, rng=np.random.default_rng(0))
        assert result.ok and np.linalg.norm(result.positions - near) <= np.linalg.norm(q - near) + 1e-6
        others = list(ik.solutions(ik.tree.link_pose(q, ik.tip_link), near, np.random.default_rng(0)))
        assert np.linalg.norm(result.positions - near) <= min(np.linalg.norm(o - near) for o in others) + 1e-9


def test_solutions_are_distinct():
    ik = solver("ur10")
    q = ik.model.default_positions()
    found = list(ik.solutions(ik.tree.link_pose(q, ik.tip_link), q, np.random.default_rng(0)))
    assert len(found) >= 4  # a UR has up to eight branches
    for i, a in enumerate(found):
        assert all(np.max(np.abs(a - b)) > 1e-2 for b in found[i + 1 :])


@pytest.mark.parametrize("robot", ARMS)
def test_out_of_reach_is_told_with_evidence(robot):
    ik, rng = solver(robot), np.random.default_rng(5)
    model, tree = ik.model, ik.tree
    reference = model.default_positions()
    first = model.joints[ik.joint_names[0]]
    shoulder = tree.link_pose(reference, first.child).translation
    stretched = sum(
        float(np.linalg.norm(j.T_parent_joint.translation)) for j in model.chain(first.child, ik.tip_link)
    )
    for _ in range(3):
        direction = rng.normal(size=3) * (1, 1, 0.2)
        distance = stretched + rng.uniform(0.3, 1.0)
        target = SE3(SO3.exp(rng.normal(size=3)), shoulder + distance * direction / np.linalg.norm(direction))
        result = ik.solve(target, reference, rng=np.random.default_rng(0))
        assert result.code is ErrorCode.NO_IK_SOLUTION and not result
        assert ik.tip_link in result.message and "closest" in result.message
        # What is reported is a real configuration ...
        model.check_positions(result.positions, ik.joint_names)
        closest = reached(ik, result.positions, reference)
        assert closest.isclose(result.evidence["closest_pose"], 1e-9, 1e-6)
        assert closest.distance_to(target) == pytest.approx(
            (result.position_error, result.rotation_error), abs=1e-6
        )
        # ... not nearer than geometry allows and not worse than blind search.
        assert result.position_error >= distance - stretched - 1e-9
        samples = [tree.link_pose(random_positions(model, rng), ik.tip_link) for _ in range(500)]
        best = min(p + 0.1 * a for p, a in (s.distance_to(target) for s in samples))
        assert result.position_error + 0.1 * result.rotation_error <= best + 1e-9
        for name in result.evidence["joints_at_limit"]:
            k = ik.joint_names.index(name)
            assert min(result.positions[k] - ik.lower[k], ik.upper[k] - result.positions[k]) < 1e-3


def test_is_valid_is_honoured():
    ik = solver("ur10")
    q = ik.model.default_positions()
    target = ik.tree.link_pose(q, ik.tip_link)
    elbow = ik.joint_names.index("elbow_joint")
    for sign in (1, -1):
        result = ik.solve(target, q, is_valid=lambda s, sign=sign: sign * s[elbow] > 0)
        assert result.ok and sign * result.positions[elbow] > 0
    refused = []
    result = ik.solve(target, q, is_valid=lambda s: refused.append(s) or False)
    assert result.code is ErrorCode.NO_IK_SOLUTION and "in collision" in result.message
    assert result.evidence["invalid_solutions"] == len(refused) >= 4


def test_the_same_seed_gives_the_same_answer():
    ik = solver("panda")
    target = ik.tree.link_pose(random_positions(ik.model, np.random.default_rng(6)), ik.tip_link)
    a, b = (
        ik.solve(target, ik.model.default_positions(), rng=np.random.default_rng(7)).positions
        for _ in range(2)
    )
    np.testing.assert_array_equal(a, b)


def test_the_reference_is_left_alone():
    ik = solver("panda")
    reference = ik.model.default_positions()
    before = reference.copy()
    ik.solve(ik.tree.link_pose(random_positions(ik.model, np.random.default_rng(8)), ik.tip_link), reference)
    np.testing.assert_array_equal(reference, before)


def test_misuse_is_named():
    panda = load_robot("panda")
    with pytest.raises(UnknownNameError, match="known: arm, arm_and_hand, hand"):
        ik_solver(panda, "arms")
    with pytest.raises(UnknownNameError, match="panda_hand_tpc"):
        ik_solver(panda, "arm", "panda_hand_tpc")
    with pytest.raises(InputError, match="'hand' is not a chain"):
        ik_solver(panda, "hand")


def test_a_half_turn_is_found():
    """The rotation error's axis is not determined there; the solver must still move."""
    ik = solver("panda")
    q = ik.model.default_positions()
    start = ik.tree.link_pose(q, ik.tip_link)
    for axis in np.eye(3):
        target = SE3(start.rotation @ SO3.exp(np.pi * axis), start.translation)
        result = ik.solve(target, q)
        if result.ok:
            assert reached(ik, result.positions, q).isclose(target, 1e-5, 1e-4)
    assert ik.solve(SE3(start.rotation @ SO3.exp((0, 0, np.pi)), start.translation), q).ok


def test_a_robot_names_the_solver_of_a_group(tmp_path):
    (tmp_path / "robot.yaml").write_text(
        "name: r\nparts: [{robot: ur10}]\nsrdf: r.srdf\nik_solvers: {arm: numeric}\n"
    )
    (tmp_path / "r.srdf").write_text(
        '<robot name="r"><group name="arm"><chain base_link="base_link" tip_link="tool0"/></group></robot>'
    )
    model = load_robot(tmp_path)
    assert (
        ik_solver(model, "arm").method == "numeric"
        and ik_solver(load_robot("ur10"), "arm").method == "analytic"
    )
    text = (tmp_path / "robot.yaml").read_text()
    (tmp_path / "robot.yaml").write_text(text.replace("numeric", "nummeric"))
    with pytest.raises(UnknownNameError, match="unknown IK solver 'nummeric'; known: analytic, numeric"):
        ik_solver(load_robot(tmp_path), "arm")
    (tmp_path / "robot.yaml").write_text(text.replace("{arm:", "{amr:"))
    with pytest.raises(UnknownNameError, match="ik_solvers: unknown planning group 'amr'"):
        load_robot(tmp_path)


def test_a_solver_that_does_not_fit_is_refused():
    panda = load_robot("panda")
    groups = {n: replace(g, ik_solver="analytic") for n, g in panda.groups.items()}
    with pytest.raises(InputError, match="'analytic' cannot solve group 'arm'"):
        ik_solver(replace(panda, groups=groups), "arm")


@pytest.mark.parametrize("name", list(ik_solvers))
def test_every_registered_solver_reaches_what_it_says_it_solves(name):
    """The contract: solutions are distinct, within limits, and at the pose; the same call gives the same."""
    solved = 0
    for robot, group in ARMS.items():
        model, rng = load_robot(robot), np.random.default_rng(3)
        if not ik_solvers[name].solves(model, group):
            continue
        solver, solved = ik_solvers[name](model, group), solved + 1
        for _ in range(10):
            reference = model.default_positions()
            target = solver.tree.link_pose(random_positions(model, rng), solver.tip_link)
            every = [
                list(islice(solver.solutions(target, reference, np.random.default_rng(0)), 8))
                for _ in range(2)
            ]
            np.testing.assert_array_equal(*every)
            for q in every[0]:
                model.check_positions(q, solver.joint_names, margin=1e-9)
                assert reached(solver, q, reference).isclose(target, 1e-5, 1e-4)
    assert solved


def test_five_joints_reach_a_pose_that_may_turn_about_an_axis():
    """By forward kinematics; the angle from which the goal was made is found as well."""
    model = load_robot("ur10")
    arm = model.group("arm")
    five = replace(arm, joint_names=arm.joint_names[:5], tip_link="wrist_2_link")
    model = replace(model, groups={"five": five})
    ik, rng = ik_solver(model, "five"), np.random.default_rng(0)
    T_tip_axis, made = SE3.from_xyz_rpy((0.02, -0.01, 0.1), (0.2, -0.3, 0.1)), 0
    for _ in range(20):
        q, turn = model.default_positions(), float(rng.uniform(-np.pi, np.pi))
        q[ik.columns] = random_positions(model, rng)[ik.columns]
        T_world_tip = ik.tree.link_pose(q, "wrist_2_link")
        goal = T_world_tip @ T_tip_axis @ about_z(-turn)
        poses = list(
            poses_about_axis(model, "five", "wrist_2_link", T_tip_axis, goal, model.default_positions())
        )
        for pose in poses:
            target = goal @ about_z(pose.angle) @ T_tip_axis.inverse()
            assert pose.T_world_tip.isclose(target, 1e-5, 1e-5)
            answer = ik.solve(target, model.default_positions())
            assert answer.ok, answer.message
            position, rotation = reached(ik, answer.positions, q).distance_to(target)
            assert position < 5e-5 and rotation < 5e-4
        made += any(abs(np.sin((pose.angle - turn) / 2)) < 1e-3 for pose in poses)
    assert made >= 19


@pytest.mark.parametrize("lean", (0.0, 0.02))
def test_four_joints_reach_a_leaning_goal_with_a_tilt(lean):
    """A planar arm on a turning base: the hand's y axis stays horizontal, the goal's does not."""
    model = arm(
        [(0.1, 0.0, np.pi / 2), (0.0, 0.3, 0.0), (0.0, 0.3, 0.0), (0.0, 0.1, -np.pi / 2)], "rrrr", limit=2.5
    )
    tree, rng, tilt = kinematic_tree(model), np.random.default_rng(0), 0.05
    for _ in range(10):
        T_world_tip = tree.link_pose(rng.uniform(-1.0, 1.0, 4), "tool")
        T_world_axis = SE3(SO3.identity(), T_world_tip.translation)
        T_tip_axis = (T_world_tip @ SE3(SO3.exp((lean, 0.0, 0.0)), np.zeros(3))).inverse() @ T_world_axis
        exact, tilted = (
            list(
                poses_about_axis(
                    model, "arm", "tool", T_tip_axis, T_world_axis, model.default_positions(), most
                )
            )
            for most in (0.0, tilt)
        )
        assert bool(exact) == (lean == 0.0) and tilted
        for pose in tilted:
            assert ik_solver(model, "arm").solve(pose.T_world_tip, model.default_positions()).ok
            T = T_world_axis.inverse() @ pose.T_world_tip @ T_tip_axis
            assert np.linalg.norm(T.translation) < 1e-5
            assert np.arccos(T.rotation.matrix[2, 2]) < 1.5 * tilt


def about_z(angle: float) -> SE3:
    return SE3(SO3.exp((0.0, 0.0, angle)), np.zeros(3))
