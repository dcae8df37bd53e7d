"""A model that was compiled before, with another draw put in, is the one that is compiled for the draw."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from armcell.core import SE3, SO3, ArmcellError, Box, Cone, Cylinder
from armcell.model import load_robot
from armcell.scene import CollisionObject, Material, PlanningScene
from armcell.sim import PhysicsSettings, SimWorld
from armcell.sim.model_pool import ModelLease, lease_model
from armcell.sim.mujoco_model import build

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


def _compiled(scene: PlanningScene, settings: PhysicsSettings) -> ModelLease:
    built = build(scene, settings)
    return ModelLease(built, mujoco.MjData(built.mj))


def _bits(of: mujoco.MjModel | mujoco.MjData) -> dict[str, bytes]:
    """Every array and number of a model, or of data but for what a step writes before it reads it."""
    found = {}
    parts = (("opt.", of.opt), ("stat.", of.stat)) if isinstance(of, mujoco.MjModel) else ()
    for place, values in (("", of), *parts):
        for name in dir(values):
            value = getattr(values, name)
            if not name.startswith(("_", "efc_", "efm_")) and isinstance(value, np.ndarray | int | float):
                found[place + name] = np.asarray(value).tobytes()
    return found


@pytest.mark.slow
def test_it_is_the_compiled_one_bit_for_bit():
    rng = np.random.default_rng(3)
    for _ in range(8):
        scene = _scene(rng)
        lease, fresh = lease_model(scene, SETTINGS), build(scene, SETTINGS)
        kept = lease.built
        a, b = _bits(kept.mj), _bits(fresh.mj)
        assert len(a) > 200 and [name for name in b if a[name] != b[name]] == []
        assert kept.scene is scene and {n: o.mass for n, o in kept.objects.items()} == {
            n: o.mass for n, o in fresh.objects.items()
        }


def test_a_world_of_it_moves_as_one_compiled_anew(monkeypatch):
    scene = _scene(np.random.default_rng(4))
    with SimWorld(scene) as world:
        world.step(300)  # leaves nothing behind
    kept = SimWorld(scene)
    monkeypatch.setattr("armcell.sim.world.lease_model", _compiled)
    fresh = SimWorld(scene)
    assert _bits(kept.mj_data) == _bits(fresh.mj_data)
    for _ in range(2):
        for world in (kept, fresh):
            world.step(400)
        assert kept.mj_data.qpos.tobytes() == fresh.mj_data.qpos.tobytes()
        assert len(kept.contacts()) == len(fresh.contacts()) > 3
        for world in (kept, fresh):
            world.reset()


def test_it_is_leased_to_one_world_at_a_time():
    scene = _scene(np.random.default_rng(6))
    first = SimWorld(scene)
    mj, data = first.mj_model, first.mj_data
    second = SimWorld(scene)  # works, with a model of its own
    assert second.mj_model is not mj and second.mj_data is not data
    first.close()
    first.close()
    with SimWorld(scene) as again:
        assert again.mj_model is mj and again.mj_data is data


@pytest.mark.slow
def test_a_world_that_is_dropped_leaves_its_model_to_who_holds_it():
    """Views and snapshots stay valid, because only `close` gives the model back."""
    scene = _scene(np.random.default_rng(9))
    world = SimWorld(scene)
    world.step(10)
    position, mj = world.mj_data.qpos[:], weakref.ref(world.mj_model)
    before = position.copy()
    del world
    gc.collect()
    with SimWorld(scene) as other:
        assert other.mj_model is not mj()
        other.step(50)
        assert np.array_equal(position, before)
        kept = other.mj_model
    with SimWorld(scene) as again:
        assert again.mj_model is kept


def test_a_closed_world_says_so():
    world = SimWorld(_scene(np.random.default_rng(6)))
    world.close()
    uses = (world.step, world.joint_state, world.object_poses, world.snapshot, world.contacts)
    for use in (*uses, lambda: world.time, lambda: world.mj_data.qpos, lambda: world.mj_model.nq):
        with pytest.raises(ArmcellError, match="the simulation is closed"):
            use()


def test_what_a_world_wrote_is_put_back():
    scene = _scene(np.random.default_rng(7))
    world = SimWorld(scene)
    before = _bits(world.mj_model)
    mj = weakref.ref(world.mj_model)
    world.add_load("panda_link7", 0.5)
    world.block("panda_joint3")
    world.step(200)
    changed = _bits(world.mj_model)
    assert {"body_mass", "dof_damping", "geom_conaffinity"} <= {n for n in before if before[n] != changed[n]}
    world.close()
    again = SimWorld(scene)
    assert again.mj_model is mj()
    assert _bits(again.mj_model) == before


def test_many_loose_objects():
    """Compiling has enough memory for them."""
    rng = np.random.default_rng(8)
    objects = [
        CollisionObject.single(f"box {i}", Box(0.05, 0.05, 0.05), SE3.from_xyz(1 + i, 0.0, z), movable=True)
        for i, z in enumerate(rng.uniform(0.2, 0.4, 60))
    ]
    scene = PlanningScene.of(load_robot("panda"), objects=objects)
    lease, fresh = lease_model(scene, SETTINGS), build(scene, SETTINGS)
    kept = lease.built
    assert _bits(kept.mj) == _bits(fresh.mj)


@pytest.mark.slow
@pytest.mark.cases("pose", "allowed")
@pytest.mark.parametrize("change", ("color", "shape", "pose", "allowed", "settings", "fixed"))
def test_what_else_changes_is_seen(change):
    scene, settings = _scene(np.random.default_rng(5)), SETTINGS
    lease_model(scene, settings).release()
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
    a, b = lease_model(scene, settings).built, build(scene, settings)
    assert a.object_qpos == b.object_qpos
    assert [name for name, bits in _bits(b.mj).items() if _bits(a.mj)[name] != bits] == []
