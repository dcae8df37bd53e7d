"""Place candidates: the object stands on the surface, inside its edges, as upright as it is."""

from __future__ import annotations

import numpy as np
import pytest
from tests.grasping.solids import solid, world_surface

from armcell.core import SE3, Box, Cylinder, InputError, Sphere
from armcell.grasping import place_candidates, placement_axis, rotated_placement, support_surface
from armcell.scene import CollisionObject

TURNED = SE3.from_xyz_rpy((0.4, -0.2, 0.15), (0.0, 0.0, 0.5))
INNER = 0.24  # [m] between the tray's walls
TRAY = CollisionObject(
    "tray",
    (
        (Box(INNER, INNER, 0.01), SE3.from_xyz(0, 0, 0.005)),
        (Box(INNER, 0.01, 0.04), SE3.from_xyz(0, INNER / 2 + 0.005, 0.02)),
        (Box(0.01, INNER, 0.04), SE3.from_xyz(INNER / 2 + 0.005, 0, 0.02)),
    ),
    TURNED,
)
# name: support, height of its surface above its origin [m], whether points of its frame are inside its edges
SUPPORTS = {
    "table": (
        CollisionObject.single("table", Box(0.8, 0.6, 0.04), TURNED), 0.02,
        lambda p: np.all(np.abs(p[:, :2]) < (0.4, 0.3)),
    ),
    "tray": (TRAY, 0.01, lambda p: np.all(np.abs(p[:, :2]) < INNER / 2)),
    "post": (
        CollisionObject.single("post", Cylinder(0.09, 0.2), TURNED), 0.1,
        lambda p: np.all(np.hypot(p[:, 0], p[:, 1]) < 0.09),
    ),
}  # fmt: skip
ITEMS = {
    "cube": solid(Box(0.05, 0.05, 0.05), SE3.from_xyz_rpy((1, 1, 1), (0, 0, 0.3))),
    "slab": solid(Box(0.03, 0.08, 0.02), SE3.from_xyz_rpy((1, 1, 1), (0, 0, 1.0))),
    "slab on edge": solid(Box(0.03, 0.08, 0.02), SE3.from_xyz_rpy((1, 1, 1), (np.pi / 2, 0, 0))),
    "can upside down": solid(Cylinder(0.02, 0.1), SE3.from_xyz_rpy((1, 1, 1), (np.pi, 0, 0))),
    "ball": solid(Sphere(0.03), SE3.from_xyz(1, 1, 1)),
    "off its origin": solid(Box(0.04, 0.04, 0.06), SE3.from_xyz(1, 1, 1), SE3.from_xyz(0, 0, 0.03)),
}


@pytest.fixture(params=SUPPORTS)
def on(request):
    return SUPPORTS[request.param]


@pytest.fixture(params=ITEMS)
def item(request):
    return ITEMS[request.param]


@pytest.mark.slow
@pytest.mark.cases("*-tray")
def test_the_bottom_lies_on_the_surface_inside_the_edges(item, on):
    support, height, inside = on
    surface_z = support.T_world_object.translation[2] + height
    placements = place_candidates(item, support)
    assert placements
    for placement in placements:
        points = world_surface(item, placement.T_world_object)
        assert points[:, 2].min() == pytest.approx(surface_z, abs=1e-6), placement.name
        assert inside(support.T_world_object.inverse().apply(points)), placement.name


def test_the_object_keeps_its_upright_axis(item, on):
    """What was up stays up: the arm may turn the object about the vertical only."""
    up_before = item.T_world_object.rotation.matrix[2]
    for placement in place_candidates(item, on[0]):
        np.testing.assert_allclose(placement.T_world_object.rotation.matrix[2], up_before, atol=1e-9)


def test_best_first_from_the_middle_on(item, on):
    support, _, _ = on
    placements = place_candidates(item, support)
    scores = [p.score for p in placements]
    assert scores == sorted(scores, reverse=True)
    middle = support.T_world_object.inverse().apply(placements[0].T_world_object.translation)
    np.testing.assert_allclose(middle[:2], 0.0, atol=1e-9)
    assert len({p.name for p in placements}) == len(placements)


@pytest.mark.parametrize("at", [None, (0.1, -0.05)])
def test_three_by_three_around_the_point(at):
    step = 0.03
    placements = place_candidates(ITEMS["cube"], SUPPORTS["table"][0], at, step)
    T_support_world = SUPPORTS["table"][0].T_world_object.inverse()
    spots = {tuple(T_support_world.apply(p.T_world_object.translation)[:2].round(6)) for p in placements}
    x, y = at or (0.0, 0.0)
    grid = {(round(x + i * step, 6), round(y + k * step, 6)) for i in (-1, 0, 1) for k in (-1, 0, 1)}
    assert spots >= grid and (spots == grid) == (at is not None)  # with no point asked for, also elsewhere


