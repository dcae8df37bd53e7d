"""Three arms side by side: they keep apart, take turns, and only the arm in the way makes way."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from tests.planning.multi_arm.dual import tip
from tests.tasks.arms.test_side_by_side import Watch, nearest, tour
from tests.tasks.test_merger import planned

from armcell.cell import load
from armcell.tasks import Merger, TaskFailed, TaskSettings, checked
from armcell.tasks.arms.object_order import TourSegment, best_order, timetable
from armcell.tasks.stages import Connect

A, B, C = "a_arm", "b_arm", "c_arm"
MIDDLE = [(0.0, 0.0), (0.1, 0.05), (-0.05, 0.02)]


@pytest.fixture(scope="module")
def cell():
    return load("three_ur5_table")


@pytest.mark.long
def test_tours_through_one_place_end_and_keep_apart(cell):
    watch = Watch()
    with cell.connect("fake", seed=1, observers=[watch]) as live:
        programs = {A: tour(MIDDLE), B: tour(MIDDLE[::-1]), C: tour(MIDDLE[1:] + MIDDLE[:1])}
        result = live.side_by_side(**programs)
    assert result.ok, result.message
    assert nearest(cell, watch, "all_arms") >= 0.015 and len(watch.samples) > 100
    assert sum(result.waited.values()) + sum(result.yielded.values()) + sum(result.searched.values()) > 0


@pytest.mark.slow
def test_only_the_arm_in_the_way_makes_way(cell):
    """B's program is over, and it stands where A wants to go; C stands aside."""
    with cell.connect("fake") as live:
        result = live.side_by_side(
            a_arm=tour([(0.3, 0.0), (0.0, 0.0)]), b_arm=tour([(0.0, 0.0)]), c_arm=tour([(-0.15, -0.3)])
        )
        assert result.ok, result.message
        assert result.yielded[B] >= 1 and result.yielded[C] == 0
        home = live.model.named_state(C, "home")
        now = live.driver.joint_state().reindexed(home.joint_names).positions
        assert np.max(np.abs(now - home.positions)) > 0.1


@pytest.mark.slow
def test_an_arm_without_a_program_is_an_obstacle(cell):
    with cell.connect("fake") as live:
        checked(live[C].move_to(tip(0.0, -0.05)))
        before = live.driver.joint_state().reindexed(live.model.group(C).joint_names).positions
        with pytest.raises(TaskFailed, match="touches c_"):
            live.side_by_side(a_arm=tour([(0.0, 0.0)]), b_arm=tour([(-0.15, 0.3)]))
        assert live.side_by_side(a_arm=tour([(0.2, 0.2)]), b_arm=tour([(-0.15, 0.3)])).ok
        after = live.driver.joint_state().reindexed(live.model.group(C).joint_names).positions
        np.testing.assert_allclose(after, before, atol=1e-9)


def test_a_zone_serves_three_arms_in_turn(cell):
    inside, served = [], []

    def program(arm):
        for _ in range(3):
            with arm.reserve("bin"):
                inside.append(arm.group)
                assert inside == [arm.group]
                served.append(arm.group)
                arm.hold(0.3)
                inside.clear()

    with cell.connect("fake") as live:
        assert live.side_by_side(a_arm=program, b_arm=program, c_arm=program).ok
    assert served == [A, B, C] * 3


def test_a_rendezvous_waits_for_all_arms(cell):
    at = {}

    def program(delay):
        def run(arm):
            arm.hold(delay)
            arm.rendezvous("here")
            at[arm.group] = live.driver.now

        return run

    with cell.connect("fake") as live:
        began = live.driver.now
        assert live.side_by_side(a_arm=program(0.1), b_arm=program(1.0), c_arm=lambda arm: None).ok
    assert at[A] == pytest.approx(at[B], abs=0.05) and at[A] - began >= 1.0 - 1e-9
    assert C not in at  # its program ended, which counts as an arrival


def test_an_item_is_chosen_whose_zone_no_other_arm_uses(cell):
    chosen = []

    def holds(zone):
        def run(arm):
            with arm.reserve(zone):
                arm.hold(1.0)

        return run

    def chooses(arm):
        arm.hold(0.5)
        chosen.append(arm.choose(["x", "y", "z"], str.upper))

    with cell.connect("fake") as live:
        assert live.side_by_side(a_arm=holds("X"), b_arm=holds("Y"), c_arm=chooses).ok
    assert chosen == ["z"]


def test_of_all_orders_of_three_arms_none_is_done_earlier():
    zones = {"p": "red", "q": "blue", "r": "red", "s": "blue", "t": "red", "u": "blue"}
    streams = (("p", "q"), ("r", "s"), ("t", "u"))

    def segments(order):
        return tuple(
            segment
            for item in order
            for segment in (TourSegment(2.0, 3.0), TourSegment(2.0, 3.0, zones[item]))
        )

    def ends(orders):
        return max(spans[-1][2] for spans in timetable([segments(order) for order in orders]))

    best = best_order(streams, (segments,) * 3)
    assert ends(best) == min(ends(orders) for orders in product(*map(permutations, streams))) < ends(streams)


def test_the_orders_of_a_cell_are_those_of_its_arms(cell):
    scene = cell.scene(0)
    with cell.connect("fake", seed=0) as live:
        found = live.orders(
            lambda cube: f"{cube[2:]}_tray", a_arm=["a_red"], b_arm=["b_red", "b_green"], c_arm=[]
        )
    assert {arm: sorted(order) for arm, order in found.items()} == {
        A: ["a_red"],
        B: ["b_green", "b_red"],
        C: [],
    }
    assert "red_tray" in scene.objects


def test_three_motions_are_merged_if_they_keep_apart(cell):
    speed, angles = TaskSettings().free, np.deg2rad((0.0, 120.0, 240.0))

    def merger(radius):
        goals = [tip(radius * np.cos(t), radius * np.sin(t)) for t in angles]
        return Merger(
            "at once", tuple(Connect(g, g, speed, goal=q) for g, q in zip((A, B, C), goals, strict=True))
        )

    (together,) = planned(merger(0.25), cell.scene()).best.steps
    assert len(together.motion.trajectory.joint_names) == 18
    refused = planned(merger(0.04), cell.scene())
    assert not refused.ok and "the arms come within 20 mm" in refused.message
