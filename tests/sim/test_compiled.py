"""Steps in compiled code are those that Python takes one by one."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sim.helpers import Grasping

from armcell.core import SE3
from armcell.sim import JointTargets, SimWorld


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
        assert grasp.world._stepper.compiled is not None and grasp.world._stepper.compiled.possible
        if not compiled:
            grasp.world._stepper.compiled = None
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
            t = times[:, None]
            return start + 0.5 * t**2, np.repeat(t, len(names), axis=1)

        return world.follow(names, JointTargets(wanted, world.timestep, 2), 0.4, tolerance)

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
    model = world.mj_model
    solid = model.body_contype > 0
    world.step(1)
    aside, sorted_in = model.geom_conaffinity.copy(), model.body_contype.copy()
    world.step(300)  # at rest: nothing changes
    assert (model.geom_conaffinity == aside).all() and (model.body_contype == sorted_in).all()
    assert len(set(aside.tolist())) > 5 and (sorted_in[solid] == 0).sum() > 3
    world.set_object_pose("cube", SE3.from_xyz(0.9, 0.4, 0.02))  # into the table
    assert {c.body_a for c in world.contacts()} | {c.body_b for c in world.contacts()} == {"cube", "table"}
    world.step(1)
    world.set_positions(world.joint_state().positions)  # all are looked at again
    assert len(set(model.geom_conaffinity.tolist())) == 1 and (model.body_contype[solid] > 0).all()


def test_an_object_that_is_thrown_and_turns_is_seen_as_by_the_engine_alone():
    """The cube falls past the hand onto the table, turning, and comes to rest."""

    def act(grasp: Grasping):
        world = grasp.world
        start = world.built.object_dof["cube"]
        world.set_object_pose("cube", SE3.from_xyz(0.5, 0.25, 0.4))
        world.mj_data.qvel[start : start + 6] = [0.0, -1.2, 0.0, 9.0, -7.0, 5.0]
        seen = []
        for _ in range(150):
            world.step(5)
            seen.append([(c.body_a, c.body_b, c.depth, c.force) for c in world.contacts()])
        return seen

    compiled, python = _both(act)
    assert compiled == python
    assert not compiled[0][0] and any("table" in contact for contact in compiled[0][-1])


def test_the_engine_does_not_read_the_clock():
    world = Grasping().world
    world.step(20)
    assert world.mj_data.timer.number[0] >= 20 and not world.mj_data.timer.duration.any()
