"""The analytic solver: every branch, on every UR, wherever it is mounted; and never on another arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.kinematics.arms import UR, arm, dh_pose, dh_rows
from tests.model.helpers import MBM, REFERENCES, PinRobot, dual, mbm_robot, random_positions

from armcell.core import SE3, SO3, ErrorCode, InputError
from armcell.kinematics import AnalyticIK, IKSolver, NumericIK, ik_solver, kinematic_tree
from armcell.model import Group, MountedRobot, RobotModel, compose, load_robot

TURN = 2 * np.pi


def pose_of(ik: IKSolver, q: np.ndarray, reference: np.ndarray) -> SE3:
    full = reference.copy()
    full[ik.columns] = q
    return ik.tree.link_pose(full, ik.tip_link)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest joint difference, whole turns aside."""
    return float(np.max(np.abs((a - b + np.pi) % TURN - np.pi)))


def check(ik: IKSolver, target: SE3, reference: np.ndarray, tolerance: float = 1e-7) -> list[np.ndarray]:
    """The solutions, each within limits, reaching the target and unlike the others."""
    found = list(ik.solutions(target, reference))
    for k, q in enumerate(found):
        ik.model.check_positions(q, ik.joint_names)
        assert pose_of(ik, q, reference).isclose(target, tolerance, tolerance)
        assert all(apart(q, other) > 1e-6 for other in found[:k])
    return found


@pytest.mark.slow
def test_ur10_a_thousand_poses_against_pinocchio():
    """Every configuration is among the solutions of its pose, and pinocchio agrees with all of them."""
    model, reference = REFERENCES["ur10"]()
    pin, ik, rng = PinRobot(reference, model), ik_solver(model, "arm"), np.random.default_rng(0)
    assert isinstance(ik, AnalyticIK)
    counts = []
    for _ in range(1000):
        q = random_positions(model, rng)
        pin.place(dict(zip(model.joint_names, q)))
        target = SE3.from_matrix(pin.pose("tool0"))
        found = list(ik.solutions(target, q))
        assert min(apart(q, other) for other in found) < 1e-6
        np.testing.assert_allclose(found[0], q, atol=1e-6)  # nearest to the reference comes first
        counts.append(len(found))
        for other in found:
            pin.place(dict(zip(model.joint_names, other)))
            np.testing.assert_allclose(pin.pose("tool0"), target.matrix, atol=1e-9)
    assert set(counts) <= {2, 4, 6, 8} and counts.count(8) > 700


def test_ur10_finds_what_eaik_finds_and_nothing_else():
    hp = pytest.importorskip("eaik.IK_HP")
    model = load_robot("ur10")
    tree, tip = (
        kinematic_tree(model),
        "wrist_3_link",
    )  # eaik's pose is that of the last joint, unturned at zero
    zero = tree.link_transforms(np.zeros(6))
    joints = [model.joints[name] for name in model.joint_names]
    at = np.array([zero[tree.link_index[j.child]] for j in joints])
    H = np.array([T[:3, :3] @ j.axis for T, j in zip(at, joints)])
    P = np.vstack([at[0, :3, 3], np.diff(at[:, :3, 3], axis=0), np.zeros(3)])
    other = hp.HPRobot(H, P)
    ik, rng = ik_solver(model, "arm", tip), np.random.default_rng(1)
    for _ in range(300):
        q = rng.uniform(-np.pi, np.pi, 6)
        target = tree.link_pose(q, tip)
        posed = target.matrix
        posed[:3, :3] = posed[:3, :3] @ at[-1, :3, :3].T
        np.testing.assert_allclose(other.fwdKin(q), posed, atol=1e-9)
        answer = other.IK(posed)
        theirs = [s for s, approximate in zip(answer.Q, answer.is_LS) if not approximate]
        ours = check(ik, target, q)
        assert len(theirs) == len(ours)
        for s in theirs:
            assert min(apart(s, o) for o in ours) < 1e-5
        for o in ours:
            assert min(apart(s, o) for s in theirs) < 1e-5


@pytest.mark.parametrize("name", UR)
def test_every_ur_by_its_table(name):
    """The published DH table, multiplied out by hand, against the solver on the same arm as a URDF."""
    ik, rng = ik_solver(arm(dh_rows(name)), "arm"), np.random.default_rng(2)
    assert ik.method == "analytic"
    mount = ik.tree.link_pose(np.zeros(6), "tool") @ SE3.from_matrix(dh_pose(name, np.zeros(6))).inverse()
    for _ in range(50):
        q = rng.uniform(-np.pi, np.pi, 6)
        target = mount @ SE3.from_matrix(dh_pose(name, q))
        found = check(ik, target, q)
        np.testing.assert_allclose(found[0], q, atol=1e-6)


