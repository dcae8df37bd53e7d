"""A pool of compiled MuJoCo models for scenes that differ only in their free objects.

Compilation takes milliseconds, and the next trial of a campaign usually changes only the poses, mass, and
friction of free objects. A model from the pool equals the result of `build` bit for bit. The pool leases each
model with its data to one world at a time: allocating new ones for each world would fragment the heap, so
that the memory of the process would grow from trial to trial.
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

from armcell.collision.kernel.lru_cache import LruCache
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim.build import build, scene_objects, set_options
from armcell.sim.built import BuiltModel
from armcell.sim.objects import add_free_body, sliding
from armcell.sim.settings import PhysicsSettings
from armcell.sim.stepping import LIBRARY

_copy_model = ctypes.CDLL(str(LIBRARY)).mj_copyModel  # copies into an existing model; the bindings cannot
_copy_model.argtypes, _copy_model.restype = (ctypes.c_void_p, ctypes.c_void_p), ctypes.c_void_p


class _Lender:
    """A compiled MuJoCo model in its original state, with one copy that worlds can lease."""

    def __init__(self, built: BuiltModel):
        self._built, self._mj = built, copy.copy(built.mj)
        self._data = mujoco.MjData(self._mj)
        self._parts = [self._mj, self._data, *_arrays(self._mj), *_arrays(self._data)]
        self._alone = self._references()

    def _references(self) -> int:
        return sum(map(sys.getrefcount, self._parts))

    @property
    def free(self) -> bool:
        """Whether the pooled model is free: no world holds the model, its data, or their arrays.

        The test compares reference counts, so snapshots of a world count as well.
        """
        return self._references() == self._alone

    def lend(
        self, scene: PlanningScene, objects: dict[str, CollisionObject], loose: list[CollisionObject],
        settings: PhysicsSettings,
    ) -> tuple[BuiltModel, mujoco.MjData]:  # fmt: skip
        """Return the pooled copy with its data, reset to the original model and adapted to a scene."""
        _copy_model(self._mj._address, self._built.mj._address)
        mujoco.mj_resetData(self._mj, self._data)
        built = replace(self._built, scene=scene, objects=objects, mj=self._mj)
        _put_in(built, loose, settings, self._data)
        mujoco.mj_resetData(self._mj, self._data)
        return built, self._data


def _arrays(of: object) -> list[np.ndarray]:
    values = (getattr(of, name) for name in dir(of))
    return [value for value in values if isinstance(value, np.ndarray)]


_models: LruCache[_Lender] = LruCache(4)
"""Pool of models; the key holds all inputs of `build` except the values that `_put_in` writes."""
_lock = threading.Lock()  # makes the test whether a model is free and its lease atomic


def kept_build(scene: PlanningScene, settings: PhysicsSettings) -> tuple[BuiltModel, mujoco.MjData]:
    """Return the model of `build(scene, settings)` with data, from the model pool if possible."""
    objects = scene_objects(scene)
    loose = [o for n, o in objects.items() if o.thread is None and (o.movable or n in scene.attached)]
    if any(item.thread is not None for item in objects.values()):
        return _new(build(scene, settings))  # the joint of a screwed-in object depends on both objects' poses
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
    """Return the properties of an object that `build` reads, as part of the model pool's key.

    For a free object, the result leaves out the values that `_put_in` writes.
    """
    shapes = tuple((shape, T.matrix.tobytes()) for shape, T in item.shapes)
    rest = () if loose else (item.T_world_object.matrix.tobytes(), item.mass, item.material)
    return item.name, loose, item.movable, tuple(item.color), item.belt and tuple(item.belt), shapes, rest


def _put_in(
    built: BuiltModel, loose: list[CollisionObject], settings: PhysicsSettings, scratch: mujoco.MjData
) -> None:
    """Write the poses, inertias, and friction of free objects into a model.

    The function also updates the quantities that MuJoCo derives from them at compilation.
    """
    model, spec = built.mj, mujoco.MjSpec()
    set_options(spec, settings)
    # [bytes] four times what compilation needs; the default of 14 MB would fragment the heap every time
    spec.memory = 4096 * (1 + len(loose))
    for item in loose:
        add_free_body(spec.worldbody, item, item.T_world_object)
    alone = spec.compile()  # fast, because the spec has no geoms
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
    # MuJoCo computes these only at compilation; summing in the same order gives the same bits
    model.stat.meaninertia = sum(model.dof_M0.tolist()) / max(model.nv, 1)
    model.stat.meanmass = sum(model.body_mass.tolist()[1:]) / (model.nbody - 1)
