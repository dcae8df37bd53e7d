"""Compiled models used again, for scenes that differ in poses, mass and friction of free objects only.

To compile takes milliseconds; the next trial of a campaign draws just these. What comes out is what `build`
gives, bit for bit. A kept model and its data are lent to one world at a time: new ones for each would leave
holes in the process's memory that the next do not fit in, so that it grows from trial to trial.
"""

from __future__ import annotations

import copy
import ctypes
import sys
import threading
from collections.abc import Hashable
from dataclasses import replace

import mujoco
import numpy as np

from armcell.collision.kernel.kept import Kept
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim.build import build, scene_objects, set_options
from armcell.sim.built import BuiltModel
from armcell.sim.objects import add_free_body, sliding
from armcell.sim.settings import PhysicsSettings
from armcell.sim.stepping import LIBRARY

_copy_model = ctypes.CDLL(str(LIBRARY)).mj_copyModel  # into one that is there, which Python's does not offer
_copy_model.argtypes, _copy_model.restype = (ctypes.c_void_p, ctypes.c_void_p), ctypes.c_void_p


class _Lender:
    """A compiled model as it was compiled, and a copy of it with data to be lent."""

    def __init__(self, built: BuiltModel):
        self._built, self._mj = built, copy.copy(built.mj)
        self._data = mujoco.MjData(self._mj)
        self._parts = [self._mj, self._data, *_arrays(self._mj), *_arrays(self._data)]
        self._alone = self._references()

    def _references(self) -> int:
        return sum(map(sys.getrefcount, self._parts))

    @property
    def free(self) -> bool:
        """Nobody has the model, its data or an array of them: their world is gone, and its snapshots."""
        return self._references() == self._alone

    def lend(
        self, scene: PlanningScene, objects: dict[str, CollisionObject], loose: list[CollisionObject],
        settings: PhysicsSettings,
    ) -> tuple[BuiltModel, mujoco.MjData]:  # fmt: skip
        """With everything that the last world wrote put back."""
        _copy_model(self._mj._address, self._built.mj._address)
        mujoco.mj_resetData(self._mj, self._data)
        built = replace(self._built, scene=scene, objects=objects, mj=self._mj)
        _put_in(built, loose, settings, self._data)
        mujoco.mj_resetData(self._mj, self._data)
        return built, self._data


def _arrays(of: object) -> list[np.ndarray]:
    values = (getattr(of, name) for name in dir(of))
    return [value for value in values if isinstance(value, np.ndarray)]


_models: Kept[_Lender] = Kept(4)
"""By all that `build` reads but what `_put_in` writes."""
_lock = threading.Lock()  # between a look whether a model is free and its being lent


def kept_build(scene: PlanningScene, settings: PhysicsSettings) -> tuple[BuiltModel, mujoco.MjData]:
    """`build(scene, settings)` with data, of a model that was compiled before where one is free."""
    objects = scene_objects(scene)
    loose = [o for n, o in objects.items() if o.thread is None and (o.movable or n in scene.attached)]
    if any(item.thread is not None for item in objects.values()):
        return _new(build(scene, settings))  # what is screwed in hangs on where the other is
    names = {item.name for item in loose}
    key = (
        scene.model,
        repr(settings),
        tuple(scene.allowed.items()),
        frozenset(scene.attached),
        tuple(_seen(item, item.name in names) for item in objects.values()),
    )
    lender = _models.get(key, lambda: _Lender(build(scene, settings)))
    with _lock:
        if lender.free:
            return lender.lend(scene, objects, loose, settings)
    return _new(build(scene, settings))


def _new(built: BuiltModel) -> tuple[BuiltModel, mujoco.MjData]:
    return built, mujoco.MjData(built.mj)


def _seen(item: CollisionObject, loose: bool) -> Hashable:
    """What `build` reads of an object; of a loose one without what `_put_in` writes."""
    shapes = tuple((shape, T.matrix.tobytes()) for shape, T in item.shapes)
    rest = () if loose else (item.T_world_object.matrix.tobytes(), item.mass, item.material)
    return item.name, loose, item.movable, tuple(item.color), item.belt and tuple(item.belt), shapes, rest


def _put_in(
    built: BuiltModel, loose: list[CollisionObject], settings: PhysicsSettings, scratch: mujoco.MjData
) -> None:
    """Write the loose objects' poses, inertias and friction, and what the engine derives from them."""
    model, spec = built.mj, mujoco.MjSpec()
    set_options(spec, settings)
    # [bytes] compiling needs a quarter; by default it takes 14 MB, which leave such a hole each time
    spec.memory = 4096 * (1 + len(loose))
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
    mujoco.mj_setConst(model, scratch)
    # only a compilation works these out, so in its order
    model.stat.meaninertia = sum(model.dof_M0.tolist()) / max(model.nv, 1)
    model.stat.meanmass = sum(model.body_mass.tolist()[1:]) / (model.nbody - 1)
