"""Motions of a gripper on the bus that a client cancels."""

import threading

import pytest

from armcell.cell import load
from armcell.core import ErrorCode
from armcell.ros.nodes.gripper_node import gripper_command_steps


@pytest.mark.parametrize("mode", ["sim", "fake"])
def test_a_cancelled_gripper_stops_where_it_is(mode):
    with load("panda_pick").connect(mode) as live:
        driver, hand = live.driver, live.model.gripper()
        opened, cancel = driver.gripper(hand.name).width, threading.Event()
        steps = gripper_command_steps(driver, hand, 0.0, 20.0, cancel)
        while driver.gripper(hand.name).width > 0.8 * opened:
            next(steps)
            live.ctx.advance(driver.period)
        cancel.set()
        with pytest.raises(StopIteration) as ended:
            next(steps)
        live.ctx.advance(1.0)
        stopped = driver.gripper(hand.name).width
        assert ended.value.value.code is ErrorCode.PREEMPTED and 0.6 * opened < stopped < 0.85 * opened


@pytest.mark.slow
def test_a_command_turns_the_vacuum_on_and_off():
    """With an object under the cups it is held, and without one the command ends, too."""
    with load("suction_pick").connect("sim") as live:
        driver, hand = live.driver, live.model.gripper()

        def command(width: float):
            steps = gripper_command_steps(driver, hand, width, hand.max_force, threading.Event())
            while True:
                try:
                    next(steps)
                except StopIteration as ended:
                    return ended.value
                live.ctx.advance(driver.period)

        assert command(0.0).evidence["held"] is None
        assert driver.gripper(hand.name).width == 0.0 and command(hand.max_width).ok
        assert live.arm.pick("box").ok and live.arm.move_to("home").ok
        held = command(0.0)
        assert held.ok and held.evidence["held"] == "box"
        live.ctx.holding.clear()
        assert command(hand.max_width).ok and driver.gripper(hand.name).held is None
