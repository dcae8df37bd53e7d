"""Where a motion first touches something: against states sampled densely and asked one by one."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.cell import load
from armcell.collision import ExactChecker
from armcell.collision.motion_proof import ActiveMotion, conflict_at_any_pace, elapsed_at, first_conflict
from armcell.core import SE3, Box, JointState, JointTrajectory
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

ROBOT = load_robot("panda")
NAMES = ROBOT.group("arm").joint_names
LEFT, RIGHT = (np.array([turn, 0.3, 0.0, -1.9, 0.0, 2.2, 0.8]) for turn in (1.2, -0.6))
ROD = CollisionObject.single("rod", Box(0.06, 0.06, 0.5), SE3.from_xyz(0.55, 0.1, 0.6))
SCENE = PlanningScene.of(ROBOT, objects=[ROD]).with_state(JointState(NAMES, LEFT))


def motion(kind: str, start: np.ndarray = LEFT, end: np.ndarray = RIGHT) -> JointTrajectory:
    """3 s from one side to the other: only positions, as a bare message has them, or a quintic."""
    if kind == "linear":
        return JointTrajectory(NAMES, np.array([0.0, 3.0]), np.array([start, end]))
    rest = np.zeros((2, 7))
    return JointTrajectory(NAMES, np.array([0.0, 3.0]), np.array([start, end]), rest, rest)


def at(trajectory: JointTrajectory, passed: float) -> PlanningScene:
    """The scene with the robot where it is on its way."""
    return SCENE.with_state(JointState(NAMES, trajectory.sample(passed)[0]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["linear", "quintic"])
def test_the_first_contact_is_where_sampling_finds_it(kind):
    way, exact = motion(kind), ExactChecker(SCENE, NAMES)
    times = np.linspace(0.0, 3.0, 3001)
    touching = times[[not exact.is_free(way.sample(t)[0]) for t in times]]
    found = first_conflict(SCENE, ActiveMotion(way))
    assert found is not None and found.contact is not None and not found.at_start
    assert found.time == pytest.approx(touching[0], abs=0.02)
    assert "rod" in (found.contact.body_a, found.contact.body_b)
    past = float(touching[-1]) + 0.02
    assert first_conflict(at(way, past), ActiveMotion(way, past)) is None
    assert first_conflict(at(way, 3.0), ActiveMotion(way, 3.0)) is None
    allowed = SCENE.with_allowed("rod", list(ROBOT.links))
    assert first_conflict(allowed, ActiveMotion(way)) is None


def test_a_start_deep_in_contact_is_reported_as_such():
    way, exact = motion("quintic"), ExactChecker(SCENE, NAMES)
    inside = next(t for t in np.linspace(0.0, 3.0, 301) if exact.contacts(way.sample(t)[0]) and
                  exact.contacts(way.sample(t)[0])[0].distance < -0.01)  # fmt: skip
    found = first_conflict(at(way, inside), ActiveMotion(way, inside))
    assert found is not None and found.at_start and found.time == pytest.approx(inside, abs=1e-6)


def test_the_gap_between_the_measured_and_the_commanded_start_is_proven_too():
    """The controller drives there first: a thin plate in the gap is touched though the motion is free."""
    start = LEFT + 0.01
    way = motion("quintic", start, start + 0.2 * np.eye(7)[0])
    tip = SCENE.with_state(JointState(NAMES, start)).frame_pose("panda_hand_tcp")
    here = SCENE.frame_pose("panda_hand_tcp")
    assert tip.distance_to(here)[0] > 2e-3
    gap = (tip.translation + here.translation) / 2
    speck = CollisionObject.single("speck", Box(1e-3, 1e-3, 1e-3), SE3.from_xyz(*gap))
    scene = SCENE.without_object("rod").with_object(speck)
    exact = ExactChecker(scene, NAMES)
    if exact.is_free(LEFT) and exact.is_free(start):
        assert first_conflict(scene, ActiveMotion(way)) is not None


def test_what_fades_out_of_an_earlier_motion_is_proven_too():
    way = motion("quintic", RIGHT, RIGHT + 0.05)
    scene = SCENE.with_state(JointState(NAMES, RIGHT))
    assert first_conflict(scene, ActiveMotion(way)) is None
    gap, still = LEFT - RIGHT, np.zeros((2, 7))
    blend = JointTrajectory(NAMES, np.array([0.0, 1.0]), np.array([gap, 0 * gap]), still, still)
    found = first_conflict(SCENE, ActiveMotion(way, 0.0, blend))  # from the other side, past the rod
    assert found is not None and found.contact is not None and found.time < 1.0


def test_a_slowed_robot_is_found_on_its_way():
    way = motion("quintic")
    for passed in (0.4, 1.0, 2.2):
        q = way.sample(passed)[0] + 0.001
        assert passed - 0.06 <= elapsed_at(way, q, most=2.9) <= passed + 0.02
    assert elapsed_at(way, way.sample(2.0)[0], most=1.0) == pytest.approx(1.0)  # no farther than it can be
    assert elapsed_at(way, LEFT, most=3.0) == 0.0


# --- two arms ---
@pytest.fixture(scope="module")
def pair():
    """The cell with both arms' motions over the middle of the table, 1 s each, the right one from home."""
    scene = load("dual_ur10").scene().with_padding(0.0)  # which the proof leaves out
    motions = {}
    for group, side in (("left_arm", 1.0), ("right_arm", 1.0)):
        names = scene.model.group(group).joint_names
        q = scene.state.reindexed(names).positions
        goal = q + side * np.array([0.0, 0.7, 0.3, 0.0, 0.0, 0.0])
        rest = np.zeros((2, len(q)))
        motions[group] = JointTrajectory(names, np.array([0.0, 1.0]), np.array([q, goal]), rest, rest)
    return scene, motions["left_arm"], motions["right_arm"]