def test_turned_axes_and_order_do_not_matter():
    for signs in ((1, -1, 1, -1, 1, -1), (-1, 1, -1, -1, -1, 1)):
        ik, rng = ik_solver(arm(dh_rows("UR5e"), signs=signs), "arm"), np.random.default_rng(3)
        assert ik.method == "analytic"
        for _ in range(50):
            q = rng.uniform(-np.pi, np.pi, 6)
            np.testing.assert_allclose(check(ik, pose_of(ik, q, q), q)[0], q, atol=1e-6)


def test_in_a_bigger_robot():
    """Prefixes, two arms, grippers, a mount that is turned, and a torso that is not of the group."""
    rng = np.random.default_rng(4)
    ceiling = SE3.from_xyz_rpy((0.3, -1.5, 2.0), (np.pi, 0.3, 0.2))
    arm_ = load_robot("ur10_gripper")
    hung = compose("two", [MountedRobot(arm_, "left_"), MountedRobot(arm_, "right_", "world", ceiling)])
    for model, group in (
        (dual(), "right_arm"),
        (hung, "right_arm"),
        (arm(dh_rows("UR10"), torso=True), "arm"),
    ):
        ik = ik_solver(model, group)
        assert ik.method == "analytic"
        for _ in range(50):
            reference = random_positions(model, rng)
            target = pose_of(ik, random_positions(model, rng)[ik.columns], reference)
            assert check(ik, target, reference)


@pytest.mark.skipif(not MBM.is_dir(), reason="needs the MotionBenchMaker robots")
def test_a_ur5_whose_urdf_writes_pi_with_ten_digits():
    model, rng = mbm_robot("ur5"), np.random.default_rng(5)
    names = model.joint_names[:6]
    ik = ik_solver(replace(model, groups={"arm": Group("arm", names, ())}), "arm", "ee_link")
    assert ik.method == "analytic"
    for _ in range(100):
        q = random_positions(model, rng)
        assert check(ik, ik.tree.link_pose(q, "ee_link"), q, 1e-6)


def other_arms() -> dict[str, tuple[RobotModel, str]]:
    bent = dh_rows("UR10")
    bent[3] = (bent[3][0], 0.0, np.pi / 2 + 1e-4)  # a calibrated arm: not exactly the structure
    shifted = dh_rows("UR10")
    shifted[3] = (shifted[3][0], 0.02, np.pi / 2)  # axes 4 and 5 pass each other
    skew = dh_rows("UR10")
    skew[1] = (0.0, skew[1][1], 1e-3)
    spherical = [(0.3, 0, np.pi / 2), (0, 0.4, 0), (0, 0, np.pi / 2), (0.4, 0, -np.pi / 2), (0, 0, np.pi / 2),
                 (0.1, 0, 0)]  # fmt: skip
    return {
        "panda": (load_robot("panda"), "arm"),
        "bent": (arm(bent), "arm"),
        "shifted": (arm(shifted), "arm"),
        "skew": (arm(skew), "arm"),
        "spherical": (arm(spherical), "arm"),
        "slide": (arm(dh_rows("UR10"), types="prrrrr"), "arm"),
        "five": (arm(dh_rows("UR10")[:5]), "arm"),
    }


@pytest.mark.parametrize("name", other_arms())
def test_an_arm_built_otherwise_gets_the_numeric_solver(name):
    model, group = other_arms()[name]
    ik = ik_solver(model, group)
    assert isinstance(ik, NumericIK) and ik.method == "numeric"
    with pytest.raises(InputError, match="not built like a UR arm.*ik_solver"):
        AnalyticIK(model, group)
    rng = np.random.default_rng(6)
    for _ in range(20):
        reference = random_positions(model, rng)
        target = pose_of(ik, random_positions(model, rng)[ik.columns], reference)
        result = ik.solve(target, reference)
        assert result.ok and pose_of(ik, result.positions, reference).isclose(target, 1e-6, 1e-6)


# Joint 5 at 0 or pi: axes 4 and 6 parallel. Joint 3 at 0: elbow straight. Both. And C over axis 1's offset.
SINGULAR = {
    "wrist": [0.4, -1.1, 1.3, 0.5, 0.0, 0.7],
    "wrist the other way": [0.4, -1.1, 1.3, 0.5, np.pi, 0.7],
    "elbow": [-0.6, -1.0, 0.0, 0.4, 1.2, 0.3],
    "elbow folded": [-0.6, -1.0, np.pi - 1e-9, 0.4, 1.2, 0.3],
    "all straight": [0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0],
    "wrist and elbow": [1.0, -0.3, 0.0, -0.8, 0.0, 2.0],
}


@pytest.mark.parametrize("name", SINGULAR)
def test_singular_poses_are_solved(name):
    model = load_robot("ur10")
    ik, q, rng = ik_solver(model, "arm"), np.array(SINGULAR[name]), np.random.default_rng(7)
    target = ik.tree.link_pose(q, ik.tip_link)
    found = check(ik, target, q, 1e-6)
    assert apart(found[0], q) < 1e-3  # the square root of rounding, where two branches meet
    for _ in range(50):
        assert check(ik, target, random_positions(model, rng), 1e-6)
        noise = SE3(SO3.exp(rng.normal(size=3) * 1e-9), rng.normal(size=3) * 1e-8)
        check(ik, noise @ target, q, 1e-6)


