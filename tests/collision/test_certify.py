"""Proofs of motions, by the exact checker and by the kernel: what they call free is free everywhere between
the waypoints, however thin the obstacle.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from tests.collision.test_against_brute_force import random_objects
from tests.model.helpers import dual, random_positions
from tests.scene.helpers import box, floating, panda, ur10
from tests.sizes import sizes

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, Sphere
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

PROVERS = (ExactChecker, KernelChecker)
each_prover = pytest.mark.parametrize("prover", PROVERS)
PIECES = 0.03  # [m] by which the kernel's convex pieces may reach beyond a mesh that is not convex
STEP = 0.002  # [rad] of the independent sampling


def densely(waypoints: np.ndarray, step: float = STEP):
    """Configurations along the straight edges, at most `step` apart in any joint."""
    yield waypoints[0]
    for a, b in itertools.pairwise(waypoints):
        n = max(int(np.ceil(np.max(np.abs(b - a)) / step)), 1)
        yield from (a + (b - a) * k / n for k in range(1, n + 1))


def check_soundness(
    prover, scene: PlanningScene, rng: np.random.Generator, paths: int, reach: float, names=None
):
    """Random paths from free places; returns how many were proven and how many refuted."""
    model = scene.model
    checker, judge = prover(scene, names), ExactChecker(scene, names)
    columns, free, not_free = checker.columns, 0, 0
    for _ in range(1000):
        if free + not_free == paths:
            break
        start = random_positions(model, rng)[columns]
        if not judge.is_free(start):
            continue
        ways = start + np.vstack(
            [np.zeros(len(start)), np.cumsum(rng.uniform(-reach, reach, (2, len(start))), 0)]
        )
        ways = np.clip(ways, model.lower[columns], model.upper[columns])
        certificate = checker.certify(ways)
        if certificate.free:
            free += 1
            assert certificate.contact is None
            for q in densely(ways):
                assert judge.is_free(q), (ways.tolist(), judge.contacts(q))
        else:
            not_free += 1
            check_refutation(judge, ways, certificate, 1e-3 if prover is ExactChecker else PIECES)
    return free, not_free


def check_refutation(judge: ExactChecker, ways: np.ndarray, certificate, near: float) -> None:
    """It touches somewhere, or nearly does."""
    assert 0.0 <= certificate.at <= 1.0
    assert any(judge.nearest(q, cutoff=near) is not None for q in densely(ways)), ways.tolist()


@pytest.mark.slow
@pytest.mark.cases("*-KernelChecker", "panda-0.25-ExactChecker")
@each_prover
@pytest.mark.parametrize(("robot", "reach"), [("panda", 0.25), ("ur10_gripper", 0.25), ("panda", 1.5)])
def test_random_motions_among_random_obstacles(prover, robot, reach):
    rng, model = np.random.default_rng(0), load_robot(robot)
    free = not_free = 0
    for _ in range(3):
        scene = PlanningScene.of(model, objects=random_objects(rng))
        found = check_soundness(prover, scene, rng, 4, reach)
        free, not_free = free + found[0], not_free + found[1]
    assert free + not_free >= 8 and not_free > 0
    assert free > 0 or reach > 1.0


@pytest.mark.slow
@pytest.mark.cases("few-*-panda-*")
@each_prover
@pytest.mark.parametrize("robot", ["panda", "ur10_gripper"])
@pytest.mark.parametrize("reach", [0.1, 0.4, 1.5])
@pytest.mark.parametrize(("scenes", "paths"), sizes((1, 3), (8, 10)))
def test_random_motions_with_a_held_box(prover, robot, reach, scenes, paths):
    rng, model = np.random.default_rng(1), load_robot(robot)
    for _ in range(min(scenes, 2) if prover is KernelChecker else scenes):  # the kernel prepares for seconds
        scene = PlanningScene.of(model, objects=random_objects(rng)).with_attached(
            "Box0", model.gripper().tcp_link
        )
        check_soundness(prover, scene, rng, paths, reach, model.group("arm").joint_names)


@pytest.mark.slow
@pytest.mark.cases("KernelChecker")
@each_prover
def test_two_arms(prover):
    free, not_free = check_soundness(prover, PlanningScene.of(dual()), np.random.default_rng(2), 20, 0.4)
    assert free and not_free


def swing(prover, plate: CollisionObject | None, turn: float = 1.5):
    """The UR10 swings its stretched arm about the base, by `turn` to both sides of x."""
    scene = ur10(*([plate] if plate else []))
    checker = prover(scene, scene.model.group("arm").joint_names)
    end = np.array([turn, -0.1, 0.0, 0.0, 0.0, 0.0])
    return checker, np.vstack([end * (-1, 1, 1, 1, 1, 1), end])


@pytest.mark.slow
@each_prover
@pytest.mark.parametrize("thickness", [1e-3, 1e-4])
@pytest.mark.parametrize("turn", [0.5, 1.5, 1.5707])
def test_a_thin_plate_between_far_ends_is_found(prover, thickness, turn):
    plate = box("plate", (0.3, thickness, 0.3), (1.0, 0.05, 0.3))
    checker, ways = swing(prover, plate, turn)
    assert checker.is_free(ways[0]) and checker.is_free(ways[1])
    certificate = checker.certify(ways)
    assert not certificate.free and "plate" in (certificate.contact.body_a, certificate.contact.body_b)
    checker, ways = swing(prover, None, turn)
    assert checker.certify(ways).free


@pytest.mark.slow
@pytest.mark.cases("KernelChecker")
@each_prover
def test_a_bead_is_found(prover):
    checker, ways = swing(prover, CollisionObject.single("bead", Sphere(1e-3), SE3.from_xyz(0.9, 0.01, 0.22)))
    judge = ExactChecker(checker.scene, checker.joint_names)
    assert any(not judge.is_free(q) for q in densely(ways, 2e-4))
    assert not checker.certify(ways).free


@pytest.mark.parametrize("prover", [ExactChecker, KernelChecker])
def test_the_fraction_and_the_contact_say_where(prover):
    """The cube on its slide goes from -1 to 1.5 by way of 0; the wall's face is at 1, contact at 0.9."""
    checker = prover(floating(box("wall", (0.2, 1, 1), (1.1, 0, 0))))
    for ways, touch in (([[-1.0], [0.0], [1.5]], (1 + 0.9 / 1.5) / 2), ([[0.0], [0.95]], 0.9 / 0.95)):
        certificate = checker.certify(ways)
        assert not certificate.free and certificate.at >= touch - 1e-3
        assert certificate.contact.distance <= 1e-3
    certificate = checker.certify([[0.0], [0.85]])
    assert certificate.free and certificate.at == 1.0 and certificate.contact is None