def touching(
    scene: PlanningScene, first: JointTrajectory, second: JointTrajectory, late: float = 0.0
) -> bool:
    """Whether coal finds a contact of two motions sampled densely."""
    names = (*first.joint_names, *second.joint_names)
    exact = ExactChecker(scene, names)
    times = np.linspace(0.0, max(first.duration, second.duration) + abs(late), 200)
    return any(
        not exact.is_free(np.concatenate([first.sample(t)[0], second.sample(t - late)[0]])) for t in times
    )


@pytest.mark.slow
def test_motions_beside_each_other_agree_with_coal(pair):
    scene, left, right = pair
    rng = np.random.default_rng(0)
    model, seen = scene.model, set()
    for _ in range(12):
        motions = []
        for way in (left, right):
            columns = model.columns(way.joint_names)
            goal = np.clip(
                way.positions[0] + rng.uniform(-1.2, 1.2, 6), model.lower[columns], model.upper[columns]
            )
            rest = np.zeros((2, 6))
            motions.append(
                JointTrajectory(
                    way.joint_names, np.array([0.0, 1.0]), np.array([way.positions[0], goal]), rest, rest
                )
            )
        found = first_conflict(scene, ActiveMotion(motions[0]), [ActiveMotion(motions[1])])
        seen.add(found is None)
        if found is None:
            assert not touching(scene, *motions)
        elif found.contact is not None and found.contact.distance < -1e-3:
            assert touching(scene, *motions)
    assert seen == {True, False}


@pytest.mark.slow
def test_an_arm_that_rests_is_in_the_way(pair):
    """Random rests of the right arm: the left one's motion is free beside it as coal says."""
    scene, left, right = pair
    rng, columns, seen = np.random.default_rng(1), scene.model.columns(right.joint_names), set()
    for _ in range(40):
        q = rng.uniform(
            np.maximum(scene.model.lower[columns], -2.5), np.minimum(scene.model.upper[columns], 2.5)
        )
        rest = JointState(right.joint_names, q)
        standing = scene.with_state(rest)
        stays = JointTrajectory(right.joint_names, np.array([0.0, 1.0]), np.array([q, q]))
        own = first_conflict(scene, ActiveMotion(left)) is None
        found = first_conflict(standing, ActiveMotion(left))
        if not own:
            continue
        pairs = found is not None and found.contact is not None
        assert (found is None) == (not _meet(standing, left, stays)) or (
            pairs and found.contact.distance > -1e-3
        )
        seen.add(found is None)
    assert True in seen


def _meet(scene: PlanningScene, left: JointTrajectory, stays: JointTrajectory) -> bool:
    """Whether what the left arm moves touches anything."""
    exact = ExactChecker(scene.with_state(stays.end), left.joint_names)
    return any(not exact.is_free(left.sample(t)[0]) for t in np.linspace(0.0, 1.0, 200))


def test_a_shift_in_time_counts(pair):
    """What is free whatever the shift is free in step; not the other way round."""
    scene, left, right = pair
    shifted = first_conflict(scene, ActiveMotion(left), [ActiveMotion(right)], shift=0.2)
    if shifted is None:
        assert first_conflict(scene, ActiveMotion(left), [ActiveMotion(right)]) is None
        assert not any(touching(scene, left, right, s) for s in (0.0, 0.2, -0.2))


def test_at_any_pace_every_pair_of_positions_counts(pair):
    scene, left, right = pair
    if not conflict_at_any_pace(scene, ActiveMotion(left), ActiveMotion(right)):
        assert first_conflict(scene, ActiveMotion(left), [ActiveMotion(right)], shift=0.5) is None
    partial = JointTrajectory(left.joint_names[:2], left.times, left.positions[:, :2])
    conflict_at_any_pace(scene, ActiveMotion(partial), ActiveMotion(right))  # joints that are not named stay
    both = JointTrajectory(
        (*left.joint_names, *right.joint_names), left.times, np.hstack([left.positions, right.positions])
    )
    assert conflict_at_any_pace(
        scene, ActiveMotion(both), ActiveMotion(right)
    )  # they are not two arms: no proof
