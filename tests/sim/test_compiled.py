"""Steps in compiled code are those that Python takes one by one."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sim.helpers import Grasping

from armcell.sim import SimWorld


def _state(world: SimWorld) -> tuple:
    data = world.mj_data
    return (
        data.qpos.tobytes(), data.qvel.tobytes(), data.ctrl.tobytes(), data.qacc_warmstart.tobytes(),
        data.time, world.arm_target().positions.tolist(), world.monitor.unwanted,
    )  # fmt: skip


def _both(act) -> tuple:
    """What an act on a world returns, and the state afterwards: compiled, and in Python."""
    found = []
    for compiled in (True, False):
        grasp = Grasping()
        assert grasp.world._steps is not None and grasp.world._steps.possible
        if not compiled:
            grasp.world._steps = None
        found.append((act(grasp), _state(grasp.world)))
    return tuple(found)


@pytest.mark.parametrize("unwanted", (False, True))
def test_a_grasp_is_the_same_bit_for_bit(unwanted):
    def act(grasp: Grasping):
        if unwanted:
            grasp.world.monitor.forbid("cube", ("panda_leftfinger", "panda_rightfinger"))
        grasp.close(seconds=0.5)
        grasp.lift(seconds=0.2, settle=0.0)
        return grasp.world.gripper_state("hand"), len(grasp.world.monitor.unwanted)

    compiled, python = _both(act)
    assert compiled == python
    assert compiled[0][0].held == "cube" and compiled[0][1] == (2 if unwanted else 0)


@pytest.mark.parametrize("tolerance", (1.0, 2e-4))
def test_following_is_the_same_and_ends_at_the_same_error(tolerance):
    def act(grasp: Grasping):
        names, world = grasp.arm, grasp.world
        start = world.joint_state().reindexed(names).positions

        def wanted(times):
            t = np.array(times)[:, None]
            return start + 0.5 * t**2, np.repeat(t, len(names), axis=1)

        return world.follow(names, wanted, 0.4, 2, tolerance)

    compiled, python = _both(act)
    assert compiled == python
    assert (compiled[1][4] < 0.39) == (tolerance < 1.0) and compiled[0][0] > 2e-4


def test_links_that_come_to_touch_are_seen_as_by_the_engine_alone():
    """The hand folds against the forearm, and then goes into the table."""

    def act(grasp: Grasping):
        names, world = grasp.arm, grasp.world
        apart = []
        for joints in ([0, -0.5, 0, -2.0, 0, 0.0, 2.6], [0, 0.9, 0, -1.6, 0, 2.5, 0]):
            start, end = world.arm_target().reindexed(names).positions, np.array(joints)
            for k in range(100):
                world.set_arm_target(names, start + (end - start) * min((k + 1) / 80, 1.0))
                world.step(10)
            apart.append({frozenset((c.body_a, c.body_b)) for c in world.monitor.unwanted})
        return apart

    compiled, python = _both(act)
    assert compiled == python
    folded, pressed = compiled[0]
    assert frozenset(("panda_link5", "panda_link7")) in folded
    assert any("table" in pair for pair in pressed - folded)


def test_what_is_far_apart_is_not_compared_until_it_may_be_near():
    world = Grasping().world
    apart = world._steps._apart
    links, *_, affinity, _ = apart.arrays
    world.step(1)
    aside = affinity.copy()
    world.step(300)  # at rest: nothing changes
    assert len(links) > 5 and (aside != affinity.max()).any() and (affinity == aside).all()
    world.set_positions(world.joint_state().positions)
    assert len(set(affinity[affinity != 1].tolist())) == 1  # all are looked at again
