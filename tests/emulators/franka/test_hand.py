"""The emulated Franka Hand: its force after a grasp, and an object that slips away."""

from __future__ import annotations

import pytest
from tests.emulators.franka.rig import Rig

from armcell.cell import load
from armcell.core import SE3, Box, JointState
from armcell.drivers.franka.wire.gripper import Command, Status
from armcell.emulators.franka.hand import Hand
from armcell.scene import CollisionObject, PlanningScene

FORCE = 18.0  # [N]


@pytest.fixture
def grasping():
    """A hand that has just grasped a cube of 5 cm."""
    model = load("panda_pick").model
    fingers = model.group("hand").joint_names
    scene = PlanningScene.of(model).with_state(JointState(fingers, [0.026] * len(fingers)))
    at = scene.frame_pose(model.gripper("hand").tcp_link)
    scene = scene.with_object(
        CollisionObject.single("cube", Box(0.05, 0.05, 0.05), pose=at, movable=True, mass=0.1)
    )
    rig, answers = Rig(scene), []
    hand = Hand(rig.plant)
    hand.start(Command.GRASP, (0.04, 0.039, 0.04, 0.1, FORCE), answers.append)
    for _ in range(600):
        hand.step()
        rig.idle(1)
    assert answers == [Status.SUCCESS] and hand.is_grasped and hand.width == pytest.approx(0.05, abs=1e-3)
    return rig, hand


def test_the_force_stays_after_the_grasp(grasping):
    rig, _ = grasping
    force = rig.plant.world.gripper_state("hand").force_per_finger
    assert force == pytest.approx(FORCE, rel=0.1)


def test_a_hand_that_lost_its_object_closes_and_reports_no_grasp(grasping):
    rig, hand = grasping
    rig.plant.world.set_object_pose("cube", SE3.from_xyz(2.0, 2.0, 1.0))
    for _ in range(600):
        hand.step()
        rig.idle(1)
    assert hand.width < 1e-3 and not hand.is_grasped
