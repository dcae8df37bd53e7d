"""The numeric solver: any chain, fast, within limits; and what it says to questions that are wrong."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from tests.kinematics.arms import arm, dh_rows
from tests.model.helpers import (
    MBM,
    REFERENCES,
    PinRobot,
    chain_of,
    joint,
    link,
    mbm_robot,
    model_of,
    random_positions,
)  # fmt: skip

from armcell.core import SE3, SO3, ErrorCode, InputError, UnknownNameError
from armcell.kinematics import IKSettings, NumericIK, ik_solver
from armcell.kinematics.ik.chain import goal_in_base
from armcell.kinematics.ik.full_turns import full_turn_equivalents
from armcell.kinematics.ik.numeric import any_solution, ik_problem
from armcell.kinematics.ik.seeds import halton, pose_numbers
from armcell.model import Group, RobotModel, load_robot

TURN = 2 * np.pi


def grouped(model: RobotModel, tip: str) -> RobotModel:
    return replace(model, groups={"g": Group("g", model.joint_names, tuple(model.links), None, tip)})


def check(ik: NumericIK, target: SE3, result, reference: np.ndarray) -> None:
    ik.model.check_positions(result.positions, ik.joint_names)
    full = reference.copy()
    full[ik.columns] = result.positions
    meters, radians = ik.tree.link_pose(full, ik.tip_link).distance_to(target)
    assert meters <= 1.001e-6 and radians <= 1.001e-6 + 1e-7  # log of a rotation matrix is good to 1e-8
    assert result.position_error == pytest.approx(meters, abs=1e-9)


@pytest.mark.slow
@pytest.mark.cases("panda")
@pytest.mark.parametrize("robot", ["panda", "ur10"])
def test_a_thousand_poses_against_pinocchio(robot):
    """Poses by pinocchio's forward kinematics; every one solved from far away, and pinocchio agrees."""
    model, reference = REFERENCES[robot]()
    pin, ik, rng = PinRobot(reference, model), NumericIK(model, "arm"), np.random.default_rng(0)
    home = model.default_positions()
    for _ in range(1000):
        pin.place(ik.tree.full_positions(random_positions(model, rng)))
        target = SE3.from_matrix(pin.pose(ik.tip_link))
        result = ik.solve(target, home)
        assert result.ok
        check(ik, target, result, home)
        full = home.copy()
        full[ik.columns] = result.positions
        pin.place(ik.tree.full_positions(full))
        np.testing.assert_allclose(pin.pose(ik.tip_link), target.matrix, atol=3e-6)


@pytest.mark.long
def test_the_compiled_function_finds_all_of_a_thousand():
    ik = NumericIK(load_robot("panda"), "arm")
    chain, seeds, home = ik.chain_data.chain, ik.chain_data.seeds, ik.model.default_positions()
    rng, goal, found = np.random.default_rng(1), np.empty(12), np.empty((1, 7))
    for _ in range(1000):
        target = ik.tree.link_pose(random_positions(ik.model, rng), ik.tip_link).matrix
        goal_in_base(chain.inverse_base, target, goal)
        problem = ik_problem(chain, goal, home[ik.columns], IKSettings())
        assert any_solution(problem, seeds.positions, seeds.poses, 200, found)


def odd_chains() -> dict[str, RobotModel]:
    up = '<origin xyz="0.1 0.05 0.4" rpy="0.2 0 0.4"/>'
    mimics = model_of(
        link("a"), link("b"), link("c"), link("d"), link("e"),
        joint("j1", "a", "b", inside=f'{up}<axis xyz="0 1 0"/>'),
        joint("j2", "b", "c", inside=f'{up}<axis xyz="1 0 0"/><mimic joint="j1" multiplier="-2"/>'),
        joint("j3", "c", "d", inside=f'{up}<axis xyz="0 0 1"/>'),
        joint("j4", "d", "e", "prismatic", inside=f'{up}<axis xyz="1 0 0"/>'),
    )  # fmt: skip
    return {
        "one joint": grouped(chain_of("revolute 0 0 1"), "l1"),
        "a slide": grouped(chain_of("prismatic 0 1 1"), "l1"),
        "three": grouped(chain_of("revolute 0 1 0", "prismatic 1 0 0", "continuous 0 0 1"), "l3"),
        "eight": grouped(chain_of(*["revolute 0 1 0", "revolute 0 0 1"] * 4), "l8"),
        "twenty": grouped(chain_of(*["revolute 0 1 0", "continuous 1 0 1"] * 10), "l20"),
        "mimics": grouped(mimics, "e"),
        "floating": grouped(chain_of("floating 0 0 1", "revolute 0 1 0"), "l2"),
        "endless": arm(dh_rows("UR10"), types="cccccc"),
    }


