"""Gap tables: lower bounds of the gap between robot bodies, and what the kernel makes of them."""

import numpy as np
import pytest

from armcell import PlanningScene, load_robot
from armcell.collision.exact_checker import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.gap_tables import CELLS, NEVER, JointRanges, gap_table, grid

TURN = JointRanges(
    np.array([-np.pi, -0.4]), np.array([np.pi, 0.4]), np.array([True, False]), np.array([0.1, 0.05])
)


def wavy(q):
    """A gap that changes by at most 0.1 m per radian of the first and 0.05 m of the second joint."""
    return 0.012 + 0.01 * np.sin(10 * q[0]) + 0.05 * q[1]


def test_every_bound_is_below_the_gap_in_its_cell():
    table = gap_table(wavy, TURN, 0.02)
    numbers, rng = grid(TURN, table.shape), np.random.default_rng(1)
    assert max(table.shape) <= CELLS and table.max() > 0
    for q in rng.uniform(TURN.lower, TURN.upper, (5000, 2)):
        a, b = ((q - numbers[[0, 3]]) * numbers[[1, 4]]).astype(int)
        assert table[a, b] <= wavy(q)
    assert numbers[2] == table.shape[0] and numbers[5] == np.float32(NEVER)


@pytest.mark.parametrize("gap", [lambda q: 0.1, lambda q: -0.01])
def test_bodies_that_are_apart_or_in_contact_nearly_always_have_no_table(gap):
    assert gap_table(gap, TURN, 0.02).size == 0


def test_a_joint_that_needs_too_many_states_has_no_table():
    far = TURN._replace(reach=np.array([50.0, 50.0]))
    assert gap_table(lambda q: 0.01, far, 0.02).size == 0


@pytest.fixture(scope="module")
def ur():
    scene = PlanningScene.of(load_robot("ur5"))
    return scene, KernelChecker(scene, scene.model.group("arm").joint_names)


def test_the_wrist_beside_a_ur_s_forearm_has_a_table(ur):
    checker = ur[1]
    tables = [p for p, row in enumerate(checker.pack.gap_table) if row[0] >= 0]
    names = [{checker.names.bodies[b] for b in checker.pack.pairs[p]} for p in tables]
    assert {"forearm_link", "wrist_2_link"} in names
    assert checker.pack.gaps.max() > 0.005


def test_states_with_a_folded_wrist_are_right(ur):
    """Random states whose wrist is near or in the forearm: what the kernel calls free, the exact checker
    does too, also in another turn of the joint.
    """
    scene, checker = ur
    exact = ExactChecker(scene, checker.joint_names)
    rng, touching, free = np.random.default_rng(3), 0, 0
    low, high = scene.model.lower[checker.columns], scene.model.upper[checker.columns]
    for q in rng.uniform(low, high, (3000, 6)):
        q[3] = rng.choice([0.0, 2 * np.pi]) + rng.uniform(0.8, 2.4) - (np.pi if q[3] < 0 else 0.0)
        q = np.clip(q, low, high)
        if checker.is_free(q):
            assert exact.is_free(q)
            free += 1
        else:
            touching += not exact.is_free(q)
    assert free > 500 and touching > 50


def test_proofs_with_a_table_hold_at_every_sample(ur):
    """Edges that the kernel proves free are free for the exact checker every 2 mrad."""
    scene, checker = ur
    exact, rng, proven = ExactChecker(scene, checker.joint_names), np.random.default_rng(5), 0
    for _ in range(150):
        a = scene.positions[checker.columns] + rng.normal(0, 0.3, 6)
        b = a + np.array([0, 0, 0, rng.uniform(-2.5, 2.5), rng.uniform(-2, 2), 0])
        if not checker.certify([a, b], evidence=False).free:
            continue
        proven += 1
        for t in np.linspace(0, 1, int(np.abs(b - a).max() / 0.02) + 2):
            assert exact.is_free(a + t * (b - a))
    assert proven > 20