def test_the_first_turn_is_the_smallest_to_the_support_s_axes():
    cube, table = ITEMS["cube"], SUPPORTS["table"][0]
    best = place_candidates(cube, table)[0].T_world_object
    relative = table.T_world_object.rotation.inverse() @ best.rotation
    assert np.abs(relative.matrix).round(9).tolist() == np.eye(3).tolist()  # in line with the table
    turned = (cube.T_world_object.rotation.inverse() @ best.rotation).log()
    assert np.linalg.norm(turned) <= np.pi / 4 + 1e-9


@pytest.mark.parametrize("flip", [(np.pi, 0, 0), (np.pi / 2, 0, 0), (0, -np.pi / 2, 0)])
def test_the_surface_is_on_top_however_the_box_lies(flip):
    box = CollisionObject.single("box", Box(0.2, 0.3, 0.4), SE3.from_xyz_rpy((0, 0, 1), flip))
    frame, size_x, size_y = support_surface(box)
    top = world_surface(box)
    assert frame.translation[2] == pytest.approx(top[:, 2].max())
    np.testing.assert_allclose(frame.rotation.matrix[:, 2], (0, 0, 1), atol=1e-9)
    local = frame.inverse().apply(top)
    np.testing.assert_allclose((np.ptp(local[:, 0]), np.ptp(local[:, 1])), (size_x, size_y), atol=1e-9)


@pytest.mark.parametrize(
    "support",
    [
        CollisionObject.single("thing", Box(0.4, 0.4, 0.1), SE3.from_xyz_rpy((0, 0, 0), (0.6, 0, 0))),
        CollisionObject.single("thing", Cylinder(0.2, 0.4), SE3.from_xyz_rpy((0, 0, 0), (np.pi / 2, 0, 0))),
        CollisionObject.single("thing", Sphere(0.3)),
    ],
    ids=["steep box", "lying cylinder", "ball"],
)
def test_no_flat_top(support):
    with pytest.raises(InputError, match=r"'thing' has no flat surface on top"):
        place_candidates(ITEMS["cube"], support)


def test_too_large_says_which_and_how_large_the_surface_is():
    large = solid(Box(0.3, 0.3, 0.1))
    with pytest.raises(InputError, match=r"'item' does not fit on 'tray'.*240 x 240 mm"):
        place_candidates(large, TRAY)


def test_a_point_beyond_the_edge_is_refused():
    with pytest.raises(InputError, match="'tray'"):
        place_candidates(ITEMS["cube"], TRAY, at=(0.2, 0.0))


def test_near_an_edge_only_what_stays_on_is_offered():
    placements = place_candidates(ITEMS["cube"], TRAY, at=(0.09, 0.0), step=0.02)
    xs = {round(float(TURNED.inverse().apply(p.T_world_object.translation)[0]), 3) for p in placements}
    assert xs == {0.07, 0.09}


def test_an_object_beside_its_origin_stays_inside_the_edges():
    beside = solid(Box(0.05, 0.05, 0.05), SE3.from_xyz(1, 1, 1), SE3.from_xyz(0.12, 0, 0))
    for placement in place_candidates(beside, TRAY):
        points = TURNED.inverse().apply(world_surface(beside, placement.T_world_object))
        assert np.abs(points[:, :2]).max() < INNER / 2, placement.name


@pytest.mark.slow
@pytest.mark.cases("cube-tray", "slab-tray", "off its origin-tray")
def test_a_turned_placement_keeps_its_center_and_stays_inside_the_edges(item, on):
    support, height, inside = on
    surface_z = support.T_world_object.translation[2] + height
    kept = 0
    for placement in place_candidates(item, support):
        for angle in (0.4, -2.0):
            other = rotated_placement(item, support, placement, angle)
            if other is None:
                continue
            kept += 1
            axis = placement_axis(item, placement)
            in_axis = [axis.inverse() @ p.T_world_object for p in (placement, other)]
            turn = (in_axis[1] @ in_axis[0].inverse()).rotation.log()
            np.testing.assert_allclose(turn, [0, 0, angle], atol=1e-9)
            points = world_surface(item, other.T_world_object)
            assert points[:, 2].min() == pytest.approx(surface_z, abs=1e-6)
            assert inside(support.T_world_object.inverse().apply(points))
    assert kept > 0


def test_a_placement_whose_corners_would_leave_the_support_is_not_turned():
    cube, post = solid(Box(0.04, 0.04, 0.04)), CollisionObject.single("post", Box(0.06, 0.06, 0.1), TURNED)
    straight = place_candidates(cube, post)[0]
    assert rotated_placement(cube, post, straight, np.pi / 4) is None
    assert rotated_placement(cube, post, straight, np.pi / 2) is not None
