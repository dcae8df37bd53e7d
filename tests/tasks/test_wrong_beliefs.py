"""An object is not where the planning scene has it: the pick finds it, or says what it measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from armcell.cell import load, run_task, with_values
from armcell.core import ErrorCode
from armcell.drivers import Capability, DriverProxy
from armcell.tasks import TaskSettings

MOVED = "disturbances.moved.cube.by"


def panda_pick(by, **settings):
    cell = with_values(load("panda_pick"), {MOVED: list(by)})
    return cell, replace(cell.settings, **settings)


def texts(live, *kinds):
    return [e.text for e in live.ctx.events if e.kind in kinds]


@pytest.mark.slow
@pytest.mark.cases("level0")
@pytest.mark.parametrize(
    "by",
    [(0.005, 0.0, 0.0), (0.0, -0.005, 0.0), (-0.0035, 0.0035, 0.0)],
    ids=["level0", "level1", "level2"],
)
def test_a_task_succeeds_with_an_object_5_mm_beside_its_believed_pose(by):
    cell, _ = panda_pick(by)
    with cell.connect("sim", 0) as live:
        result = run_task(cell, live, 0, "sim")
        assert result["success"], result["message"]
        assert not result["unwanted_contacts"] and not result["welds"]


@pytest.mark.slow
def test_a_contact_during_the_approach_shows_where_the_object_is():
    """A finger comes down on the cube: the hand stops, and the pick moves its belief toward this finger."""
    cell, settings = panda_pick((0.014, 0.014, 0.0))
    with cell.connect("sim", 0, settings=settings) as live:
        believed = live.scene().object("cube").T_world_object.translation
        true = live.driver.true_poses()["cube"].translation
        outcome = live.arm.pick("cube")
        assert outcome.ok, outcome.message
        (first, *_) = texts(live, "grasp")
        measured, _, assumed = first.partition("; ")
        assert "touched something" in measured and "measured:" in measured and "N on the hand" in measured
        x, y, z = believed
        assert assumed.startswith(f"believed: the scene has cube at {x:.3f} {y:.3f} {z:.3f}")
        note = next(text for text in texts(live, "note") if "corrected" in text)
        assert "the contact shows cube at least" in note
        assert np.linalg.norm(true - believed) > 0.015


@pytest.mark.slow
def test_the_first_cause_comes_first():
    """The cube is out of the hand's reach around its believed pose: each attempt says what it measured."""
    cell, settings = panda_pick((0.05, 0.05, 0.0), attempts=2)
    with cell.connect("sim", 0, settings=settings) as live:
        outcome = live.arm.pick("cube")
        assert outcome.code is ErrorCode.CONTROL_FAILED
        first, *later = outcome.message.split("; then: ")
        assert later and texts(live, "grasp")[0] == first
        assert all("measured:" in text and "believed:" in text for text in (first, *later))


class NoForce(DriverProxy):
    """A driver that measures no force."""

    @property
    def capabilities(self):
        return super().capabilities - {Capability.MEASURE_FORCE}


@pytest.mark.slow
def test_without_force_sensing_the_arm_says_where_it_stopped():
    cell, settings = panda_pick((0.014, 0.014, 0.0), attempts=1)
    with cell.connect("sim", 0, settings=settings) as live:
        live.ctx.driver = NoForce(live.driver)
        outcome = live.arm.pick("cube")
        assert not outcome.ok
        assert "approach to cube failed: the arm stopped" in outcome.message
        assert "before the grasp" in outcome.message and "believed: the scene has cube" in outcome.message


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.005, -0.005])
def test_an_object_rests_on_its_support_whatever_height_the_scene_believes(height):
    cell, _ = panda_pick((0.0, 0.0, 0.0))
    with cell.connect("sim", 0) as live:
        T = live.driver.object_poses()["cube"]
        live.driver.correct_object_pose("cube", T.shifted(z=height))
        assert live.arm.pick("cube").ok
        (note,) = (text for text in texts(live, "note") if "corrected" in text)
        assert f"{abs(height) * 1000:.1f} mm {'above' if height > 0 else 'inside'} its support" in note
        assert live.driver.unwanted_contacts() == []


@pytest.mark.slow
def test_a_second_look_finds_an_object_that_moved_after_the_first():
    cell = load("six_axis_camera")
    with cell.connect(seed=2) as live:
        assert live.look("above").ok
        world = live.driver.world
        assert world is not None
        world.set_object_pose("cube", world.object_pose("cube").shifted(y=0.08))
        outcome = live.arm.pick("cube")
        assert outcome.ok, outcome.message
        assert [r.name for r in live.ctx.reports].count("look with above") == 2


def test_the_opening_follows_the_setting():
    assert TaskSettings().pose_error == pytest.approx(0.005)
    cell, _ = panda_pick((0.0, 0.0, 0.0))
    for error, opening in ((0.0, 0.060), (0.005, 0.062), (0.01, 0.072)):
        settings = replace(cell.settings, pose_error=error, attempts=1)
        with cell.connect("fake", 0, settings=settings) as live:
            outcome = live.arm.pick("cube")
            assert outcome.ok and outcome.evidence["grasp"].opening == pytest.approx(opening, abs=1e-4)


def test_a_measured_height_stays():
    """The fake robot knows where its objects are, also if one hangs in the air."""
    cell, _ = panda_pick((0.0, 0.0, 0.0))
    scene = cell.scene()
    above = scene.object("cube").T_world_object.shifted(z=0.004)
    with cell.connect("fake", 0, scene=scene.with_object_pose("cube", above)) as live:
        assert live.arm.pick("cube").ok
        assert not [text for text in texts(live, "note") if "corrected" in text]
