"""Places on tilted supports, against MuJoCo: what is offered stays, what is refused slides or topples."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh
from tests.grasping.solids import solid, world_surface

from armcell.core import SE3, SO3, Box, Cylinder, InputError, Mesh
from armcell.grasping import (
    FRICTION_MARGIN,
    RELEASE_GAP,
    pair_friction,
    place_candidates,
    support_surface,
    tilt_of,
)
from armcell.model import load_robot
from armcell.scene import CollisionObject, Material, PlanningScene, library_object
from armcell.sim import SimWorld

LIMIT = np.degrees(np.arctan(0.8 / FRICTION_MARGIN))  # of the usual material


def board(degrees: float, about: float = 0.3, **properties) -> CollisionObject:
    """A board that leans to a side [rad] of the world's x axis."""
    lean = SO3.exp((0, 0, about)) @ SO3.exp((0, np.radians(degrees), 0))
    pose = SE3(lean @ SO3.exp((0, 0, 0.4)), np.array([1.5, 0.2, 0.5]))
    return CollisionObject.single("board", Box(0.5, 0.4, 0.02), pose, **properties)


def item(size=(0.05, 0.06, 0.04), friction: float = 0.8) -> CollisionObject:
    """Held turned and a little askew, as by a hand."""
    pose = SE3.from_xyz_rpy((0.0, 0.0, 1.5), (0.05, -0.03, 0.7))
    return CollisionObject.single("item", Box(*size), pose, movable=True, material=Material(friction))


def after(items: list[CollisionObject], seconds: float = 5.0) -> tuple[float, float]:
    """How far the last of some objects moves and turns in physics [m, rad]."""
    world = SimWorld(PlanningScene.of(load_robot("parallel_gripper"), objects=items))
    world.step(int(seconds / world.timestep))
    return items[-1].T_world_object.distance_to(world.object_pose(items[-1].name))


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [5, 12, 20, 27])
def test_what_is_put_on_a_board_that_leans_less_than_friction_holds_stays(degrees):
    support = board(degrees)
    for placement in place_candidates(item(), support)[:3]:
        moved, turned = after([support, item().at(placement.above(RELEASE_GAP))])
        assert moved < 0.01 and turned < 0.03, (placement.name, moved, turned)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.15, 0.4, 1.0])
def test_the_limit_is_that_of_the_friction_with_its_margin(friction):
    limit = np.degrees(np.arctan(friction / FRICTION_MARGIN))
    flat = item((0.06, 0.06, 0.02), friction)
    on = board(limit - 0.5)
    best = place_candidates(flat, on)[0]
    assert after([on, flat.at(best.above(RELEASE_GAP))])[0] < 0.01
    with pytest.raises(InputError) as error:
        place_candidates(flat, board(limit + 0.5))
    assert f"leans by {limit + 0.5:.1f} degrees" in str(error.value) and f"{limit:.1f}" in str(error.value)
    assert "friction" in error.value.hint
    # Put there by force where friction alone, without a margin, is too little: it slides.
    steep = board(np.degrees(np.arctan(friction)) + 3)
    forced = replace(flat, material=Material(10.0))
    at = place_candidates(forced, steep)[0].above(RELEASE_GAP)
    assert after([steep, flat.at(at)], 2.0)[0] > 0.02


def test_it_stands_flat_on_the_surface_inside_its_edges():
    support = board(20)
    frame, size_x, size_y = support_surface(support, np.radians(25))
    assert np.degrees(tilt_of(frame)) == pytest.approx(20)
    corner = support.T_world_object.apply(np.array([0.25, 0.2, 0.01]))
    np.testing.assert_allclose(np.abs(frame.inverse().apply(corner)), (0.25, 0.2, 0.0), atol=1e-9)
    assert (size_x, size_y) == pytest.approx((0.5, 0.4))
    placements = place_candidates(item(), support)
    assert len(placements) > 20
    for placement in placements:
        points = support.T_world_object.inverse().apply(world_surface(item(), placement.T_world_object))
        assert points[:, 2].min() == pytest.approx(0.01, abs=1e-6)
        assert np.all(np.abs(points[:, :2]) < (0.25, 0.2)), placement.name
        np.testing.assert_allclose(placement.normal, support.T_world_object.rotation.matrix[:, 2], atol=1e-9)


def test_the_side_that_was_up_is_along_the_normal_and_the_turn_is_kept():
    support, held = board(15), item()
    for placement in place_candidates(held, support):
        up = placement.T_world_object.rotation.matrix[:, 2]
        assert up @ placement.normal == pytest.approx(1.0)
    least = min(
        p.T_world_object.distance_to(replace(held.T_world_object, translation=p.T_world_object.translation))[
            1
        ]
        for p in place_candidates(held, support)
    )
    assert least < np.radians(15) + 0.08  # the lean of the board, and that of the hand


