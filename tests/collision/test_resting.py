"""The rule for motions that begin in resting contact: by hand, and against dense samples of coal."""

from __future__ import annotations

import numpy as np
import pytest
from tests.collision.test_certify import densely
from tests.model.helpers import collision, joint, link, model_of
from tests.scene.helpers import box, panda
from tests.sizes import seeds

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import (
    APART,
    DEEPER,
    DRAG,
    RESTING,
    certify_from_rest,
    clearance_from_rest,
    resting_contacts,
    resting_pairs,
    separation,
)
from armcell.scene import CollisionObject, PlanningScene

LIMIT = '<limit lower="-2" upper="2" velocity="1" effort="1"/>'
SINK = 3e-4  # [m] as physics lets things sink in
UP, DOWN, ALONG = np.eye(3)[2], -np.eye(3)[2], np.eye(3)[0]


def gantry(*objects: CollisionObject, sink: float = SINK) -> PlanningScene:
    """A 0.2 m cube on slides along x, y and z, which stands on a table `sink` [m] deep."""
    model = model_of(
        link("base"), link("a"), link("b"), link("cube", collision('<box size="0.2 0.2 0.2"/>')),
        joint("x", "base", "a", "prismatic", f'<axis xyz="1 0 0"/>{LIMIT}'),
        joint("y", "a", "b", "prismatic", f'<axis xyz="0 1 0"/>{LIMIT}'),
        joint("z", "b", "cube", "prismatic", f'<axis xyz="0 0 1"/>{LIMIT}'),
    )  # fmt: skip
    table = box("table", (3.0, 3.0, 0.1), (0.0, 0.0, -0.15 + sink))
    return PlanningScene.of(model, objects=(table, *objects))


def motion(*steps) -> np.ndarray:
    return np.vstack([np.zeros(3), np.cumsum(np.array(steps, dtype=float), axis=0)])


def proof(scene: PlanningScene, points: np.ndarray, slack=None):
    return certify_from_rest(KernelChecker(scene), points, slack)


@pytest.mark.parametrize("sink", [0.0, SINK, 0.9 * RESTING])
@pytest.mark.parametrize("slack", [None, np.full(3, 5e-4)])
def test_a_motion_may_lead_out_and_on(sink, slack):
    scene = gantry(sink=sink)
    assert not KernelChecker(scene).certify(motion(0.1 * UP)).free  # without the rule it may not begin
    for points in (
        motion(0.1 * UP),
        motion(0.01 * UP, 0.5 * ALONG),
        motion(0.05 * (UP + ALONG), 0.3 * ALONG),
    ):
        assert proof(scene, points, slack).free


@pytest.mark.parametrize(
    "steps",
    [(0.01 * DOWN,), (0.1 * ALONG,), (0.01 * ALONG, 0.1 * UP), (0.02 * UP, 0.1 * ALONG, 0.021 * DOWN)],
    ids=["deeper", "along", "along, then up", "up and back"],
)
def test_a_motion_that_goes_deeper_drags_or_comes_back_is_refused(steps):
    found = proof(gantry(), motion(*steps))
    assert not found.free
    assert {found.contact.body_a, found.contact.body_b} == {"cube", "table"}
    assert 0.0 < found.at <= 1.0


def test_where_it_is_refused():
    scene = gantry()
    dragged = proof(scene, motion(0.1 * ALONG))
    assert DRAG < 0.1 * dragged.at < 2 * DRAG + 2 * SINK
    pressed = proof(scene, motion(0.01 * DOWN))
    assert DEEPER - 1e-9 <= 0.01 * pressed.at <= DEEPER + 3e-4
    back = proof(scene, motion(0.02 * UP, 0.1 * ALONG, 0.04 * DOWN))
    assert 2.4 / 3 < back.at <= 1.0
    assert -1e-3 < back.contact.distance < 2e-3


def test_a_start_that_is_too_deep_is_refused_at_once():
    found = proof(gantry(sink=1.2 * RESTING), motion(0.1 * UP))
    assert not found.free and found.at == 0.0
    assert found.contact.distance == pytest.approx(-1.2 * RESTING)
    checker = KernelChecker(gantry(sink=1.2 * RESTING))
    assert certify_from_rest(checker, motion(0.1 * UP), deepest=2 * RESTING).free


def test_a_motion_that_ends_in_its_contact_is_refused():
    scene = gantry()
    assert not proof(scene, motion(0.5 * SINK * UP)).free
    assert proof(scene, motion(2.0 * SINK * UP)).free  # apart, though by little
    assert not proof(scene, np.zeros((1, 3))).free