@pytest.mark.parametrize("name", odd_chains())
def test_any_chain(name):
    model = odd_chains()[name]
    ik, rng = NumericIK(model, next(iter(model.groups))), np.random.default_rng(2)
    missed = 0
    for _ in range(100):
        reference, q = random_positions(model, rng), random_positions(model, rng)
        target = ik.tree.link_pose(q, ik.tip_link)
        result = ik.solve(target, reference)
        missed += not result.ok
        if result.ok:
            check(ik, target, result, reference)
    assert missed == 0


def test_joints_outside_the_group_count():
    """A torso below the arm, and a joint of the arm that the group leaves out: both stay at the reference."""
    model = arm(dh_rows("UR10"), torso=True)
    without = replace(model, groups={"some": Group("some", ("j1", "j2", "j3", "j5", "j6"), (), None, "tool")})
    ik, rng = ik_solver(without, "some"), np.random.default_rng(3)
    assert ik.method == "numeric"
    for _ in range(50):
        reference = random_positions(without, rng)
        q = reference.copy()
        q[ik.columns] = random_positions(without, rng)[ik.columns]
        target = ik.tree.link_pose(q, "tool")
        result = ik.solve(target, reference)
        assert result.ok
        check(ik, target, result, reference)


def test_a_redundant_arm_has_many_solutions():
    ik, rng = NumericIK(load_robot("panda"), "arm"), np.random.default_rng(4)
    for _ in range(10):
        q = random_positions(ik.model, rng)
        target = ik.tree.link_pose(q, ik.tip_link)
        found = list(ik.solutions(target, q))
        assert len(found) >= 10
        np.testing.assert_allclose(found[0], q[ik.columns], atol=1e-9)  # the reference itself solves it
        for k, s in enumerate(found):
            ik.model.check_positions(s, ik.joint_names)
            full = q.copy()
            full[ik.columns] = s
            assert ik.tree.link_pose(full, ik.tip_link).isclose(target, 1.1e-6, 1.1e-6)
            assert all(np.max(np.abs(s - other)) > 1e-2 for other in found[:k])


def test_the_nearest_of_those_asked_for_is_taken_and_brought_nearer():
    """Against many solutions from seeds all over: only seldom is one of them much nearer."""
    model, rng = load_robot("panda"), np.random.default_rng(5)
    home = model.default_positions()
    ik = NumericIK(model, "arm")
    excess = []
    for _ in range(100):
        target = ik.tree.link_pose(random_positions(model, rng), ik.tip_link)
        result = ik.solve(target, home)
        check(ik, target, result, home)
        distances = [np.linalg.norm(s - home[:7]) for s in ik.solutions(target, home)]
        excess.append(np.linalg.norm(result.positions - home[:7]) - min(distances))
        assert np.linalg.norm(result.positions - home[:7]) <= min(distances[:8]) + 1e-9
    assert np.mean(excess) < 0.05 and np.mean(np.array(excess) < 0.01) > 0.7


def test_sliding_ends_where_nothing_is_nearer():
    """In the end no move along the arm's freedom (the Jacobian's null space, by SVD) brings it nearer."""
    model, rng, left = load_robot("panda"), np.random.default_rng(11), []
    home = model.default_positions()
    ik = NumericIK(model, "arm", settings=IKSettings(solutions=1))
    for _ in range(100):
        target = ik.tree.link_pose(random_positions(model, rng), ik.tip_link)
        q = ik.solve(target, home).positions
        if min(np.min(q - ik.lower), np.min(ik.upper - q)) < 1e-2:
            continue  # a limit is in the way
        free = np.linalg.svd(ik.tree.jacobian(np.r_[q, home[7:]], ik.tip_link, ik.joint_names))[2][-1]
        left.append(abs(free @ (home[:7] - q)))
    assert len(left) > 60 and np.mean(np.array(left) < 0.01) > 0.9