def test_the_plumb_line_decides_not_the_normal():
    """A tower stands on a level board and would topple on a tilted one, however rough."""
    tower = item((0.05, 0.05, 0.3), friction=5.0)
    assert place_candidates(tower, board(0))
    with pytest.raises(InputError) as error:
        place_candidates(tower, board(15))
    assert "would topple" in str(error.value) and "leans by 15.0 degrees" in str(error.value)
    assert "level" in error.value.hint
    # 25 mm to an edge, less 4 mm, from 150 mm up; at 45 degrees, over a corner, it would be farther
    said = float(str(error.value).split("stands up to ")[1].split(",")[0])
    low, high = (np.degrees(np.arctan(reach / 0.150)) for reach in (0.021, 0.021 * np.sqrt(2)))
    assert low - 0.06 <= said <= high + 0.06
    assert place_candidates(tower, board(said - 0.1))


@pytest.mark.slow
@pytest.mark.parametrize("height, stands", [(0.10, True), (0.16, False)])
def test_what_is_said_to_topple_topples(height, stands):
    tower, support = item((0.05, 0.05, height), friction=3.0), board(20)
    if stands:
        best = place_candidates(tower, support)[0]
        assert after([support, tower.at(best.above(RELEASE_GAP))])[1] < 0.05
        return
    with pytest.raises(InputError, match="would topple"):
        place_candidates(tower, support)
    flat = place_candidates(item((0.05, 0.05, 0.02), 3.0), support)[0]
    on_its_foot = flat.T_world_object @ SE3.from_xyz(0, 0, height / 2 - 0.01)
    assert after([support, tower.at(on_its_foot)], 2.0)[1] > 0.5


def test_round_things_are_not_left_to_roll():
    can = CollisionObject.single(
        "can", Cylinder(0.03, 0.1), SE3.from_xyz_rpy((0, 0, 1), (np.pi / 2, 0, 0)), movable=True
    )
    with pytest.raises(InputError, match="would topple"):
        place_candidates(can, board(8))
    upright = can.at(SE3.from_xyz(0, 0, 1))
    assert place_candidates(upright, board(8))


def test_the_friction_of_a_pair_is_that_of_mujoco():
    slab, fixed = item(friction=0.5), board(10, material=Material(0.9))
    loose = board(10, material=Material(0.9), movable=True)
    for support in (fixed, loose):
        near = slab.at(place_candidates(slab, support)[0].above(-1e-4))
        world = SimWorld(PlanningScene.of(load_robot("parallel_gripper"), objects=[support, near]))
        mujoco.mj_forward(world.mj_model, world.mj_data)
        contacts = [c for c in world.mj_data.contact if c.dist < 0]
        assert contacts and contacts[0].friction[0] == pytest.approx(pair_friction(slab, support))
    assert pair_friction(slab, fixed) == 0.5 and pair_friction(slab, loose) == 0.9


def test_a_mesh_that_leans_is_a_support_as_the_box_is():
    block = trimesh.creation.box((0.5, 0.4, 0.02))
    mesh = Mesh(block.vertices, block.faces.astype(np.int32))
    for degrees in (6, 20):
        box = board(degrees)
        same = CollisionObject.single("board", mesh, box.T_world_object)
        frame, *_ = support_surface(same, 0.5)
        assert np.degrees(tilt_of(frame)) == pytest.approx(degrees, abs=1e-4)
    lying = CollisionObject.single("board", mesh, SE3.from_xyz_rpy((1, 0, 0.4), (np.radians(20), 0, 0)))
    frame, size_x, size_y = support_surface(lying, 0.5)
    assert sorted((size_x, size_y)) == pytest.approx([0.4, 0.5], abs=1e-6)
    np.testing.assert_allclose(
        frame.translation, lying.T_world_object.apply(np.array([0, 0, 0.01])), atol=1e-6
    )


def test_a_level_surface_is_taken_before_a_larger_tilted_one():
    wedge = CollisionObject(
        "wedge",
        (
            (Box(0.5, 0.5, 0.02), SE3.from_xyz_rpy((0, 0, 0.2), (0.3, 0, 0))),
            (Box(0.2, 0.2, 0.02), SE3.from_xyz(0.5, 0, 0.2)),
        ),
    )
    frame, size_x, _ = support_surface(wedge, 0.5)
    assert size_x == pytest.approx(0.2) and tilt_of(frame) == 0.0
    with pytest.raises(InputError, match="level: it leans by 20.0 degrees"):
        support_surface(board(20))


def test_a_box_from_the_library_can_be_put_on_any_of_its_sides_there():
    thing, support = library_object("box"), board(10)
    sides = place_candidates(thing, support, other_sides=True)
    ups = {tuple(np.round(np.array(p.normal) @ p.T_world_object.rotation.matrix, 3) + 0.0) for p in sides}
    assert len(ups) == 6


def test_at_the_limit_of_friction():
    slab = solid(Box(0.03, 0.08, 0.02))
    assert place_candidates(slab, board(LIMIT - 0.1))
    with pytest.raises(InputError, match="no flat surface on top that holds"):
        place_candidates(slab, board(LIMIT + 0.1))
