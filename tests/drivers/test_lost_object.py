"""A real arm notices that the object in its hand slipped away, also if its hand reports a grasp."""

from __future__ import annotations

import pytest
from tests.drivers.rigs import RIGS
from tests.drivers.toy_kind import ToyArm

from armcell.core import Box
from armcell.drivers import DriverOptions, drivers
from armcell.scene import CollisionObject, PlanningScene


class Fingers:
    """A hand that reports a grasp as long as it is not closed fully."""

    hint, time_since_answer = "", 0.0

    def __init__(self):
        self.width = 0.08

    def drive(self, width, force):
        self.width = max(width, 0.05) if width < self.width else width

    def read(self):
        return self.width, 0.001 < self.width < 0.06

    def close(self):
        pass


@pytest.fixture
def held(monkeypatch):
    fingers = Fingers()
    monkeypatch.setattr(ToyArm, "connect_gripper", lambda self, gripper: fingers)
    with RIGS["toy"]() as rig:
        scene = PlanningScene.of(rig.model)
        at = scene.frame_pose(rig.model.gripper("hand").tcp_link)
        scene = scene.with_object(
            CollisionObject.single("cube", Box(0.05, 0.05, 0.05), pose=at, movable=True)
        )
        real = {"arms": {"arm": {"kind": "toy", **rig.block}}, "max_state_age": 1.0, "watchdog": 0.5}
        with drivers["real"](scene, DriverOptions(extra={"real": real})) as driver:
            driver.command_gripper("hand", 0.0, 20.0)
            assert driver.gripper("hand").held == "cube"
            yield driver, fingers


def test_fingers_that_close_further_have_lost_the_object(held):
    driver, fingers = held
    fingers.width = 0.049  # it gives way under the force
    assert driver.gripper("hand").held == "cube"
    fingers.width = 0.03
    reading = driver.gripper("hand")
    assert reading.held is None and reading.force_per_finger == 0.0
    fingers.width = 0.05  # nor does it come back by itself
    assert driver.gripper("hand").held is None


def test_an_opened_hand_may_grasp_again(held):
    driver, fingers = held
    fingers.width = 0.03
    assert driver.gripper("hand").held is None
    driver.command_gripper("hand", 0.08, 20.0)
    driver.command_gripper("hand", 0.0, 20.0)
    assert driver.gripper("hand").held == "cube"


def test_only_the_pose_of_an_object_that_no_arm_holds_can_be_corrected(held):
    driver, _ = held
    T = driver.object_poses()["cube"]
    driver.correct_object_pose("cube", T.shifted(z=0.1))
    assert driver.object_poses()["cube"].distance_to(T)[0] < 1e-6  # the hand knows better
    driver.command_gripper("hand", 0.08, 20.0)
    driver.correct_object_pose("cube", T.shifted(z=0.1))
    assert driver.object_poses()["cube"].distance_to(T.shifted(z=0.1))[0] < 1e-6
