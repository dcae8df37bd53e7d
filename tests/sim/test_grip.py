"""Friction holds; what is not friction is reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.sim.helpers import Grasping

from armcell.core import SE3
from armcell.model import load_robot
from armcell.scene import PlanningScene
from armcell.sim import PhysicsSettings, SimWorld

HOLD = 5.0  # [s]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "mass", "friction"), [("panda", 0.1, 0.8), ("panda", 0.5, 0.3), ("ur10_gripper", 0.3, 0.5)]
)
def test_friction_grasp_holds(robot, mass, friction):
    grasp = Grasping(robot, mass, friction)
    world, gripper = grasp.world, grasp.gripper.name
    grasp.close(force=32.0)
    state = world.gripper_state(gripper)
    assert state.held == "cube"
    assert state.force_per_finger == pytest.approx(32.0, rel=0.01)
    world.monitor.watch("cube", ["table"])
    grasp.lift()
    world.monitor.forbid("cube", "table")
    assert world.object_pose("cube").translation[2] == pytest.approx(0.175, abs=2e-3)
    world.watch_slip("cube", gripper)
    world.step(round(HOLD / world.timestep))
    meters, radians = world.slip()
    assert meters < 0.0005 and radians < 0.005
    assert world.gripper_state(gripper).held == "cube"
    assert world.monitor.unwanted == () and world.welds == ()


def test_a_moving_hand_does_not_slip():
    grasp = Grasping()
    grasp.close()
    grasp.world.watch_slip("cube", "hand")
    grasp.lift(seconds=0.6, settle=0.0)  # 0.5 m/s
    meters, radians = grasp.world.slip()
    assert meters < 0.0006 and radians < 0.001


@pytest.mark.parametrize("force", (5.0, 20.0, 60.0))
def test_the_force_is_what_was_asked(force):
    grasp = Grasping()
    grasp.close(force=force)
    assert grasp.world.gripper_state("hand").force_per_finger == pytest.approx(force, rel=0.01)


def test_closing_does_not_kick_the_object():
    grasp = Grasping()
    world = grasp.world
    world.set_object_pose("cube", world.object_pose("cube").shifted(y=0.008))  # one finger comes first
    world.set_gripper_target("hand", 0.0, 32.0)
    fastest = 0.0
    for _ in range(500):
        world.step()
        fastest = max(fastest, abs(world.object_twist("cube")[:3]).max())
    assert fastest < 0.12
    assert world.object_pose("cube").translation[1] == pytest.approx(0.0, abs=1e-3)  # between the fingers
    assert world.gripper_state("hand").held == "cube"


def test_an_empty_gripper_closes_and_opens_at_its_speed():
    grasp = Grasping()
    world = grasp.world
    world.set_object_pose("cube", SE3.from_xyz(0.5, 0.3, 0.025))
    grasp.close(seconds=0.4)
    assert world.gripper_state("hand").width == pytest.approx(0.08 - 2 * 0.05 * 0.4, abs=4e-3)
    world.step(400)
    assert abs(world.gripper_state("hand").width) < 1e-3 and world.gripper_state("hand").held is None
    world.set_gripper_target("hand", 0.06)
    world.step(500)
    assert world.gripper_state("hand").width == pytest.approx(0.06, abs=1e-4)
    assert not world.monitor.unwanted


def test_too_little_force_drops_it():
    grasp = Grasping(mass=0.5, friction=0.3)  # 2 fingers x 0.3 x 5 N < 0.5 kg x 9.81
    grasp.close(force=5.0)
    grasp.lift(seconds=0.8)
    assert grasp.world.gripper_state("hand").held is None
    assert grasp.world.object_pose("cube").translation[2] < 0.03


def test_weld_is_reported_and_released():
    grasp = Grasping(mass=0.5, friction=0.3, settings=PhysicsSettings(grip_mode="weld"))
    world = grasp.world
    grasp.close(force=5.0)
    (weld,) = world.welds
    assert (weld.object, weld.gripper, weld.mode, weld.released_at) == ("cube", "hand", "weld", None)
    world.watch_slip("cube", "hand")
    grasp.lift(seconds=0.8)
    assert world.slip()[0] < 0.001  # friction alone would have dropped it
    grasp.open()
    (weld,) = world.welds
    assert weld.released_at is not None and weld.released_at > weld.time
    assert world.object_pose("cube").translation[2] < 0.03


def test_hybrid_welds_only_what_slips():
    firm = Grasping(settings=PhysicsSettings(grip_mode="hybrid"))
    firm.close()
    firm.lift(seconds=0.8)
    assert firm.world.welds == ()
    loose = Grasping(mass=0.5, friction=0.3, settings=PhysicsSettings(grip_mode="hybrid"))
    loose.close(force=5.0)
    assert loose.world.welds == ()
    loose.lift(seconds=0.8)
    (weld,) = loose.world.welds
    assert weld.mode == "hybrid" and "slipped" in weld.reason
    assert loose.world.gripper_state("hand").held == "cube"


@pytest.mark.slow
@pytest.mark.cases("2ms-panda")
@pytest.mark.parametrize("robot", ("panda", "ur10_gripper"))
@pytest.mark.parametrize("settings", [PhysicsSettings(), PhysicsSettings(timestep=0.005)], ids=["2ms", "5ms"])
def test_many_masses_and_frictions_hold(robot, settings):
    for mass in (0.03, 0.2, 0.5):
        for friction in (0.3, 0.6, 1.0):
            grasp = Grasping(robot, mass, friction, settings)
            grasp.close()
            grasp.lift()
            grasp.world.watch_slip("cube", grasp.gripper.name)
            grasp.world.step(round(HOLD / settings.timestep))
            assert grasp.world.slip()[0] < 0.0005, (mass, friction)


def test_fingers_whose_coupling_has_an_offset_reach_their_width():
    """Kinova's Gen3 lite: the tips follow the fingers with an offset."""
    model = load_robot("ur10_gripper")
    gripper = model.gripper()
    follower = next(j for j in model.joints.values() if j.mimic and j.mimic.joint == gripper.joint_name)
    away = replace(
        follower,
        mimic=replace(follower.mimic, offset=-0.01),
        T_parent_joint=follower.T_parent_joint @ SE3.from_xyz(*(0.01 * np.asarray(follower.axis))),
        limits=replace(follower.limits, lower=follower.limits.lower - 0.01),
    )
    model = replace(model, joints={**model.joints, follower.name: away})
    world = SimWorld(PlanningScene(model, model.default_positions()))
    for width in (0.03, 0.07):
        world.set_gripper_target(gripper.name, width)
        world.step(1000)
        assert world.gripper_state(gripper.name).width == pytest.approx(width, abs=1e-3)
