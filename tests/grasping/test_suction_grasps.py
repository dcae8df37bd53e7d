"""Suction grasps: the seal is a gap that rays measure, and the load must stay below the formula's limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import armcell
from armcell.core import SE3, Box, Cylinder, Mesh, Sphere
from armcell.grasping import generators, grasp_candidates, grasp_quality, hand_of, nearest_miss
from armcell.grasping.suction import CORNER, REACH, RIM, STANDOFF
from armcell.model import SuctionGripper
from armcell.scene import CollisionObject, Material, library_object

G, A = 9.81, 3.0  # [m/s^2] gravity, assumed acceleration


@pytest.fixture(scope="module")
def hand():
    model = armcell.load_robot("ur10_suction")
    return hand_of(model, model.gripper())


@pytest.fixture(scope="module")
def gripper(hand) -> SuctionGripper:
    return hand.gripper


def item(shape, mass=0.3, pose=None, friction=0.5):
    pose = pose or SE3.from_xyz(0.0, 0.0, float(shape.half_extents[2]))
    return CollisionObject.single("item", shape, pose, movable=True, mass=mass, material=Material(friction))


def miss(rejected) -> str:
    found = nearest_miss(rejected)
    assert found is not None
    return found.reason


def test_it_is_the_default_generator_of_a_suction_gripper_only(hand):
    panda = armcell.load_robot("panda")
    assert "suction" in generators
    cube = item(Box(0.06, 0.06, 0.06))
    assert all(not grasp.width for grasp in grasp_candidates(cube, hand)[0])
    assert all(grasp.width for grasp in grasp_candidates(cube, hand_of(panda, panda.gripper()))[0])


@pytest.mark.slow
def test_every_cup_of_a_grasp_is_inside_a_face_and_the_hand_outside_the_object(hand, gripper):
    size = np.array([0.16, 0.12, 0.10])
    grasps, _ = grasp_candidates(item(Box(*size)), hand)
    assert grasps and max(len(grasp.contacts) for grasp in grasps) == 2
    reach = gripper.cups[0].radius + RIM
    for grasp in grasps:
        z = grasp.T_object_tcp.rotation.matrix[:, 2]
        face = int(np.argmax(np.abs(z)))
        assert abs(z[face]) == pytest.approx(1.0)
        across = [k for k in range(3) if k != face]
        for contact in grasp.contacts:
            at = grasp.T_object_tcp.apply(contact.point)
            assert np.all(np.abs(at[across]) <= size[across] / 2 - reach + 1e-9), grasp.name
            standoff = STANDOFF * gripper.cups[0].stroke
            assert abs(at[face]) == pytest.approx(size[face] / 2 + standoff, abs=1e-6)
        assert not grasp_quality(
            item(Box(*size)), grasp
        ).force_closure  # the vacuum holds, not opposed contacts


@pytest.mark.slow
@pytest.mark.cases("0.8")
@pytest.mark.parametrize("share", (0.8, 1.25))
def test_a_cylinder_s_side_seals_while_the_lip_closes_the_gap(hand, gripper, share):
    ring, limit = gripper.cups[0].radius + RIM, REACH * gripper.cups[0].stroke
    gap = share * limit
    radius = (ring**2 + gap**2) / (2 * gap)  # the gap of a ring on a cylinder is R - sqrt(R^2 - r^2)
    lying = SE3.from_xyz_rpy((0.0, 0.0, radius), (np.pi / 2, 0.0, 0.0))
    segments = Mesh(*_cylinder(radius, 0.3))
    grasps, rejected = grasp_candidates(item(segments, pose=lying), hand)
    on_side = [g for g in grasps if abs(g.T_object_tcp.rotation.matrix[2, 2]) < 0.1]
    assert bool(on_side) == (share < 1)
    leaks = [r.reason for r in rejected if r.reason.startswith("leaks: the surface is up to")]
    assert leaks


def _cylinder(radius: float, length: float):
    import trimesh

    made = trimesh.creation.cylinder(radius, length, sections=720)
    return np.array(made.vertices), np.array(made.faces, dtype=np.int32)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "refused"), [(0.98, False), (1.02, True)])
def test_the_load_with_its_safety_factor_must_stay_below_the_vacuum(hand, gripper, share, refused):
    force = sum(map(gripper.force, gripper.cups))
    mass = share * force / (gripper.safety * (G + A))
    grasps, rejected = grasp_candidates(item(Box(0.2, 0.2, 0.05), mass), hand)
    assert bool(grasps) != refused
    if refused:
        needed = gripper.safety * mass * (G + A)
        assert f"needs {needed:.0f} N, 2 times the load of {mass * (G + A):.0f} N" in miss(rejected)
        assert f"the vacuum of 2 cups pulls {force:.0f} N" in miss(rejected)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "refused"), [(0.95, False), (1.05, True)])
def test_a_side_grasp_needs_friction(hand, gripper, share, refused):
    force, friction = sum(map(gripper.force, gripper.cups)), 0.4
    mass = share * friction * force / (gripper.safety * (G + A))
    board = item(Box(0.2, 0.012, 0.2), mass, friction=friction)
    side = [g for g in grasp_candidates(board, hand)[0] if abs(g.T_object_tcp.rotation.matrix[1, 2]) > 0.9]
    assert any(len(g.contacts) == 2 for g in side) != refused


def test_the_load_must_act_inside_the_hull_of_the_rings(hand, gripper):
    """One cup, level: S W (e + r) <= F r, with the octagon that physics has."""
    radius, force, mass = CORNER * gripper.cups[0].radius, gripper.force(gripper.cups[0]), 0.8
    load = gripper.safety * mass * (G + A)
    limit = radius * (force - load) / load
    single = replace(gripper, cups=gripper.cups[:1])
    alone = replace(hand, gripper=single, cups=hand.cups[:1])
    grasps, rejected = grasp_candidates(item(Box(0.15, 0.15, 0.02), mass), alone)
    levers = [np.linalg.norm(g.T_object_tcp.apply(alone.cups[0])[:2]) for g in grasps]
    assert 0.5 * limit < max(levers) <= limit + 1e-9
    tilts = [r.reason for r in rejected if r.reason.startswith("tilts off")]
    assert tilts and all(int(t.split(" mm")[0].split()[-1]) >= 1000 * limit - 1 for t in tilts)


@pytest.mark.slow
def test_what_cannot_be_held_is_refused_with_the_nearest_miss(hand):
    assert "into the cup" in str([r.reason for r in grasp_candidates(item(Sphere(0.045)), hand)[1]])
    for shape, reason in ((Sphere(0.045), "leaks"), (Box(0.03, 0.03, 0.03), "every cup is over an edge")):
        grasps, rejected = grasp_candidates(item(shape), hand)
        assert not grasps and miss(rejected).startswith(reason)
    assert not grasp_candidates(library_object("mug"), hand)[0]  # a hollow rim
    assert grasp_candidates(library_object("can"), hand)[0]


def test_a_hole_under_a_cup_leaks(hand):
    frame = [(Box(0.06, 0.2, 0.01), SE3.from_xyz(s * 0.035, 0, 0)) for s in (-1, 1)]  # a slit of 10 mm
    slit = CollisionObject("slit", tuple(frame), SE3.from_xyz(0, 0, 0.005), movable=True, mass=0.2)
    for grasp in grasp_candidates(slit, hand)[0]:
        for contact in grasp.contacts:
            assert abs(grasp.T_object_tcp.apply(contact.point)[0]) > 0.005 + 0.018, grasp.name


@pytest.mark.long
def test_the_result_does_not_depend_on_earlier_calls(hand):
    box = item(Box(0.1, 0.09, 0.08))
    first = [(g.name, g.score) for g in grasp_candidates(box, hand)[0]]
    grasp_candidates(item(Cylinder(0.05, 0.1)), hand)
    assert [(g.name, g.score) for g in grasp_candidates(box, hand)[0]] == first