def test_is_valid_is_asked_until_it_agrees():
    ik, asked = NumericIK(load_robot("panda"), "arm"), []
    home = ik.model.default_positions()
    target = ik.tree.link_pose(home, ik.tip_link)

    def bent(q):
        asked.append(q)
        return q[0] > 0.5

    result = ik.solve(target, home, is_valid=bent)
    assert result.ok and result.positions[0] > 0.5 and any(q[0] <= 0.5 for q in asked)
    refused = ik.solve(target, home, is_valid=lambda q: False)
    assert refused.code is ErrorCode.NO_IK_SOLUTION and refused.evidence["invalid_solutions"] >= 10
    assert refused.position_error <= 1e-6


def test_whole_turns_of_a_bounded_and_an_endless_joint():
    model = grouped(chain_of("continuous 0 0 1", "prismatic 0 0 1", "revolute 0 1 0"), "l3")
    chain = NumericIK(model, "g").chain_data.chain
    bounds = np.array([[-np.inf, np.inf], [-20.0, 20.0], [-7.0, 9.0]])
    chain = replace(chain, bounds=bounds)
    found = full_turn_equivalents(np.array([0.5, 1.5, 2.0]), np.array([20.0, 20.0, -1.0]), chain)
    near = 0.5 + 3 * TURN
    np.testing.assert_allclose(found, [[near, 1.5, 2.0], [near, 1.5, 2.0 - TURN], [near, 1.5, 2.0 + TURN]])
    assert chain.turning.tolist() == [True, False, True]


def test_a_mimic_with_a_gear_has_no_whole_turns():
    gear = model_of(
        link("a"), link("b"), link("c"),
        joint("j1", "a", "b", "continuous"),
        joint("j2", "b", "c", inside='<axis xyz="0 1 0"/><mimic joint="j1" multiplier="0.5"/>'),
    )  # fmt: skip
    assert NumericIK(grouped(gear, "c"), "g").chain_data.chain.turning.tolist() == [False]


@pytest.mark.slow
def test_seeds_are_spread_and_quaternions_right():
    points = halton(512, 7)
    assert points.min() >= 0 and points.max() < 1 and np.abs(points.mean(axis=0) - 0.5).max() < 0.05
    assert len({tuple(p) for p in points}) == 512
    from scipy.stats import qmc

    np.testing.assert_allclose(points, qmc.Halton(7, scramble=False).random(513)[1:], atol=1e-12)
    rng, out = np.random.default_rng(6), np.empty(7)
    for rotation in [SO3.exp(v) for v in rng.normal(size=(50, 3)) * 2] + [
        SO3.exp(np.pi * e) for e in np.eye(3)
    ]:
        T = SE3(rotation, rng.normal(size=3))
        pose_numbers(T.matrix[:3].ravel(), out)
        np.testing.assert_allclose(out[:3], T.translation)
        assert abs(out[3:] @ T.quat_wxyz) == pytest.approx(1.0)


@pytest.mark.slow
def test_two_threads_get_the_answers_of_one():
    model = arm(dh_rows("UR10"), torso=True)
    rng = np.random.default_rng(7)
    for ik in (NumericIK(load_robot("panda"), "arm"), NumericIK(model, "arm"), ik_solver(model, "arm")):
        cases = []
        for _ in range(60):
            reference = random_positions(ik.model, rng)
            q = reference.copy()
            q[ik.columns] = random_positions(ik.model, rng)[ik.columns]
            cases.append((ik.tree.link_pose(q, ik.tip_link), reference))
        alone = [ik.solve(*case).positions for case in cases]
        together: dict[int, list] = {}

        def work(k, ik=ik, cases=cases, together=together):
            together[k] = [ik.solve(*case).positions for case in cases]

        threads = [threading.Thread(target=work, args=(k,)) for k in range(2)]
        for t in threads:
            t.start()
        for t in threads:
            t.join()
        for answers in together.values():
            np.testing.assert_array_equal(answers, alone)
        assert len(together) == 2


