"""Carried without leaning: measured in physics, against the same carry that may lean."""

from __future__ import annotations

import numpy as np
import pytest
from tests.tasks.helpers import live, nominal

from armcell.core import SE3, SO3, InputError
from armcell.tasks.stages import UprightConstraint


class Lean:
    """An observer: how far an object's axis has been from the vertical [rad]."""

    def __init__(self):
        self.worst = 0.0

    def on_state(self, sample) -> None:
        axis = sample.object_poses["cube"].rotation.matrix[2]
        self.worst = max(self.worst, float(np.arccos(min(np.abs(axis).max(), 1.0))))

    def on_event(self, event) -> None: ...

    def on_trajectory(self, time, trajectory) -> None: ...


@pytest.mark.slow
def test_it_leans_no_farther_than_told():
    leans = {}
    for lean in (None, 0.1):
        watch = Lean()
        with live("sim", observers=[watch]) as cell:
            assert cell.arm.pick("cube")
            outcome = cell.arm.place("cube", on="tray", lean=lean)
            assert outcome.ok, outcome.message
        leans[lean] = watch.worst
    assert leans[0.1] < 0.1 + 0.01  # planned and proven; tracking and slip come on top
    assert leans[None] > 0.15, "this way leans anyhow: the test shows nothing"


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("turn", [0.0, 2.5])
def test_the_axis_nearest_to_the_vertical_is_kept(axis, turn):
    """Whichever side is up: a turn about the vertical costs nothing, a lean counts in full."""
    R = [SO3.from_rpy((0, -np.pi / 2, 0)), SO3.from_rpy((np.pi / 2, 0, 0)), SO3.identity()][axis]
    tilted = SO3.exp((0.03, 0.0, 0.0)) @ R
    scene = nominal().with_object_pose("cube", SE3(SO3.exp((0, 0, turn)) @ tilted, np.array([0.4, 0, 0.5])))
    (kept,) = UprightConstraint("cube", 0.1).constraints(scene).orientations
    wanted = kept.rotation.matrix
    assert abs(wanted[2, axis]) == pytest.approx(1.0)
    assert kept.tolerance[axis] == pytest.approx(np.pi)
    assert np.linalg.norm(np.delete(kept.tolerance, axis)) == pytest.approx(0.1)


def test_a_wrong_lean_is_refused():
    with live() as cell:
        assert cell.arm.pick("cube")
        with pytest.raises(InputError, match="lean is 0 rad, it must be above 0 and below pi / 2"):
            cell.arm.place("cube", on="tray", lean=0.0)
