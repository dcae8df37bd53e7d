"""Recipes as nodes of real py_trees trees, in physics: what they return, say, draw and recover from."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
from tests.tasks.helpers import AtStage, live, nominal, stages, teleport

from armcell.core import ErrorCode, InputError, MissingExtraError, Outcome
from armcell.tasks import RecoverySettings

py_trees = pytest.importorskip("py_trees", reason="py_trees is not installed (pip install 'armcell[trees]')")

from py_trees.common import ParallelPolicy, Status  # noqa: E402
from py_trees.composites import Parallel, Selector, Sequence  # noqa: E402

from armcell.tasks import trees  # noqa: E402


def hand_of(cell):
    return cell.model.gripper()


@pytest.mark.slow
def test_running_until_it_ends_and_the_same_run_as_without_a_tree():
    with live("sim") as cell:
        assert cell.arm.pick("cube") and cell.arm.place("cube", on="tray")
        expected, took = cell.driver.object_poses()["cube"], cell.driver.now
    with live("sim") as cell:
        pick, place = trees.picking(cell.ctx, "cube", hand_of(cell)), trees.placing(cell.ctx, "cube", "tray")
        root = Sequence("pick and place", memory=True, children=[pick, place])
        seen, ticks = [], 0
        while root.status is not Status.SUCCESS:
            before = cell.driver.now
            root.tick_once()
            ticks += 1
            assert cell.driver.now - before <= 2 * (trees.nodes.TICK + 0.011)  # one ends, the next begins
            seen += [pick.feedback_message] if pick.status is Status.RUNNING else []
        assert [n for i, n in enumerate(seen) if i == 0 or n != seen[i - 1]] == [
            "open", "move to pre-grasp", "approach", "close", "lift"
        ]  # fmt: skip
        assert ticks > 0.5 * took / trees.nodes.TICK
        np.testing.assert_array_equal(cell.driver.object_poses()["cube"].matrix, expected.matrix)
        assert cell.driver.now == took


def test_a_failure_says_why():
    tray = nominal().object("tray").T_world_object
    with live(scene=nominal().with_object_pose("tray", tray.shifted(0.0, 2.0))) as cell:
        pick, place = trees.picking(cell.ctx, "cube", hand_of(cell)), trees.placing(cell.ctx, "cube", "tray")
        outcome = trees.run(Sequence("all", memory=True, children=[pick, place]))
        assert outcome.code is ErrorCode.FAILURE
        assert outcome.message.startswith("place cube on tray: place cube on tray: ")
        assert "out of reach" in outcome.message
        assert place.outcome.code is ErrorCode.PLANNING_FAILED and place.outcome.evidence["stages"]
        refused = trees.run(trees.picking(cell.ctx, "cube", hand_of(cell)))
        assert not refused.ok and "already holds cube" in refused.message


def test_the_tree_turns_away_and_the_arm_stops():
    """A guard that comes before the motion: true from the 4th tick on."""
    with live("sim") as cell:
        asked = []

        def danger():
            asked.append(cell.driver.now)
            return Outcome(ErrorCode.SUCCESS if len(asked) > 3 else ErrorCode.FAILURE, "nobody there")

        pick = trees.picking(cell.ctx, "cube", hand_of(cell))
        root = Selector("guarded", memory=False, children=[trees.Check("somebody there?", danger), pick])
        for _ in range(3):
            root.tick_once()
            assert root.status is Status.RUNNING
        root.tick_once()
        assert root.status is Status.SUCCESS and pick.status is Status.INVALID
        assert cell.ctx.reports[-1].name == "move to pre-grasp" and not cell.ctx.reports[-1].ok
        assert not cell.ctx.cancel.is_set() and not cell.ctx.observers
        before = cell.driver.joint_state().positions
        cell.ctx.advance(0.5)
        np.testing.assert_allclose(cell.driver.joint_state().positions, before, atol=0.02)
        assert trees.run(trees.picking(cell.ctx, "cube", hand_of(cell)))


def test_two_nodes_cannot_move_a_cell_at_once():
    with live() as cell:
        acts = [trees.picking(cell.ctx, "cube", hand_of(cell)), trees.moving_to(cell.ctx, "arm", "home")]
        root = Parallel("both", policy=ParallelPolicy.SuccessOnAll(), children=acts)
        with pytest.raises(InputError, match=r"would move the same cell at once \(several arms at once"):
            trees.run(root)


@pytest.mark.slow
def test_what_is_dropped_is_picked_up_by_the_tree_and_the_tree_tells():
    """In physics: the cube is taken out of the hand while it is carried."""
    with live("sim", observers=[AtStage("move to pre-place", lambda: drop())]) as cell:
        hand = hand_of(cell)

        def drop():
            cell.driver.command_gripper(hand.name, hand.max_width, hand.max_force)

        root = trees.transferring(cell.ctx, "cube", hand, "tray")
        assert trees.rests_on(cell.ctx, "cube", "tray").status is not Status.SUCCESS
        outcome = trees.run(root)
        assert outcome.ok, outcome.message
        assert stages(cell).count("lift") == 2
        assert "1 failure from 5" in trees.drawn(root)
        for check in (trees.rests_on(cell.ctx, "cube", "tray"), trees.held_node(cell.ctx, "cube")):
            check.tick_once()
            assert (check.status is Status.SUCCESS) == ("tray" in check.name)
        assert not cell.driver.unwanted_contacts()


def test_it_gives_up_with_every_reason():
    settings = RecoverySettings(tries=2)
    with live("sim", observers=[AtStage("close", lambda: teleport(cell, 0.0, 3.0))]) as cell:
        root = trees.transferring(cell.ctx, "cube", hand_of(cell), "tray", settings=settings)
        outcome = trees.run(root)
        assert outcome.code is ErrorCode.FAILURE
        assert "cube on tray?: cube does not stand on tray" in outcome.message
        assert "cube held?: no hand holds cube" in outcome.message and "pick cube: " in outcome.message


def test_any_stages_as_a_node():
    from armcell.tasks.stages import MoveStraight

    with live() as cell:
        hand = hand_of(cell)
        speed = cell.ctx.settings.near
        up = trees.performing(
            cell.ctx, "up", lambda c: [MoveStraight("up", "arm", hand.tcp_link, speed, (0.0, 0.0, 0.05))]
        )
        before = cell.scene().frame_pose(hand.tcp_link).translation
        assert trees.run(up)
        rose = cell.scene().frame_pose(hand.tcp_link).translation - before
        np.testing.assert_allclose(rose, [0, 0, 0.05], atol=1e-3)


def test_it_is_drawn_as_text_and_as_a_graph():
    with live() as cell:
        root = trees.transferring(
            cell.ctx, "cube", hand_of(cell), "tray", look=lambda: Outcome(ErrorCode.SUCCESS)
        )
        text, dot = trees.drawn(root), trees.as_dot(root)
    names = [node.name for node in root.iterate()]
    assert len(names) == 13 and {"look", "pick cube", "place cube on tray", "cube held?"} <= set(names)
    for name in names:
        assert name in text and name in dot
    assert dot.startswith("digraph") and dot.count("->") == len(names) - 1


def test_without_py_trees_the_extra_is_named(monkeypatch):
    for name in [n for n in sys.modules if n.startswith(("armcell.tasks.trees", "py_trees"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "py_trees", None)
    with pytest.raises(
        MissingExtraError, match=r"py_trees is not installed \(pip install 'armcell\[trees\]'\)"
    ):
        importlib.import_module("armcell.tasks.trees")
