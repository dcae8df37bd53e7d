"""Grasp candidates: the open fingers are around the object, and what cannot be held says why."""

from __future__ import annotations

import numpy as np
import pytest
from tests.grasping.solids import solid, surface, world_surface

from armcell.core import SE3, SO3, Box, Cylinder, Sphere, UnknownNameError
from armcell.grasping import generators, grasp_candidates, grip_force
from armcell.model import load_robot
from armcell.scene import Material

ROBOTS = ("panda", "ur10_gripper")
STANDING = SE3.from_xyz_rpy((0.5, 0.1, 0.3), (0.0, 0.0, 0.7))
LYING = SE3.from_xyz_rpy((0.5, 0.1, 0.3), (np.pi / 2, 0.0, 0.4))
SOLIDS = {
    "cube": solid(Box(0.05, 0.05, 0.05), STANDING),
    "bar": solid(Box(0.03, 0.2, 0.06), STANDING),
    "bar on its side": solid(Box(0.03, 0.2, 0.06), LYING),
    "can": solid(Cylinder(0.03, 0.12), STANDING),
    "can on its side": solid(Cylinder(0.03, 0.12), LYING),
    "ball": solid(Sphere(0.03), STANDING),
    "off its origin": solid(Box(0.04, 0.05, 0.06), STANDING, SE3.from_xyz(0.1, -0.02, 0.05)),
}


@pytest.fixture(scope="module", params=ROBOTS)
def gripper(request):
    return load_robot(request.param).gripper()


@pytest.fixture(params=SOLIDS)
def item(request):
    return SOLIDS[request.param]


def up_in(item) -> np.ndarray:
    return item.T_world_object.rotation.inv().matrix @ np.array([0.0, 0.0, 1.0])


def straddles(grasp, item) -> bool:
    """Whether the object is between the pads of the open fingers, which are on the tcp's y axis."""
    across = grasp.T_object_tcp.inv().apply(surface(item))[:, 1]
    return across.max() < grasp.opening / 2 and across.min() > -grasp.opening / 2


def test_open_fingers_are_around_the_object(item, gripper):
    grasps, _ = grasp_candidates(item, gripper)
    assert grasps
    for grasp in grasps:
        assert straddles(grasp, item), grasp.name
        assert grasp.width < grasp.opening <= gripper.max_width
        across = grasp.T_object_tcp.inv().apply(surface(item))[:, 1]
        assert grasp.width == pytest.approx(np.ptp(across), rel=0.01)


def test_frames_are_right_handed_with_the_tcp_inside_the_object(item, gripper):
    low, high = surface(item).min(0), surface(item).max(0)
    for grasp in grasp_candidates(item, gripper)[0]:
        R, at = grasp.T_object_tcp.rotation.matrix, grasp.T_object_tcp.translation
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
        assert np.all(at > low - 1e-9) and np.all(at < high + 1e-9), grasp.name


def test_fingers_reach_no_deeper_than_they_are_long(item, gripper):
    for grasp in grasp_candidates(item, gripper)[0]:
        depth = -grasp.T_object_tcp.inv().apply(surface(item))[:, 2].min()  # of the tcp below the near face
        assert depth <= gripper.finger_depth + 1e-9, grasp.name


def test_from_above_the_tips_stay_above_the_support(item, gripper):
    up, bottom = up_in(item), world_surface(item)[:, 2].min()
    grasps = grasp_candidates(item, gripper)[0]
    from_above = [g for g in grasps if g.T_object_tcp.rotation.matrix[:, 2] @ up < -0.9]
    assert from_above
    for grasp in from_above:
        T = item.T_world_object @ grasp.T_object_tcp
        tip = T.apply((0.0, 0.0, gripper.pad_depth))
        assert tip[2] > bottom, grasp.name


def test_best_first_and_from_above_at_best(item, gripper):
    grasps, _ = grasp_candidates(item, gripper)
    scores = [g.score for g in grasps]
    assert scores == sorted(scores, reverse=True)
    assert grasps[0].T_object_tcp.rotation.matrix[:, 2] @ up_in(item) == pytest.approx(-1.0)


@pytest.mark.parametrize("tilt_deg", [0, 20, 45, 70, 90])
def test_names_tell_candidates_apart(tilt_deg, gripper):
    """A pick excludes a grasp that failed by its name."""
    tilted = SE3.from_xyz_rpy((0.5, 0.0, 0.1), (np.deg2rad(tilt_deg), 0.0, 0.3))
    grasps, rejected = grasp_candidates(solid(Box(0.03, 0.04, 0.05), tilted), gripper)
    names = [g.name for g in grasps] + [r.name for r in rejected]
    assert len(names) == len(set(names))


