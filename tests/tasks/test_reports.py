"""The numbers of the stage table against the motions that were really made."""

from __future__ import annotations

import numpy as np
import pytest
from tests.tasks.helpers import live

from armcell.collision import ExactChecker
from armcell.core import JointState


class Watching:
    """An observer that keeps each motion with the scene as it was when it began."""

    def __init__(self):
        self.cell, self.motions, self.samples = None, [], []

    def on_event(self, event) -> None: ...

    def on_state(self, sample) -> None:
        self.samples.append(sample)

    def on_trajectory(self, time, trajectory) -> None:
        self.motions.append((trajectory, self.cell.scene()))


@pytest.fixture(scope="module")
def watched():
    watching = Watching()
    with live("sim", observers=[watching]) as cell:
        watching.cell = cell
        assert cell.arm.pick("cube").ok
        assert cell.arm.hold(0.3).ok
        assert cell.arm.place("cube", on="tray").ok
        assert cell.arm.move_to("home").ok
        watching.end = cell.driver.now
        watching.moves = [r for r in cell.ctx.reports if r.planner]
        watching.reports = list(cell.ctx.reports)
    return watching


@pytest.mark.slow
def test_every_motion_is_announced_with_its_trajectory(watched):
    assert len(watched.motions) == len(watched.moves)
    for (trajectory, scene), report in zip(watched.motions, watched.moves):
        assert set(trajectory.joint_names) == set(scene.model.group("arm").joint_names)
        np.testing.assert_allclose(
            trajectory.positions[0], scene.state.reindexed(trajectory.joint_names).positions, atol=0.01
        )
        assert -1e-6 < report.motion_time_s - trajectory.duration < 1.0


def test_samples_come_evenly_to_the_end(watched):
    times = np.array([s.time for s in watched.samples])
    assert np.all(np.diff(times) > 0) and np.diff(times).max() < 0.025
    assert times[0] == 0.0 and times[-1] == pytest.approx(watched.end, abs=0.025)
    heights = [s.object_poses["cube"].translation[2] for s in watched.samples]
    assert max(heights) > heights[0] + 0.1
    assert max(s.gripper_force["hand"] for s in watched.samples) > 5.0
    assert min(s.gripper_width["hand"] for s in watched.samples) == pytest.approx(0.05, abs=2e-3)


def test_the_clearance_is_not_larger_than_it_was(watched):
    for (trajectory, scene), report in zip(watched.motions, watched.moves):
        if report.name not in ("move to pre-grasp", "move to pre-place", "move to home"):
            continue  # near the object what may touch differs from motion to motion
        checker = ExactChecker(scene, trajectory.joint_names)
        times = np.arange(0.0, trajectory.duration, 0.01)
        states = (JointState(trajectory.joint_names, trajectory.sample(t)[0]) for t in times)
        nearest = (checker.nearest(s.positions, 0.25) for s in states)
        true = min(contact.distance for contact in nearest if contact)
        assert report.clearance_m <= true + 5e-4, report.name


def test_the_stages_cover_the_whole_run(watched):
    assert sum(r.motion_time_s for r in watched.reports) == pytest.approx(watched.end, abs=1e-6)
    assert [r.name for r in watched.reports][-1] == "move to home"