def test_at_a_free_wrist_joint_6_stays_where_it_is():
    ik = ik_solver(load_robot("ur10"), "arm")
    q = np.array(SINGULAR["wrist"])
    target = ik.tree.link_pose(q, ik.tip_link)
    for value in (-2.0, -0.3, 1.0, 2.5):
        reference = np.r_[q[:5], value]
        result = ik.solve(target, reference)
        assert result.ok and result.positions[5] == pytest.approx(value, abs=1e-9)


def test_the_boundary_of_reach():
    """Along the stretched arm: solved up to the boundary, not beyond; above axis 1: never."""
    model = load_robot("ur10")
    ik = ik_solver(model, "arm")
    q = np.array([0.3, -0.5, 0.0, 0.9, 0.8, 0.2])
    at = ik.tree.link_transforms(q)
    index = ik.tree.link_index
    upper, wrist = at[index["upper_arm_link"], :3, 3], at[index["wrist_1_link"], :3, 3]
    v = at[index["wrist_1_link"], :3, 1]  # axis 4
    along = wrist - upper - v * (v @ (wrist - upper))
    along /= np.linalg.norm(along)
    target = ik.tree.link_pose(q, ik.tip_link)
    for meters, reachable in ((-1e-3, True), (-1e-9, True), (0.0, True), (1e-8, True), (1e-5, False)):
        there = SE3(target.rotation, target.translation + meters * along)
        found = check(ik, there, q, 1e-6)
        near = [s for s in found if apart(s, q) < 0.3]  # the branches on this side
        assert bool(near) == reachable, meters
    # Axes 5 and 6 cross one tool length below the tip: there on axis 1, without their offset from it.
    for turn in (0.0, 1.0, np.pi / 2):
        rotation = SO3.from_rpy((turn, 0.2, 0.3))
        assert not list(ik.solutions(SE3(rotation, [0.0, 0.0, 0.9]) @ SE3.from_xyz(0, 0, 0.0922), q))


def test_limits_and_whole_turns():
    limits = {0: (-0.5, 7.0), 2: (0.0, np.pi), 5: (-4 * np.pi, 4 * np.pi)}
    ik = ik_solver(arm(dh_rows("UR5"), limits=limits), "arm")
    free = ik_solver(arm(dh_rows("UR5")), "arm")
    rng, forbidden = np.random.default_rng(8), 0
    for _ in range(100):
        q = rng.uniform(-np.pi, np.pi, 6)
        reference = random_positions(ik.model, rng)
        target = pose_of(free, q, q)
        found, every = check(ik, target, reference), check(free, target, reference)
        low, high = ik.lower, ik.upper
        for s in every:  # brute force: which have a whole turn within every limit
            turns = s[:, None] + TURN * np.arange(-4, 5)
            inside = (turns >= low[:, None]) & (turns <= high[:, None])
            assert inside.any(axis=1).all() == any(apart(s, o) < 1e-6 for o in found)
            if inside.any(axis=1).all():
                best = np.where(inside, np.abs(turns - reference[:, None]), np.inf).min(axis=1)
                same = next(o for o in found if apart(s, o) < 1e-6)
                np.testing.assert_allclose(np.abs(same - reference), best, atol=1e-6)
            else:
                forbidden += 1
    assert forbidden > 100


def test_every_equivalent_is_given_on_request():
    ik, rng = ik_solver(load_robot("ur10"), "arm"), np.random.default_rng(9)
    model = ik.model
    q = random_positions(model, rng)
    target = ik.tree.link_pose(q, ik.tip_link)
    branches, every = list(ik.solutions(target, q)), list(ik.solutions(target, q, equivalents=True))
    expected = 0
    for s in branches:
        turns = s[:, None] + TURN * np.arange(-2, 3)
        expected += int(
            np.prod(((turns >= model.lower[:, None]) & (turns <= model.upper[:, None])).sum(axis=1))
        )
    assert len(every) == expected >= 32 * len(branches)
    assert len({tuple(np.round(s, 6)) for s in every}) == expected
    for s in every:
        model.check_positions(s)
        assert ik.tree.link_pose(s, ik.tip_link).isclose(target, 1e-9, 1e-9)


def test_solutions_forbidden_by_limits_are_counted():
    ik = ik_solver(arm(dh_rows("UR5"), limits={2: (0.0, 0.1)}), "arm")
    q = np.array([0.3, -1.0, 1.2, 0.4, 1.0, 0.2])
    result = ik.solve(pose_of(ik, q, q), np.zeros(6))
    assert result.code is ErrorCode.NO_IK_SOLUTION
    assert result.evidence["outside_limits"]["j3"] >= 2
    assert "outside limits (j3:" in result.message and "the closest is" in result.message
    assert "j3" in result.evidence["joints_at_limit"]
    assert pose_of(ik, result.positions, q).isclose(result.evidence["closest_pose"], 1e-9, 1e-9)