@pytest.mark.parametrize("robot", ["panda", "ur10"])
def test_wrong_questions_are_named(robot):
    model = load_robot(robot)
    ik, home = ik_solver(model, "arm"), model.default_positions()
    target = ik.tree.link_pose(home, ik.tip_link)
    for ask in (ik.solve, lambda *a: list(ik.solutions(*a)), lambda T, q: ik.descend(np.array(q), T)):
        for broken in (home[:-1], np.r_[home, 0.0], home[None], [], 0.0):
            with pytest.raises(InputError, match=rf"needs \({model.dof},\).*all joints"):
                ask(target, broken)
        for value in (np.nan, np.inf, -np.inf):
            with pytest.raises(InputError, match=f"{model.joint_names[2]} is not finite"):
                ask(target, np.r_[home[:2], value, home[3:]])
            with pytest.raises(InputError, match="finite"):
                ask(SE3(target.rotation, np.array([0.3, value, 0.3])), home)
            with pytest.raises(InputError, match="finite"):
                ask(SE3(SO3(np.full((3, 3), value)), np.array([0.3, 0.0, 0.3])), home)
    with pytest.raises(UnknownNameError, match="unknown link 'nowhere'"):
        ik_solver(model, "arm", "nowhere")
    with pytest.raises(UnknownNameError, match="unknown planning group"):
        ik_solver(model, "nothing")
    for setting in ("seeds", "solutions", "max_iterations", "position_tolerance", "rotation_tolerance"):
        for value in (0, -1, np.nan, np.inf):
            with pytest.raises(InputError, match=f"{setting} is .* must be positive"):
                IKSettings(**{setting: value})
    root = model.root_link
    with pytest.raises(InputError, match=f"moves link '{root}'"):
        ik_solver(model, "arm", root)


def test_one_seed_is_enough_for_the_reference_itself():
    ik = NumericIK(load_robot("panda"), "arm", settings=IKSettings(seeds=1, solutions=1))
    home = ik.model.default_positions()
    assert ik.solve(ik.tree.link_pose(home, ik.tip_link), home).ok
    assert len(list(ik.solutions(ik.tree.link_pose(home, ik.tip_link), home))) == 1


def test_a_reference_out_of_limits_is_no_obstacle():
    ik, rng = NumericIK(load_robot("panda"), "arm"), np.random.default_rng(8)
    for _ in range(20):
        target = ik.tree.link_pose(random_positions(ik.model, rng), ik.tip_link)
        reference = rng.uniform(-10, 10, ik.model.dof)
        result = ik.solve(target, reference)
        assert result.ok
        check(ik, target, result, reference)


def test_far_away_is_answered_at_once_and_in_reach_after_all_seeds():
    ik, home = NumericIK(load_robot("panda"), "arm"), load_robot("panda").default_positions()
    far = SE3.from_xyz(5.0, 0.0, 0.0)
    ik.solve(far, home)
    result = ik.solve(far, home)
    assert "it is 5.01 m from the first joint, the arm reaches 1.09 m at most" in result.message
    assert result.evidence["distance_m"] == pytest.approx(np.hypot(5.0, 0.333), abs=1e-6)
    upwards = SE3.from_xyz(0.95, 0.0, 0.333)  # near enough, but only a hand that points outwards gets there
    result = ik.solve(upwards, home)
    assert result.code is ErrorCode.NO_IK_SOLUTION and result.evidence["joints_at_limit"]
    assert result.evidence["distance_m"] < result.evidence["reach_m"] and "reaches" not in result.message


@pytest.mark.skipif(not MBM.is_dir(), reason="needs the MotionBenchMaker robots")
def test_both_arms_of_baxter():
    model, rng = mbm_robot("baxter"), np.random.default_rng(9)
    for side in ("left", "right"):
        names = tuple(n for n in model.joint_names if n.startswith(f"{side}_") and n[-2] in "sew")
        ik = ik_solver(replace(model, groups={"g": Group("g", names, ())}), "g", f"{side}_gripper")
        for _ in range(200):
            reference, q = random_positions(model, rng), random_positions(model, rng)
            q = np.where(np.isin(np.arange(model.dof), ik.columns), q, reference)
            target = ik.tree.link_pose(q, ik.tip_link)
            result = ik.solve(target, reference)
            assert result.ok
            check(ik, target, result, reference)