@each_prover
def test_slack_is_room_on_both_sides(prover):
    checker = prover(floating(box("wall", (0.2, 1, 1), (1.1, 0, 0))))
    ways = [[0.0], [0.85]]  # 0.05 m stay
    assert checker.certify(ways, [0.049]).free
    assert not checker.certify(ways, [0.051]).free


@each_prover
def test_one_waypoint_is_a_path(prover):
    checker = prover(floating(box("wall", (0.2, 1, 1), (1.1, 0, 0))))
    assert checker.certify([[0.5]]).free
    assert not checker.certify([[1.0]]).free


@each_prover
def test_touching_at_the_start_is_told(prover):
    scene = panda(box("block", (0.2, 0.2, 0.2), (0.35, 0.0, 0.6)))
    checker = prover(scene, scene.model.group("arm").joint_names)
    home = scene.positions[:7]
    certificate = checker.certify([home, home + 0.1])
    assert not certificate.free and "block" in (certificate.contact.body_a, certificate.contact.body_b)


@pytest.mark.parametrize("prover", [ExactChecker, KernelChecker])
def test_fingers_that_close_on_a_thing_between_them_are_seen(prover):
    """Both fingers follow one joint and move against each other; the thing is held by one of them."""
    bare = panda()
    at = bare.frame_pose("panda_hand_tcp") @ SE3.from_xyz(0.0, 0.015, 0.0)
    thing = CollisionObject.single("thing", Sphere(0.02), at)
    scene = panda(thing).with_attached("thing", "panda_leftfinger", ["panda_hand"])
    judge, checker = (make(scene, ("panda_finger_joint1",)) for make in (ExactChecker, prover))
    assert not judge.contacts([0.04]) and judge.contacts([0.0])
    assert not checker.is_free([0.0])
    assert not checker.certify([[0.04], [0.0]]).free
