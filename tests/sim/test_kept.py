"""A model that was compiled before, with another draw put in, is the one that is compiled for the draw."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from armcell.core import SE3, SO3, Box, Cone, Cylinder
from armcell.model import load_robot
from armcell.scene import CollisionObject, Material, PlanningScene
from armcell.sim import PhysicsSettings, SimWorld
from armcell.sim.build import build
from armcell.sim.kept import kept_build

SETTINGS = PhysicsSettings()
SHAPES = {
    "cube": ((Box(0.05, 0.05, 0.05), SE3.identity()),),
    "hammer": (
        (Cylinder(0.01, 0.2), SE3.identity()),
        (Box(0.03, 0.08, 0.04), SE3(SO3.from_rpy((0.2, 0.3, 0.4)), np.array([0.0, 0.01, 0.1]))),
    ),
    "cone": ((Cone(0.03, 0.1), SE3.from_xyz(0.01, 0.0, 0.0)),),
}


def _scene(rng: np.random.Generator, **of_all) -> PlanningScene:
    objects = [CollisionObject.single("table", Box(1.0, 1.0, 0.1), SE3.from_xyz(0.8, 0.0, -0.05))]
    for i, (name, shapes) in enumerate(SHAPES.items()):
        pose = SE3(SO3.from_rpy(rng.uniform(-2, 2, 3)), np.array([0.5, 0.3 * i, *rng.uniform(0.2, 0.5, 1)]))
        material = Material(float(rng.uniform(0.3, 1.0)))
        given = {"movable": True, "mass": float(rng.uniform(0.05, 0.5)), "material": material, **of_all}
        objects.append(CollisionObject(name, shapes, pose, **given))
    return PlanningScene.of(load_robot("panda"), objects=objects)


def _bits(model: mujoco.MjModel) -> dict[str, bytes]:
    """Every array and number of a model."""
    found = {}
    for place, values in (("", model), ("opt.", model.opt), ("stat.", model.stat)):
        for name in dir(values):
            value = getattr(values, name)
            if not name.startswith("_") and isinstance(value, np.ndarray | int | float):
                found[place + name] = np.asarray(value).tobytes()
    return found


def test_it_is_the_compiled_one_bit_for_bit():
    rng = np.random.default_rng(3)
    for _ in range(8):
        scene = _scene(rng)
        kept, fresh = kept_build(scene, SETTINGS), build(scene, SETTINGS)
        a, b = _bits(kept.mj), _bits(fresh.mj)
        assert len(a) > 200 and [name for name in b if a[name] != b[name]] == []
        assert kept.scene is scene and {n: o.mass for n, o in kept.objects.items()} == {
            n: o.mass for n, o in fresh.objects.items()
        }


def test_a_world_of_it_moves_as_one_compiled_anew(monkeypatch):
    scene = _scene(np.random.default_rng(4))
    SimWorld(scene).step(300)  # leaves nothing behind
    kept = SimWorld(scene)
    monkeypatch.setattr("armcell.sim.world.kept_build", build)
    fresh = SimWorld(scene)
    for _ in range(2):
        for world in (kept, fresh):
            world.step(400)
        assert kept.mj_data.qpos.tobytes() == fresh.mj_data.qpos.tobytes()
        assert len(kept.contacts()) == len(fresh.contacts()) > 3
        for world in (kept, fresh):
            world.reset()


@pytest.mark.parametrize("change", ("color", "shape", "pose", "allowed", "settings", "fixed"))
def test_what_else_changes_is_seen(change):
    scene, settings = _scene(np.random.default_rng(5)), SETTINGS
    kept_build(scene, settings)
    table, cube = scene.objects["table"], scene.objects["cube"]
    if change == "color":
        scene = scene.with_object(replace(cube, color=(1.0, 0.0, 0.0, 1.0)))
    elif change == "shape":
        scene = scene.with_object(replace(cube, shapes=((Box(0.05, 0.05, 0.06), SE3.identity()),)))
    elif change == "pose":
        scene = scene.with_object(table.at(SE3.from_xyz(0.8, 0.0, -0.06)))
    elif change == "allowed":
        scene = scene.with_allowed("panda_link7", "panda_link5")
    elif change == "settings":
        settings = replace(settings, impratio=5.0)
    else:
        scene = scene.with_object(replace(cube, movable=False))
    a, b = kept_build(scene, settings), build(scene, settings)
    assert a.object_qpos == b.object_qpos
    assert [name for name, bits in _bits(b.mj).items() if _bits(a.mj)[name] != bits] == []
