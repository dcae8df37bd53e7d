"""Compiled models used again, for scenes that differ in poses, mass and friction of free objects only.

To compile takes milliseconds; the next trial of a campaign draws just these. What comes out is what `build`
gives, bit for bit.
"""

from __future__ import annotations

import copy
from collections.abc import Hashable
from dataclasses import replace

import mujoco

from armcell.collision.kernel.kept import Kept
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim.build import build, scene_objects, set_options
from armcell.sim.built import BuiltModel
from armcell.sim.objects import add_free_body, sliding
from armcell.sim.settings import PhysicsSettings

_models: Kept[BuiltModel] = Kept(4)
"""As compiled, by all that `build` reads but what `_put_in` writes. Only here: worlds get copies."""


def kept_build(scene: PlanningScene, settings: PhysicsSettings) -> BuiltModel:
    """`build(scene, settings)`, from a model that was compiled before where there is one."""
    objects = scene_objects(scene)
    loose = [o for n, o in objects.items() if o.thread is None and (o.movable or n in scene.attached)]
    if any(item.thread is not None for item in objects.values()):
        return build(scene, settings)  # what is screwed in hangs on where the other is
    names = {item.name for item in loose}
    key = (
        scene.model,
        repr(settings),
        tuple(scene.allowed.items()),
        frozenset(scene.attached),
        tuple(_seen(item, item.name in names) for item in objects.values()),
    )
    kept = _models.get(key, lambda: build(scene, settings))
    built = replace(kept, scene=scene, objects=objects, mj=copy.copy(kept.mj))
    _put_in(built, loose, settings)
    return built


def _seen(item: CollisionObject, loose: bool) -> Hashable:
    """What `build` reads of an object; of a loose one without what `_put_in` writes."""
    shapes = tuple((shape, T.matrix.tobytes()) for shape, T in item.shapes)
    rest = () if loose else (item.T_world_object.matrix.tobytes(), item.mass, item.material)
    return item.name, loose, item.movable, tuple(item.color), item.belt and tuple(item.belt), shapes, rest


def _put_in(built: BuiltModel, loose: list[CollisionObject], settings: PhysicsSettings) -> None:
    """Write the loose objects' poses, inertias and friction, and what the engine derives from them."""
    model, spec = built.mj, mujoco.MjSpec()
    set_options(spec, settings)
    for item in loose:
        add_free_body(spec.worldbody, item, item.T_world_object)
    alone = spec.compile()  # without geoms that takes no time
    for item in loose:
        body, there = alone.body(item.name).id, built.body[item.name]
        for field in ("body_pos", "body_quat", "body_mass", "body_ipos", "body_iquat", "body_inertia"):
            getattr(model, field)[there] = getattr(alone, field)[body]
        first, start = int(alone.jnt_qposadr[alone.body_jntadr[body]]), built.object_qpos[item.name]
        for field in ("qpos0", "qpos_spring"):
            getattr(model, field)[start : start + 7] = getattr(alone, field)[first : first + 7]
        geoms = int(model.body_geomadr[there])
        model.geom_friction[geoms : geoms + int(model.body_geomnum[there])] = sliding(item)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    # only a compilation works these out, so in its order
    model.stat.meaninertia = sum(model.dof_M0.tolist()) / max(model.nv, 1)
    model.stat.meanmass = sum(model.body_mass.tolist()[1:]) / (model.nbody - 1)
