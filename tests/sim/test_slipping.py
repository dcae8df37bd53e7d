"""Static and dynamic friction in physics: a block on a slope, a held cube, snapshots, models used again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.sim.helpers import Grasping

from armcell.core import SE3, Box, InputError
from armcell.model import load_robot
from armcell.scene import CollisionObject, Material, PlanningScene
from armcell.sim import PhysicsSettings, SimWorld

G, STATIC, DYNAMIC = 9.81, 0.6, 0.3


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda")


def slope(panda, angle: float, material: Material, push: float = 0.0) -> SimWorld:
    """A block at rest on a slope that falls towards the x axis' negative end; `push` [m/s] down the slope."""
    T = SE3.from_xyz_rpy((3.0, 0.0, 1.0), (0.0, -angle, 0.0))
    ramp = CollisionObject.single("ramp", Box(6.0, 0.5, 0.1), T)
    block = CollisionObject.single(
        "block",
        Box(0.2, 0.2, 0.05),
        T @ SE3.from_xyz(2.5, 0, 0.075),
        movable=True,
        mass=1.0,
        material=material,
    )
    world = SimWorld(PlanningScene.of(panda, objects=[ramp, block]), PhysicsSettings())
    world.step(50)
    dof = world.built.object_dof["block"]
    world.mj_data.qvel[dof : dof + 3] = T.rotation.matrix @ [-push, 0.0, 0.0]
    return world


def along(world: SimWorld) -> float:
    """Speed of the block [m/s]."""
    dof = world.built.object_dof["block"]
    return float(np.linalg.norm(world.mj_data.qvel[dof : dof + 3]))


@pytest.mark.cases("27.0")
@pytest.mark.parametrize("angle_deg", [20.0, 27.0])
def test_between_both_coefficients_a_block_rests_until_it_is_pushed(panda, angle_deg):
    """tan 20 and tan 27 deg are 0.36 and 0.51: between the dynamic coefficient and the static one."""
    angle = np.deg2rad(angle_deg)
    two = Material(STATIC, dynamic_friction=DYNAMIC)
    world = slope(panda, angle, two)
    world.step(1000)
    assert along(world) < 1e-3
    world = slope(panda, angle, two, push=0.2)
    world.step(50)  # the jolt is over
    before, time = along(world), world.time
    world.step(450)
    expected = G * (np.sin(angle) - DYNAMIC * np.cos(angle))
    assert (along(world) - before) / (world.time - time) == pytest.approx(expected, rel=0.05)
    stopped = slope(panda, angle, Material(STATIC), push=0.2)  # with the static coefficient alone
    stopped.step(1000)
    assert along(stopped) < 1e-3


def test_a_sliding_block_stops_by_its_dynamic_coefficient_and_then_rests(panda):
    world = slope(panda, 0.0, Material(STATIC, dynamic_friction=DYNAMIC), push=1.0)
    world.step(50)  # the jolt is over
    assert world._stepper.slip.get_state() == (True,)
    start, speed = world.object_pose("block").translation[0], along(world)
    world.step(500)
    assert world._stepper.slip.get_state() == (False,) and along(world) < 1e-3
    slid = start - world.object_pose("block").translation[0]
    assert slid == pytest.approx(speed**2 / (2 * DYNAMIC * G), rel=0.05)


@pytest.mark.slow
def test_a_held_cube_keeps_its_static_friction(panda):
    """A grip that needs more than the dynamic coefficient lifts the cube, once slipped it is lost."""
    weight = 0.5 * G
    force = weight / (2 * 0.45)  # 0.45 is between both coefficients
    heights = {}
    for name, material in (("both", Material(STATIC, dynamic_friction=DYNAMIC)), ("low", Material(DYNAMIC))):
        grasp = Grasping("panda", mass=0.5, material=material)
        grasp.close(force)
        grasp.lift(2.5)
        heights[name] = grasp.world.object_pose("cube").translation[2]
    assert heights["both"] > 0.15 and heights["low"] < 0.05


def test_a_snapshot_brings_the_state_of_sliding_back(panda):
    world = slope(panda, 0.4, Material(STATIC, dynamic_friction=DYNAMIC), push=0.2)
    world.step(20)
    kept = world.snapshot()
    world.step(200)
    first = world.object_pose("block").matrix
    world.reset()
    assert world._stepper.slip.get_state() == (False,)
    world.restore(kept)
    world.step(200)
    assert np.array_equal(world.object_pose("block").matrix, first)


def test_models_used_again_begin_with_static_friction(panda):
    for _ in range(2):
        world = slope(panda, 0.4, Material(STATIC, dynamic_friction=DYNAMIC), push=0.5)
        geom = int(np.flatnonzero(world.built.geom_owner == world.built.owner_index["block"])[0])
        assert world.mj_model.geom_friction[geom, 0] == STATIC
        world.step(20)
        assert world.mj_model.geom_friction[geom, 0] == DYNAMIC
        del world


def test_a_dynamic_coefficient_above_the_static_one_is_refused():
    with pytest.raises(InputError, match="dynamic friction 0.7 is above static friction 0.6 .*swap"):
        Material(0.6, dynamic_friction=0.7)
    with pytest.raises(InputError, match="dynamic_friction is -1"):
        Material(0.6, dynamic_friction=-1)
    assert Material(0.6, dynamic_friction=0.3).scaled(0.5) == Material(0.3, dynamic_friction=0.15)
    assert replace(Material(0.6)).sliding == 0.6
