"""How things stand, against MuJoCo: what is said to be a rest stays, and stacks stay where they are put."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.grasping.solids import solid

from armcell.core import SE3, SO3, Box, Cylinder, InputError, PointCloud, Sphere
from armcell.grasping import place_candidates, resting_now, stable_poses
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene, library_object
from armcell.sim import SimWorld


def settles(items: list[CollisionObject], seconds: float = 1.0) -> list[tuple[float, float]]:
    """How far each of some objects moves and turns when physics has its way [m, rad]."""
    floor = CollisionObject.single("floor", Box(2, 2, 0.1), SE3.from_xyz(1.5, 0, -0.05))
    scene = PlanningScene.of(load_robot("parallel_gripper"), objects=[floor, *items])
    world = SimWorld(scene)
    world.step(int(seconds / world.timestep))
    return [item.T_world_object.distance_to(world.object_pose(item.name)) for item in items]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["box", "can", "bottle", "mug", "l_bracket", "bolt"])
def test_an_object_stays_on_each_side_it_is_said_to_stand_on(kind):
    item = library_object(kind)
    firm = [r for r in stable_poses(item) if r.margin > 0.004]
    assert firm and firm[0].margin == max(r.margin for r in firm)
    standing = [
        replace(item, name=f"{kind}{i}").at(
            SE3(SO3.between(r.up, (0, 0, 1)), np.array([1.0 + 0.25 * i, 0.3, r.height]))
        )
        for i, r in enumerate(firm[:4])
    ]
    for moved, turned in settles(standing):
        assert moved < 0.003 and turned < 0.03


def test_a_box_has_six_sides_and_a_needle_does_not_stand_on_its_end():
    assert len(stable_poses(solid(Box(0.1, 0.06, 0.02)))) == 6
    margins = sorted(r.margin for r in stable_poses(solid(Box(0.1, 0.06, 0.02))))
    assert margins == pytest.approx([0.01] * 4 + [0.03] * 2)
    ends = [r for r in stable_poses(solid(Cylinder(0.002, 0.2))) if abs(r.up[2]) > 0.9]
    assert all(r.margin < 0.0021 for r in ends)


def test_round_things_keep_their_turn():
    lying = solid(Cylinder(0.02, 0.1), SE3.from_xyz_rpy((0, 0, 0), (np.pi / 2, 0.05, 0.3)))
    rest = resting_now(lying)
    assert rest.up[2] == pytest.approx(0.0, abs=1e-12) and rest.height == pytest.approx(0.02)
    ball = resting_now(solid(Sphere(0.03), SE3.from_xyz_rpy((0, 0, 0), (0.3, 0.2, 0.1))))
    assert ball.height == pytest.approx(0.03) and ball.margin == 0.0


def test_a_tilted_object_is_set_down_flat():
    box = solid(Box(0.05, 0.06, 0.07), SE3.from_xyz_rpy((0, 0, 0.5), (0.1, -0.07, 0.4)))
    table = CollisionObject.single("table", Box(0.3, 0.3, 0.1))
    best = place_candidates(box, table)[0].T_world_object
    np.testing.assert_allclose(best.rotation.matrix[2], (0, 0, 1), atol=1e-9)
    assert best.translation[2] == pytest.approx(0.05 + 0.035)


def test_stacked_larger_on_smaller_stays_and_what_would_fall_is_not_offered():
    low = library_object("box", "low", SE3.from_xyz(1.2, 0.2, 0.0))  # 60 x 40 mm on top
    top = CollisionObject.single("top", Box(0.09, 0.05, 0.03), SE3.from_xyz(0, 0, 1.0), movable=True)
    placed = place_candidates(top, low)
    assert placed
    stack = [low, top.at(placed[0].T_world_object.shifted(z=5e-4))]
    for moved, turned in settles(stack, 2.0):
        assert moved < 0.004 and turned < 0.03
    lopsided = CollisionObject(
        "hammer",
        ((Box(0.2, 0.02, 0.02), SE3.identity()), (Box(0.02, 0.06, 0.06), SE3.from_xyz(0.11, 0, 0.02))),
        SE3.from_xyz(0, 0, 1.0), movable=True,
    )  # fmt: skip
    post = CollisionObject.single("post", Box(0.03, 0.03, 0.2))
    with pytest.raises(InputError, match="does not fit on 'post'"):
        place_candidates(lopsided, post)


def test_free_places_and_other_sides():
    box, table = library_object("box"), CollisionObject.single("table", Box(0.5, 0.4, 0.1))
    here = place_candidates(box, table, at=(0.0, 0.0))
    everywhere = place_candidates(box, table)
    far = [np.abs(p.T_world_object.translation[:2]).max() for p in everywhere]
    assert len(everywhere) > len(here) and max(far) > 0.15
    sides = place_candidates(box, table, other_sides=True)
    ups = {tuple(np.round(p.T_world_object.rotation.matrix[2], 3) + 0.0) for p in sides}
    assert len(ups) == 6 and sides[0].name == everywhere[0].name


def test_the_top_of_a_mesh_is_a_place():
    import trimesh

    from armcell.core import Mesh

    mesh = trimesh.creation.box((0.2, 0.3, 0.1))
    block = CollisionObject.single(
        "block", Mesh(mesh.vertices, mesh.faces.astype(np.int32)), SE3.from_xyz(0.5, 0.1, 0.2)
    )
    best = place_candidates(library_object("can"), block)[0]
    np.testing.assert_allclose(best.T_world_object.translation, (0.5, 0.1, 0.25), atol=1e-6)


def test_a_cloud_of_one_flat_side_stands_on_none_that_was_seen():
    flat = (
        np.stack(np.meshgrid(np.arange(20), np.arange(20), [0.0], indexing="ij"), -1).reshape(-1, 3) * 0.003
    )
    item = CollisionObject.single("seen", PointCloud(flat, 0.004))
    assert stable_poses(item) == () and resting_now(item) is None