def test_everything_else_is_proven_as_ever():
    """A foil across the way, far thinner than the steps of any samples; another body beside the way out."""
    foil = box("foil", (3.0, 3.0, 1e-5), (0.0, 0.0, 0.3))
    found = proof(gantry(foil), motion(0.5 * UP))
    assert not found.free and "foil" in (found.contact.body_a, found.contact.body_b)
    assert 0.2 - 1e-3 <= 0.5 * found.at <= 0.4 + 1e-3  # where it touches; a proof does not go front to end
    shelf = box("shelf", (3.0, 3.0, 0.01), (0.0, 0.0, 0.1005 + 0.005))
    found = proof(gantry(shelf), motion(0.1 * UP))
    assert not found.free and "shelf" in (found.contact.body_a, found.contact.body_b)


@pytest.mark.parametrize("gap", [1e-4, 5e-4, 1.5e-3])
def test_what_is_near_but_does_not_touch_may_not_be_touched(gap):
    """Only what touched at the start is excepted, however near another body is."""
    wall = box("wall", (0.1, 3.0, 3.0), (0.15 + gap, 0.0, 1.0))
    scene = gantry(wall)
    assert proof(scene, motion(0.1 * UP)).free
    into = proof(scene, motion(np.array([2 * gap, 0.0, 0.1])))
    assert not into.free and "wall" in (into.contact.body_a, into.contact.body_b)


@pytest.mark.parametrize("gap", [1e-4, 5e-4, 1.5e-3])
def test_a_start_within_the_slack_of_something_may_leave_it(gap):
    """Without touching it: what the slack leaves unproven is proven without slack, until they are apart."""
    checker, slack = KernelChecker(gantry(sink=-gap)), np.full(3, 2e-3)
    assert not checker.certify(motion(0.1 * UP), slack).free
    assert certify_from_rest(checker, motion(0.1 * UP), slack).free
    assert not certify_from_rest(checker, motion(0.1 * UP, 0.1 * DOWN), slack).free
    along = certify_from_rest(checker, motion(0.5 * ALONG), slack)  # it stays within the slack
    assert not along.free and "table" in (along.contact.body_a, along.contact.body_b)
    assert not certify_from_rest(checker, motion(0.1 * DOWN), slack).free


def test_two_contacts_are_left_at_once():
    """In a corner: out of it, but not along one of its walls."""
    corner = gantry(box("wall", (0.1, 3.0, 3.0), (0.15 - SINK, 0.0, 0.0)))
    assert {frozenset(p) for p in resting_pairs(KernelChecker(corner).exact, np.zeros(3))} == {
        frozenset(("cube", "table")), frozenset(("cube", "wall"))
    }  # fmt: skip
    assert proof(corner, motion(0.02 * (UP - ALONG), 0.3 * UP)).free
    up = proof(corner, motion(0.3 * UP))
    assert not up.free and "wall" in (up.contact.body_a, up.contact.body_b)


def test_a_body_of_several_parts_is_left_part_by_part():
    """A tray is one body: who stands on its floor may not be driven into its rim."""
    parts = [
        box("floor", (3.0, 3.0, 0.1), (0.0, 0.0, -0.15 + SINK)),
        box("rim", (0.1, 3.0, 0.3), (0.25, 0, 0)),
    ]
    tray = CollisionObject("tray", tuple((p.shapes[0][0], p.T_world_object) for p in parts))
    scene = gantry().without_object("table").with_object(tray)
    assert proof(scene, motion(0.3 * UP, 0.5 * ALONG)).free
    found = proof(scene, motion(np.array([0.2, 0.0, 0.05])))
    assert not found.free and "tray" in (found.contact.body_a, found.contact.body_b)


def test_separation_says_where():
    scene = gantry()
    exact = ExactChecker(scene)
    at, contact = separation(exact, motion(0.1 * UP), resting_pairs(exact, np.zeros(3)))
    assert contact is None and APART + SINK <= 0.1 * at <= 2 * (APART + SINK)


def test_the_contact_at_the_start_is_named_even_where_coal_calls_it_none():
    checker = KernelChecker(gantry(sink=-1e-6))
    assert checker.touches(np.zeros(3)) and not checker.exact.contacts(np.zeros(3), padded=False)
    (contact,) = resting_contacts(checker, np.zeros(3))
    assert {contact.body_a, contact.body_b} == {"cube", "table"}
    assert not resting_contacts(KernelChecker(gantry(sink=-1e-3)), np.zeros(3))


