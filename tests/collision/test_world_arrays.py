"""The kernel arrays of a changed world equal those of the same world built from nothing."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
import trimesh
from tests.scene.helpers import box
from tests.scene.helpers import panda as new_panda

from armcell.collision.kernel import world_arrays
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.world_arrays import World, world_of
from armcell.core import SE3, Box, Capsule, Cone, Cylinder, Mesh, Octree, Plane, PointCloud, Shape, Sphere
from armcell.scene import CollisionObject


def _mesh(made: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(made.vertices), np.array(made.faces))


RNG = np.random.default_rng(0)
SHAPES: tuple[Shape, ...] = (
    Box(0.1, 0.2, 0.3),
    Sphere(0.1),
    Cylinder(0.1, 0.3),
    Capsule(0.1, 0.3),
    Cone(0.1, 0.3),
    Plane(),
    _mesh(trimesh.creation.icosphere(1, 0.1)),
    _mesh(trimesh.creation.torus(0.2, 0.05)),
    PointCloud(RNG.uniform(-0.5, 0.5, (500, 3)), 0.004),
    Octree(RNG.uniform(-0.5, 0.5, (40, 3)), np.full(40, 0.02)),
    PointCloud(np.zeros((0, 3)), 0.004),
)


@pytest.fixture(autouse=True)
def _nothing_cached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world_arrays, "_recent", deque(maxlen=world_arrays.KEPT))


def _thing(name: str, rng: np.random.Generator) -> CollisionObject:
    """An object of one to three random shapes at a random pose."""
    some = rng.choice(len(SHAPES), rng.integers(1, 4))
    shapes = tuple((SHAPES[k], SE3.from_xyz(*rng.uniform(-0.1, 0.1, 3))) for k in some)
    return CollisionObject(name, shapes, SE3.from_xyz(*rng.uniform(-1, 1, 3)))


def _bits(world: World) -> dict[str, bytes]:
    every = world.tables | world.arrays | world.pieces | {"shape_pieces": world.shape_pieces}
    return {name: np.ascontiguousarray(table).tobytes() for name, table in every.items()}


def _changed(objects: dict[str, CollisionObject], rng: np.random.Generator) -> dict[str, CollisionObject]:
    """Add, move, replace, remove, or reorder some objects."""
    names, kind = list(objects), rng.integers(5)
    some = rng.choice(names, min(len(names), int(rng.integers(1, 4))), replace=False) if names else ()
    if kind == 0 or not names:
        return objects | {f"new{rng.integers(10**9)}": _thing("new", rng) for _ in range(rng.integers(1, 4))}
    if kind == 1:
        return objects | {n: objects[n].at(SE3.from_xyz(*rng.uniform(-1, 1, 3))) for n in some}
    if kind == 2:
        return objects | {n: _thing(n, rng) for n in some}
    if kind == 3:
        return {n: item for n, item in objects.items() if n not in some}
    return {n: objects[n] for n in rng.permutation(names)}


@pytest.mark.parametrize("seed", range(5))
def test_an_updated_world_equals_a_world_built_from_nothing(seed):
    rng, objects = np.random.default_rng(seed), {}
    for _ in range(25):
        objects = _changed(objects, rng)
        updated = world_of(objects)
        kept, world_arrays._recent = world_arrays._recent, deque()
        fresh = world_of(objects)
        world_arrays._recent = kept
        assert updated.names == fresh.names == tuple(objects)
        assert _bits(updated) == _bits(fresh)


def test_unchanged_objects_are_not_converted_again(monkeypatch):
    objects = {f"box{k}": box(f"box{k}", (0.1, 0.1, 0.1), (0.1 * k, 1.0, 0.0)) for k in range(20)}
    world_of(objects)
    converted = []
    known = world_arrays.object_tables
    monkeypatch.setattr(world_arrays, "object_tables", lambda items: converted.extend(items) or known(items))
    moved = objects["box7"].at(SE3.from_xyz(0, 2, 0))
    world_of(objects | {"box7": moved})
    world_of(objects)  # again the first world
    world_of({name: item for name, item in objects.items() if name != "box3"})
    assert converted == [moved]


def test_an_unrelated_world_in_between_does_not_forget_the_objects(monkeypatch):
    objects = {f"box{k}": box(f"box{k}", (0.1, 0.1, 0.1), (0.1 * k, 1.0, 0.0)) for k in range(20)}
    world_of(objects)
    world_of({"other": box("other", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0))})
    monkeypatch.setattr(world_arrays, "object_tables", lambda items: pytest.fail(f"converted {items}"))
    world_of({name: item for name, item in objects.items() if name != "box3"})


def test_a_moved_object_touches_where_it_is_now():
    scene = new_panda(box("a", (0.1, 0.1, 0.1), (2.0, 0.0, 0.5)), box("b", (0.1, 0.1, 0.1), (2.0, 1.0, 0.5)))
    names = scene.model.group("arm").joint_names
    q = scene.positions[scene.model.columns(names)]
    hand = scene.frame_pose("panda_hand")
    assert KernelChecker(scene, names).is_free(q)
    assert not KernelChecker(scene.with_object_pose("b", hand), names).is_free(q)
    assert KernelChecker(
        scene.with_object_pose("b", hand).with_object_pose("b", SE3.from_xyz(2, 2, 0)), names
    ).is_free(q)
