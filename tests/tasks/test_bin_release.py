"""Release of an object over the tray: fingers that something stops have released an object that is free."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest

from armcell.core import ErrorCode
from armcell.tasks import TaskSettings
from armcell.tasks.bin_clearing.stages import FREE, Drop
from armcell.tasks.steps import CommandGripper

HELD = 0.030  # [m]
WANTED = 0.050
SPEED = 0.1  # [m/s]


class Fingers:
    """A gripper whose fingers open at a constant speed up to an obstacle."""

    def __init__(self, blocked_at: float):
        self.now, self.width, self.target, self.blocked_at = 0.0, HELD, HELD, blocked_at

    def gripper(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(width=self.width, force_per_finger=0.0)

    def command_gripper(self, name: str, width: float, force: float) -> None:
        self.target = width

    def advance(self, seconds: float) -> None:
        self.now += seconds
        self.width = min(self.width + SPEED * seconds, self.target, self.blocked_at)


def drop(blocked_at: float):
    fingers = Fingers(blocked_at)
    scene = SimpleNamespace(attached={}, objects={})
    ctx = SimpleNamespace(
        driver=fingers, settings=TaskSettings(), cancel=threading.Event(), reports=[],
        advance=fingers.advance, emit=lambda *a, **k: None, change_scene=lambda make: make(scene),
    )  # fmt: skip
    gripper = SimpleNamespace(name="gripper")
    return Drop(CommandGripper("open", gripper, WANTED, 40.0, 0.1)).perform(ctx), fingers, ctx


@pytest.mark.parametrize("blocked_at", [1.0, HELD + FREE + 0.001])
def test_fingers_that_a_wall_stops_after_the_object_is_free_have_released_it(blocked_at):
    outcome, fingers, ctx = drop(blocked_at)
    assert outcome.ok and ctx.reports[0].ok
    assert fingers.width == pytest.approx(min(WANTED, blocked_at), abs=1e-3)
    assert fingers.now < (WANTED - HELD) / SPEED + 0.1 + 0.1 + 0.05


def test_fingers_that_do_not_open_have_not_released_it():
    outcome, fingers, _ = drop(HELD + 0.001)
    assert outcome.code is ErrorCode.CONTROL_FAILED and "wanted 50.0 mm" in outcome.message
    assert fingers.now >= TaskSettings().gripper_timeout
