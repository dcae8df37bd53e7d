"""The vacuum of a cup is a bounded force on a contact: it holds below the formula's limit and drops above."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from armcell.core import SE3, Box, Cylinder
from armcell.model import SuctionGripper, hand_alone, load_robot
from armcell.scene import CollisionObject, Material, PlanningScene
from armcell.sim import PhysicsSettings, SimWorld

G = 9.81
RADIUS, STROKE = 0.018, 0.002
PLANE = 0.11  # [m] height of the rings above the hand's root
SECONDS = 2.0


def hand(cups: int = 1, **values):
    """The library's vacuum gripper without its arm; one cup in the middle, or the two of the library."""
    model = load_robot("ur10_suction")
    gripper = model.gripper()
    assert isinstance(gripper, SuctionGripper)
    if cups == 1:
        middle = replace(gripper.cups[0], xyz=(0.0, -0.03, 0.04))
        gripper = replace(gripper, cups=(middle,), **values)
    else:
        gripper = replace(gripper, **values)
    return hand_alone(model, gripper), gripper


def held(shape, mass, gravity, at=(0.0, 0.0), cups=1, friction=0.6, turned=None, seconds=SECONDS, **values):
    """Suck an object that touches the cups, then switch gravity on. The hand points up: +z pulls it off.

    Returns the world and the object's displacement [m] in the hand.
    """
    model, gripper = hand(cups, **values)
    T = SE3.from_xyz_rpy((*at, PLANE + 0.0003), turned or (0.0, 0.0, 0.0))
    top = shape.half_extents[2] if turned is None else shape.half_extents[0]
    item = CollisionObject.single(
        "item", shape, T.shifted(z=float(top)), movable=True, mass=mass, material=Material(friction)
    )
    world = SimWorld(PlanningScene.of(model, objects=[item]), PhysicsSettings(gravity=(0.0, 0.0, 0.0)))
    world.set_gripper_target(gripper.name, 0.0)
    world.step(round(0.8 / world.timestep))
    start = world.object_pose("item")
    world.mj_model.opt.gravity[:] = gravity
    world.step(round(seconds / world.timestep))
    return world, start.distance_to(world.object_pose("item"))[0]


PLATE = Box(0.2, 0.2, 0.01)
FORCE = 60e3 * np.pi * RADIUS**2  # [N] 61.07


@pytest.mark.parametrize("acceleration", (0.0, 5.0))
@pytest.mark.parametrize(("share", "holds"), [(0.97, True), (1.03, False)])
def test_the_pull_is_bounded_by_pressure_times_area(acceleration, share, holds):
    mass = share * FORCE / (G + acceleration)  # m (g + a) = share * dP A
    world, moved = held(PLATE, mass, (0.0, 0.0, G + acceleration))
    state = world.gripper_state("vacuum")
    assert (state.held == "item") == holds
    assert (moved < 2e-4) if holds else (moved > 0.05)
    assert world.welds == ()
    if holds:
        assert state.sealed == (1, 1) and state.vacuum == pytest.approx(60.0, rel=1e-3)
        assert state.force_per_finger == pytest.approx(FORCE, rel=1e-3)
        # the sensor feels the weight: the contacts push with F - W, the vacuum pulls with F
        assert world.wrench("vacuum")[2] == pytest.approx(mass * (G + acceleration), rel=0.02)


@pytest.mark.parametrize(("share", "holds"), [(0.9, True), (1.1, False)])
def test_friction_carries_the_load_along_the_surface(share, holds):
    friction = 0.5
    mass = share * friction * FORCE / G  # m g = share * mu dP A, a thin plate: no tilting moment to speak of
    _, moved = held(Box(0.2, 0.2, 0.002), mass, (G, 0.0, 0.0), friction=friction)
    assert (moved < 5e-4) == holds
    if not holds:
        assert moved > 0.01


@pytest.mark.parametrize(("share", "holds"), [(0.9, True), (1.15, False)])
def test_the_ring_carries_a_bounded_tilting_moment(share, holds):
    beside = 0.05  # [m] of the center of mass from the cup
    edge = RADIUS * np.cos(np.pi / 8)  # the ring is an octagon whose flat side faces +x
    mass = share * FORCE * edge / ((beside + edge) * G)  # m g (e + r) = share * dP A r
    world, _ = held(PLATE, mass, (0.0, 0.0, G), at=(beside, 0.0))
    assert (world.gripper_state("vacuum").held == "item") == holds


def test_two_cups_carry_twice_the_load_and_share_it():
    mass = 0.95 * 2 * FORCE / G
    world, moved = held(PLATE, mass, (0.0, 0.0, G), cups=2)
    state = world.gripper_state("vacuum")
    assert state.held == "item" and state.sealed == (2, 2) and moved < 2e-4
    world, _ = held(PLATE, mass * 1.08, (0.0, 0.0, G), cups=2)
    assert world.gripper_state("vacuum").held is None


@pytest.mark.parametrize(("radius", "seals"), [(0.120, True), (0.060, False)])
def test_a_curved_surface_leaks_beyond_the_stroke(radius, seals):
    gap = radius - np.sqrt(radius**2 - RADIUS**2)  # of a cylinder's side under the ring
    assert (gap < STROKE) == seals
    world, _ = held(Cylinder(radius, 0.2), 0.3, (0.0, 0.0, G), turned=(0.0, np.pi / 2, 0.0))
    state = world.gripper_state("vacuum")
    assert (state.held == "item") == seals
    assert state.sealed == ((1 if seals else 0), 1)


def test_a_cup_over_the_edge_leaks():
    world, _ = held(PLATE, 0.1, (0.0, 0.0, G), at=(0.1 - RADIUS / 2, 0.0))
    assert world.gripper_state("vacuum").held is None


def test_releasing_turns_the_vacuum_off():
    world, _ = held(PLATE, 1.0, (0.0, 0.0, G))
    assert world.gripper_state("vacuum").held == "item"
    world.set_gripper_target("vacuum", 0.01)
    assert world.gripper_state("vacuum").width == pytest.approx(0.01)
    world.step(100)
    state = world.gripper_state("vacuum")
    assert state.held is None and state.force_per_finger == 0.0
    assert world.object_pose("item").translation[2] > 0.15


def test_compiled_and_python_steps_agree_and_a_snapshot_repeats():
    world, _ = held(PLATE, 1.0, (0.0, 0.0, G), seconds=0.1)
    before = world.snapshot()
    assert world._stepper.compiled is not None
    world.step(50)
    compiled = world.object_pose("item")
    world.restore(before)
    world.step(50)
    assert world.object_pose("item").isclose(compiled, 0.0, 0.0)
    world.restore(before)
    world._stepper.compiled = None
    world.step(50)
    assert world.object_pose("item").isclose(compiled, 0.0, 0.0)
