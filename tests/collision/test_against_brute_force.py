"""The exact checker against brute force on random configurations among random obstacles."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tests.collision.reference import INSIDE, BruteForce, distance_to_points
from tests.model.helpers import random_positions
from tests.scene.helpers import mesh_of, open_bin

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, SO3, Box, Capsule, Cone, Cylinder, Mesh, Sphere
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

TOLERANCE = 2e-4  # [m] nearer to touching than this, the two may differ
ROBOTS = ("panda", "ur10_gripper")


def random_objects(rng: np.random.Generator, primitives_only: bool = False) -> list[CollisionObject]:
    def size(low=0.08, high=0.3):
        return float(rng.uniform(low, high))

    shapes = [
        Box(size(), size(), size()), Sphere(size() / 2), Cylinder(size() / 2, size()),
        Capsule(size() / 3, size()), Cone(size() / 2, size()),
    ]  # fmt: skip
    if not primitives_only:
        shapes += [mesh_of(open_bin(0.3, 0.2)), mesh_of(trimesh.creation.icosphere(1, size() / 2))]
    found = []
    for i, shape in enumerate(shapes):
        at = rng.uniform((-0.7, -0.7, 0.0), (0.7, 0.7, 1.0))
        pose = SE3(SO3.exp(rng.normal(size=3)), at)
        found.append(CollisionObject.single(f"{type(shape).__name__}{i}", shape, pose))
    return found


def check_agreement(robot: str, scenes: int, poses: int, seed: int) -> tuple[int, int]:
    """Compare touching pairs and the nearest pair; returns how often things touched and did not."""
    rng, model = np.random.default_rng(seed), load_robot(robot)
    touched = free = 0
    for _ in range(scenes):
        scene = PlanningScene.of(model, objects=random_objects(rng))
        checker, kernel = ExactChecker(scene), KernelChecker(scene)
        reference = BruteForce(scene, robot)
        for _ in range(poses):
            q = random_positions(model, rng)
            expected = reference.distances(q)
            found = {frozenset((c.body_a, c.body_b)): c.distance for c in checker.contacts(q)}
            for pair, distance in expected.items():
                if distance > TOLERANCE:
                    assert pair not in found, (sorted(pair), distance, found[pair])
                elif distance == 0.0 and pair not in found:
                    apart = _distance_of(checker, pair)
                    assert apart <= TOLERANCE, (sorted(pair), apart)
            assert set(found) <= set(expected)
            if INSIDE in expected.values() and not found:
                continue  # test_exact.py has the bodies inside others
            assert checker.is_free(q) == (not found)
            nearest = checker.nearest(q)
            if nearest.distance < -TOLERANCE:  # it may call a near miss a contact, never the other way round
                assert not kernel.is_free(q), (nearest, q.tolist())
            if found:
                touched += 1
                assert nearest.distance <= 0.0
            else:
                free += 1
                assert nearest.distance == pytest.approx(min(expected.values()), abs=TOLERANCE)
                pair = frozenset((nearest.body_a, nearest.body_b))
                assert expected[pair] == pytest.approx(nearest.distance, abs=TOLERANCE)
    return touched, free


def _distance_of(checker: ExactChecker, pair: frozenset[str]) -> float:
    return min(
        checker.pair_distance(int(a), int(b))
        for a, b in checker.pairs
        if {checker.geometries[a].body, checker.geometries[b].body} == pair
    )


@pytest.mark.slow
@pytest.mark.cases("panda")
@pytest.mark.parametrize("robot", ROBOTS)
def test_contacts_and_distances_agree(robot):
    touched, free = check_agreement(robot, scenes=6, poses=8, seed=0)
    assert touched > 10 and free > 5  # the sample says something about both


@pytest.mark.long
@pytest.mark.parametrize("robot", ROBOTS)
def test_contacts_and_distances_agree_at_length(robot):
    touched, free = check_agreement(robot, scenes=20, poses=25, seed=1)
    assert touched > 50 and free > 50


def surface_points(model, spacing: float) -> dict[str, np.ndarray]:
    """Points on each link's collision surfaces, in the link frame, at most about `spacing` apart."""
    found: dict[str, np.ndarray] = {}
    for link in model.links.values():
        rows = []
        for c in link.collisions:
            shape = c.shape
            if isinstance(shape, Box):
                surface = trimesh.creation.box((shape.x, shape.y, shape.z))
            elif isinstance(shape, Cylinder):
                surface = trimesh.creation.cylinder(shape.radius, shape.length, sections=200)
            else:
                assert isinstance(shape, Mesh)
                surface = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
            count = int(4 * surface.area / spacing**2)
            points = trimesh.sample.sample_surface(surface, count, seed=0)[0]
            rows.append(c.T_link_shape.apply(np.vstack([surface.vertices, points])))
        if rows:
            found[link.name] = np.vstack(rows)
    return found


@pytest.mark.slow
@pytest.mark.cases("panda")
@pytest.mark.parametrize("robot", ROBOTS)
def test_no_sampled_point_is_nearer_than_the_nearest_distance(robot):
    """Formulas for points and primitives, no collision library: an upper bound that must be close."""
    spacing = 0.006
    rng, model = np.random.default_rng(2), load_robot(robot)
    tree, clouds = kinematic_tree(model), surface_points(model, spacing)
    base = next(g for g in model.rigid_groups if model.root_link in g)
    disabled = {frozenset((a, b)): "test" for a in model.links for b in model.links if a != b}
    from dataclasses import replace

    alone = replace(model, disabled_collisions=disabled)  # objects only
    compared = 0
    for _ in range(12):
        objects = random_objects(rng, primitives_only=True)
        checker = ExactChecker(PlanningScene.of(alone, objects=objects))
        q = random_positions(model, rng)
        sampled = np.inf
        for link, points in clouds.items():
            if link in base:
                continue
            world = tree.link_pose(q, link).apply(points)
            sampled = min(
                sampled, *(distance_to_points(o.shapes[0][0], o.T_world_object, world) for o in objects)
            )
        nearest = checker.nearest(q)
        if sampled > 0:
            # Hulls that stand for nearly convex meshes are a little larger than these.
            assert sampled - spacing - 1e-3 <= nearest.distance <= sampled + TOLERANCE
            compared += 1
        else:
            assert nearest.distance <= TOLERANCE and not checker.is_free(q)
    assert compared >= 3
