"""Points of the robot taken out of a cloud, against signed distances to the links' own meshes."""

from __future__ import annotations

import coal
import numpy as np
import pytest
import trimesh
from tests.collision.reference import is_inside, signed_distance, triangles
from tests.model.helpers import random_positions
from tests.scene.helpers import box, mesh_of, panda, ur10

from armcell.collision.self_filter import object_mask, remove_robot_points, robot_mask
from armcell.core import SE3, Box, Capsule, Cone, Cylinder, InputError, Mesh, PointCloud, Sphere
from armcell.kinematics import kinematic_tree
from armcell.scene import CollisionObject, PlanningScene


def link_surfaces(scene: PlanningScene) -> list[trimesh.Trimesh]:
    """The links' collision meshes where they are, as they come from their files."""
    tree, found = kinematic_tree(scene.model), []
    Ts = tree.link_transforms(scene.positions)
    for link in scene.model.links.values():
        for c in link.collisions:
            match c.shape:
                case Mesh():
                    surface = trimesh.Trimesh(c.shape.vertices, c.shape.faces, process=True)
                case Box(x, y, z):
                    surface = trimesh.creation.box((x, y, z))
                case Cylinder(r, length):
                    surface = trimesh.creation.cylinder(r, length)
                case other:
                    raise NotImplementedError(other)
            found.append(surface.apply_transform(Ts[tree.link_index[link.name]] @ c.T_link_shape.matrix))
    return found


@pytest.mark.slow
@pytest.mark.cases("ur10-0.02")
@pytest.mark.parametrize("padding", [0.0, 0.02])
@pytest.mark.parametrize("robot", [panda, ur10])
def test_the_robots_own_points(robot, padding):
    scene = robot()
    scene = scene.with_positions(random_positions(scene.model, np.random.default_rng(0)))
    surfaces = link_surfaces(scene)
    seen = np.vstack([s.sample(150, seed=i) for i, s in enumerate(surfaces)])
    assert robot_mask(scene, seen, max(padding, 1e-6)).all()  # nothing of the robot stays
    rng = np.random.default_rng(1)
    around = seen + rng.normal(size=seen.shape) * 0.06
    # Farther from every hull than the padding reaches at a corner: certainly no part of the robot.
    to_hulls = np.min([distances(s.convex_hull, around) for s in surfaces], axis=0)
    beyond = to_hulls > np.sqrt(3) * padding + 1e-4
    inside = np.min([distances(s, around) for s in surfaces], axis=0) < padding - 1e-4
    mask = robot_mask(scene, around, padding)
    assert beyond.sum() > 300 and inside.sum() > 100
    assert not mask[beyond].any() and mask[inside].all()


def distances(surface: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Of points to a mesh as coal has them, negative inside."""
    bvh, point, request = (
        triangles(surface.vertices, surface.faces),
        coal.Sphere(1e-6),
        coal.DistanceRequest(),
    )
    here, out = coal.Transform3s(), []
    for p in points:
        there, result = coal.Transform3s(np.eye(3), p), coal.DistanceResult()
        out.append(coal.distance(bvh, here, point, there, request, result))
    found = np.maximum(out, 0.0)
    boxed = np.all((points >= surface.bounds[0]) & (points <= surface.bounds[1]), axis=1)
    for i in np.flatnonzero(boxed & surface.is_watertight):
        if is_inside(points[i], surface.vertices, surface.faces):
            found[i] *= -1
    return found


SHAPES = [Box(0.2, 0.1, 0.3), Sphere(0.1), Cylinder(0.1, 0.3), Capsule(0.08, 0.2), Cone(0.15, 0.3),
          mesh_of(trimesh.creation.box((0.2, 0.1, 0.3)))]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_held_and_named_objects(shape):
    """Against signed distance formulas, for something held and for something that stands there."""
    T = SE3.from_xyz_rpy((0.9, 0.4, 0.9), (0.3, -0.5, 1.0))
    scene = panda(CollisionObject.single("thing", shape, T))
    rng = np.random.default_rng(2)
    points = T.apply(rng.uniform(-0.25, 0.25, (3000, 3)))
    formula = Box(0.2, 0.1, 0.3) if isinstance(shape, Mesh) else shape
    distance = signed_distance(formula, T.inverse().apply(points))
    held = scene.with_attached("thing", "panda_hand")
    for here, objects in ((held, ()), (scene, ("thing",))):
        for padding in (0.0, 0.03):
            mask = robot_mask(here, points, padding, objects)
            assert mask[distance < padding - 1e-9].all()
            assert not mask[distance > np.sqrt(3) * padding + 1e-9].any()
    assert not robot_mask(scene, points, 0.0).any()
    kept = remove_robot_points(held, points, 0.0)
    assert len(kept) == np.sum(distance > 0)


def test_scaled_links_take_more():
    scene = panda()
    points = np.random.default_rng(3).uniform((-0.6, -0.6, -0.1), (0.6, 0.6, 1.1), (20000, 3))
    plain = robot_mask(scene, points, 0.0)
    scaled = robot_mask(scene.with_padding(link_scale={"panda_link5": 1.3}), points, 0.0)
    assert np.all(scaled[plain]) and scaled.sum() > plain.sum()


def test_empty_clouds_and_nan():
    assert len(remove_robot_points(panda(), np.zeros((0, 3)))) == 0
    assert len(remove_robot_points(panda(), np.full((3, 3), np.nan))) == 3  # left to finite_points


def test_bad_input():
    with pytest.raises(InputError, match="padding"):
        robot_mask(panda(), np.zeros((1, 3)), -0.1)
    with pytest.raises(InputError, match="ghost"):
        robot_mask(panda(), np.zeros((1, 3)), objects=["ghost"])
    seen = panda(CollisionObject.single("seen", PointCloud(np.zeros((1, 3)), 0.1)), box("a", (1, 1, 1)))
    with pytest.raises(InputError, match="padding"):
        object_mask(seen, np.zeros((1, 3)), np.nan, ["a"])
    with pytest.raises(InputError, match="cloud"):
        robot_mask(seen, np.zeros((1, 3)), objects=["seen"])
