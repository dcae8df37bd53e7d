"""Dropping of objects into a bin in physics; a seed determines their resting poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armcell._array_store import key_of, recall_or_compute
from armcell.core import SE3, SO3, Box, InputError
from armcell.grasping import support_surface, surface_of
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import PhysicsSettings, SimWorld

VERSION = 2  # raise when the same drop would give other poses
FENCE = 0.3  # [m] height of the fence around the bin during the drops
FALL = 0.04  # [m] clearance above the objects in the bin
WAIT, AT_LAST = 0.35, 1.0  # [s] between two drops, and after the last drop
ROUNDS = 4  # objects that miss the bin are dropped again
AWAY = 20.0  # [m] x position of objects that wait for their drop
FENCES = ("fence 1", "fence 2", "fence 3", "fence 4", "shelf")


def drop_objects(scene: PlanningScene, names: Sequence[str], into: str, seed: int) -> PlanningScene:
    """Drop each object into a bin at a random pose in the physics simulation.
    Return the scene with all objects at rest.

    The poses are cached on disk per seed.

    Args:
        names: the objects to drop.
        into: a fixed object with a level floor.
    Raises:
        InputError: objects do not stay in the bin.
    """
    parts = [f"drop {VERSION} {seed} {into} {PhysicsSettings()}"]
    for name in (*names, into):
        item = scene.object(name)
        parts += [
            f"{name} {item.mass_kg:.9g} {item.material}",
            item.T_world_object.matrix.round(9).tobytes().hex(),
        ]
        parts.append(surface_of(item).triangles.tobytes().hex())
    key = key_of(*parts)
    before = scene

    def computed() -> dict[str, np.ndarray]:
        poses = _fallen(before, names, into, seed)
        return {"poses": np.array([poses[n].matrix for n in names])}

    stored = recall_or_compute("drops", key, computed)
    for name, T in zip(names, stored["poses"], strict=True):
        scene = scene.with_object_pose(name, SE3.from_matrix(T))
    return scene


def _fallen(scene: PlanningScene, names: Sequence[str], into: str, seed: int) -> dict[str, SE3]:
    rng = np.random.default_rng(seed)
    frame, size_x, size_y = support_surface(scene.object(into))
    half = np.array([size_x, size_y]) / 2
    settings = PhysicsSettings(sleep=True)
    fenced = scene
    for name, item in zip(FENCES, _around(frame, half), strict=True):
        fenced = fenced.with_object(replace(item, name=name))
    for k, name in enumerate(names):
        low = scene.object(name).bounds()[0][2]
        fenced = fenced.with_object_pose(
            name, SE3.from_xyz(AWAY + 0.3 * (k % 6), 0.3 * (k // 6), 0.001 - low)
        )
    world = SimWorld(fenced, settings)
    world.step(round(AT_LAST / world.timestep))  # until the waiting objects are at rest
    poses: dict[str, SE3] = {}
    left: list[str] = [names[int(i)] for i in rng.permutation(len(names))]
    inside: list[str] = []
    for _ in range(ROUNDS):
        for name in left:
            top = max(
                [float(frame.translation[2]), *(_top(scene.object(n), world.object_pose(n)) for n in inside)]
            )
            world.set_object_pose(name, _above(scene.object(name), frame, half, top, rng))
            world.step(round(WAIT / world.timestep))
            inside.append(name)
        world.step(round(AT_LAST / world.timestep))
        poses = {n: world.object_pose(n) for n in names}
        without = scene
        for name in names:
            without = without.with_object_pose(name, poses[name])
        with SimWorld(without, settings) as settled:  # without the fence
            settled.step(round(AT_LAST / settled.timestep))
            poses = {n: settled.object_pose(n) for n in names}
        left = [n for n in names if not _is_in(scene.object(n), poses[n], frame, half)]
        if not left:
            return poses
        inside = [n for n in names if n not in left]
        for name in inside:
            world.set_object_pose(name, poses[name])
    raise InputError(
        f"{', '.join(left)} do not stay in {into!r} (seed {seed})", hint="a larger bin, or fewer objects"
    )


def _around(frame: SE3, half: np.ndarray) -> list[CollisionObject]:
    """Return four walls that fence a bin while objects are dropped into it, and a distant shelf for objects
    that are not dropped yet.

    Args:
        frame: center of the bin's floor, T_world_frame.
        half: (2,) half the side lengths of the floor [m].
    """
    found, thick = [], 0.05
    for axis in range(2):
        for sign in (1.0, -1.0):
            size, at = np.array([2 * half[0] + 2 * thick, 2 * half[1] + 2 * thick, FENCE]), np.zeros(3)
            size[axis], at[axis], at[2] = thick, sign * (half[axis] + thick / 2 - 0.012), FENCE / 2
            found.append(
                CollisionObject.single("fence", Box(*size.tolist()), frame @ SE3.from_xyz(*at.tolist()))
            )
    shelf = Box(4.0, 4.0, 0.1)
    return [*found, CollisionObject.single("shelf", shelf, SE3.from_xyz(AWAY + 0.7, 0.5, -0.05))]


def _above(item: CollisionObject, frame: SE3, half: np.ndarray, top: float, rng: np.random.Generator) -> SE3:
    """Return a random pose from which to drop the next object into a bin, above the objects that were dropped
    before.

    Args:
        frame: center of the bin's floor, T_world_frame.
        half: (2,) half the side lengths of the floor [m].
        top: height of the highest object in the bin [m].
    """
    low, high = item.bounds()
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    R = SO3.from_quat_wxyz(_unit(rng.normal(size=4)))
    room = np.maximum(half - min(reach, 0.05) - 0.01, 0.0)
    xy = frame.translation[:2] + frame.rotation.matrix[:2, :2] @ rng.uniform(-room, room)
    center = np.array([*xy, top + FALL + reach])
    return SE3(R, center - R.matrix @ middle)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def _top(item: CollisionObject, T: SE3) -> float:
    return float(T.apply(surface_of(item).points)[:, 2].max())


def _is_in(item: CollisionObject, T: SE3, frame: SE3, half: np.ndarray) -> bool:
    """Return whether the center of a dropped object at pose `T` is above the floor rectangle of a bin."""
    low, high = item.bounds()
    local = frame.inverse().apply(T.apply((low + high) / 2))
    return bool(np.all(np.abs(local[:2]) < half) and local[2] > 0)