def test_round_objects_are_held_at_more_angles_than_boxes(gripper):
    box, can = (
        {
            round(float(np.arctan2(*g.T_object_tcp.rotation.matrix[[1, 0], 1])) % np.pi, 3)
            for g in grasp_candidates(solid(shape), gripper)[0]
            if g.name.startswith("top")
        }
        for shape in (Box(0.05, 0.05, 0.05), Cylinder(0.025, 0.05))
    )
    assert len(can) > len(box)


def test_a_cylinder_turned_within_its_object_is_held_like_one_that_is_not(gripper):
    turned = solid(Cylinder(0.02, 0.07), STANDING, SE3.from_xyz_rpy((0, 0, 0), (0.0, np.pi / 2, 0.0)))
    for grasp in grasp_candidates(turned, gripper)[0]:
        assert straddles(grasp, turned), grasp.name


def test_too_wide_is_rejected_with_both_widths(gripper):
    limit = gripper.max_width
    grasps, rejected = grasp_candidates(solid(Box(limit + 0.02, 0.3, 0.25)), gripper)
    assert not grasps
    assert {f"{limit * 1000:.0f} mm" in r.reason for r in rejected} == {True}
    assert {r.reason.split(" mm")[0] for r in rejected} == {f"{limit * 1000 + 20:.0f}", "300", "250"}


def test_one_narrow_side_is_enough(gripper):
    board = solid(Box(0.4, 0.3, 0.02), LYING)  # stands on a long edge
    grasps, rejected = grasp_candidates(board, gripper)
    assert grasps and rejected
    assert {round(g.width, 6) for g in grasps} == {0.02}


@pytest.mark.parametrize("size", [0.03, 0.06])
def test_what_fits_is_not_rejected(size, gripper):
    _, rejected = grasp_candidates(solid(Box(size, size, size)), gripper)
    assert not rejected


def test_what_is_too_flat_to_be_held_above_its_support_says_so(gripper):
    grasps, rejected = grasp_candidates(solid(Box(0.04, 0.04, 0.01), STANDING), gripper)
    assert {r.reason for r in rejected if r.name.startswith("top")} == {
        "10 mm is too flat for the finger tips"
    }
    assert not any(g.name.startswith("top") for g in grasps)


def test_unknown_generator_names_the_known(gripper):
    with pytest.raises(UnknownNameError, match="bounding_box"):
        grasp_candidates(SOLIDS["cube"], gripper, "bounding_bix")
    assert "bounding_box" in generators


# --- force ---
def held(mass: float, friction: float):
    return solid(Box(0.05, 0.05, 0.05), mass=mass, material=Material(friction))


def test_force_grows_with_mass_and_falls_with_friction(gripper):
    by_mass = [grip_force(held(m, 0.6), gripper) for m in np.linspace(0.01, 5.0, 40)]
    by_friction = [grip_force(held(0.6, mu), gripper) for mu in np.linspace(0.1, 1.5, 40)]
    assert by_mass == sorted(by_mass) and by_mass[0] < by_mass[-1]
    assert by_friction == sorted(by_friction, reverse=True) and by_friction[-1] < by_friction[0]


@pytest.mark.parametrize("mass", [1e-4, 0.1, 1.0, 100.0])
@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0])
def test_force_is_what_the_gripper_can_do_and_holds_the_weight_if_it_can(mass, friction, gripper):
    force = grip_force(held(mass, friction), gripper)
    assert 0 < force <= gripper.max_force
    if force < gripper.max_force:  # two pads, Coulomb
        assert 2 * max(friction, 0.05) * force > mass * 9.81


def test_candidates_carry_that_force(item, gripper):
    assert {g.force for g in grasp_candidates(item, gripper)[0]} == {grip_force(item, gripper)}


def test_turning_the_object_turns_the_grasps_with_it(gripper):
    """The best grasp in the world does not depend on how the object's own frame lies in it."""
    cube = Box(0.05, 0.05, 0.05)
    for turn in (SO3.exp((0.0, 0.0, np.pi / 2)), SO3.exp((np.pi / 2, 0.0, 0.0))):
        pose = SE3(turn, np.array([0.4, 0.0, 0.1]))
        best = grasp_candidates(solid(cube, pose), gripper)[0][0]
        T = pose @ best.T_object_tcp
        np.testing.assert_allclose(T.rotation.matrix[:, 2], (0, 0, -1), atol=1e-12)
        np.testing.assert_allclose(T.translation[:2], pose.translation[:2], atol=1e-12)