def test_clearance_counts_the_pair_from_where_it_no_longer_moves_apart():
    checker = KernelChecker(gantry(box("shelf", (3.0, 3.0, 0.01), (0.0, 0.0, 0.3))))
    leaves = clearance_from_rest(checker, motion(0.1 * UP))
    assert leaves == pytest.approx(0.095, abs=1e-3)  # to the shelf
    slides = clearance_from_rest(checker, motion((0.01 + SINK) * UP, 0.5 * ALONG))
    assert slides == pytest.approx(0.01, abs=1e-3)  # to the table
    assert clearance_from_rest(checker, motion(0.1 * ALONG)) == 0.0


# --- properties ---
@pytest.mark.slow
@pytest.mark.cases("0")
@pytest.mark.parametrize("seed", seeds(3, range(6)))
def test_what_is_proven_keeps_the_rule_at_dense_samples(seed):
    """Random motions of a gantry among boxes, judged by coal; both verdicts have to occur."""
    rng = np.random.default_rng(seed)
    verdicts = []
    for _ in range(60):
        blocks = [
            box(f"block{k}", rng.uniform(0.02, 0.2, 3), rng.uniform((-0.4, -0.4, 0.1), (0.4, 0.4, 0.9)),
                rng.uniform(-3, 3, 3))
            for k in range(3)
        ]  # fmt: skip
        sink = rng.choice([0.0, 1e-4, 5e-4, 1.5e-3])
        scene = gantry(*blocks, sink=sink)
        first = rng.uniform(-1, 1, 3) * 0.02 + rng.choice([0.0, 0.01]) * UP
        points = motion(first, rng.uniform(-0.3, 0.3, 3), rng.uniform(-0.3, 0.3, 3))
        slack = None if rng.random() < 0.5 else np.full(3, 2e-4)
        found = proof(scene, points, slack)
        verdicts.append(found.free)
        judged = keeps_rule(scene, points)
        if found.free:
            assert judged is None, judged
        else:
            assert found.contact is not None and 0.0 <= found.at <= 1.0
    assert any(verdicts) and not all(verdicts)


def keeps_rule(scene: PlanningScene, points: np.ndarray, names=None, step: float = 5e-4) -> str | None:
    """What breaks the rule at dense samples of a motion (k, n), or None."""
    exact = ExactChecker(scene, names)

    def distances(q) -> np.ndarray:
        exact.set_configuration(q)
        out = exact.pair_gaps(exact.pairs)
        for k in np.flatnonzero(out < 0.01):
            out[k] = exact.pair_distance(*map(int, exact.pairs[k]))
        return out

    first = distances(points[0])
    rests, parted = first <= 1e-5, first > 1e-5
    now = first
    for q in densely(points, step):
        now = distances(q)
        for k in np.flatnonzero(now <= 0.0):
            pair = [exact.geometries[i].body for i in exact.pairs[k]]
            if parted[k]:
                return f"{pair} touch again or anew: {now[k]}"
            if now[k] < min(first[k], 0.0) - DEEPER - 1e-4:
                return f"{pair} get deeper: {first[k]} to {now[k]}"
        parted |= now > APART + DEEPER
    if np.any(now[rests] <= 0.0):
        return "a pair touches at the end"
    return None


def test_a_finger_on_a_plate_comes_off_it():
    """A mesh in contact: straight off the plate is free, along it is not."""
    tip = panda().frame_pose("panda_hand_tcp").translation
    scene = panda(box("plate", (0.3, 0.3, 0.02), (tip[0], tip[1], tip[2] - 0.0095 - 0.01 + SINK)))
    names = scene.model.group("arm").joint_names
    checker = KernelChecker(scene, names)
    start = scene.positions[checker.columns]
    pairs = {frozenset((c.body_a, c.body_b)) for c in resting_contacts(checker, start)}
    assert pairs == {frozenset(("plate", f"panda_{side}finger")) for side in ("left", "right")}
    turned = start + 0.3 * np.eye(7)[0]
    lifted = start - 0.1 * np.eye(7)[1]
    assert certify_from_rest(checker, [start, lifted]).free
    assert keeps_rule(scene, np.array([start, lifted]), names) is None
    assert not certify_from_rest(checker, [start, turned]).free
    assert certify_from_rest(checker, [start, lifted, lifted + turned - start]).free
