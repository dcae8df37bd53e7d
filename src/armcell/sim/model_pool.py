"""A pool of compiled MuJoCo models for scenes that differ only in their free objects.

Compilation takes milliseconds, and the next trial of a campaign usually changes only the poses, mass, and
friction of free objects. A model from the pool equals the result of `build` bit for bit. The pool leases each
model with its data to one world at a time, until the world gives it back: allocating new ones for each world
would fragment the heap, so that the memory of the process would grow from trial to trial.
"""

from __future__ import annotations

import copy
import ctypes
import threading
import weakref
from collections.abc import Callable, Hashable
from dataclasses import replace

import mujoco

from armcell.collision.kernel.lru_cache import LruCache
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim.mujoco_model import BuiltModel, build, scene_objects, set_options
from armcell.sim.objects import add_free_body, friction_coefficients
from armcell.sim.settings import PhysicsSettings
from armcell.sim.step_kernel import LIBRARY

_copy_model = ctypes.CDLL(str(LIBRARY)).mj_copyModel  # copies into an existing model; the bindings cannot
_copy_model.argtypes, _copy_model.restype = (ctypes.c_void_p, ctypes.c_void_p), ctypes.c_void_p


class ModelLease:
    """Lease of a compiled MuJoCo model from the model pool. The holder has exclusive use until `release`.

    Attributes:
        built: the model of a scene.
        data: MuJoCo's data for it.
    """

    def __init__(self, built: BuiltModel, data: mujoco.MjData, pooled: _PooledModel | None = None):
        self.built, self.data, self._pooled = built, data, pooled
        self.released = False

    def release(self) -> None:
        """Return a leased MuJoCo model to the model pool. A second call has no effect.

        From now on the caller must not access the model, its data or views of their arrays: the pool leases
        them to another world. A lease that is dropped without `release` is safe: the pool then replaces the
        model by a new copy.
        """
        if not self.released and self._pooled is not None:
            self._pooled.take_back(self)
        self.released = True


def _no_lease() -> None:
    return None


class _PooledModel:
    """Compiled MuJoCo model that the model pool keeps unchanged, and a copy of the model that one scene at a
    time can lease.
    """

    def __init__(self, built: BuiltModel):
        self._built = built
        self._free: tuple[mujoco.MjModel, mujoco.MjData] | None = None
        self._lease: Callable[[], ModelLease | None] = _no_lease

    def lease(
        self, scene: PlanningScene, objects: dict[str, CollisionObject], loose: list[CollisionObject],
        settings: PhysicsSettings,
    ) -> ModelLease | None:  # fmt: skip
        """Lease this pooled MuJoCo model's copy and set it up for a scene. Return None if the copy is already
        leased.
        """
        if self._lease() is not None:
            return None
        mj, data = self._free or self._copied()
        self._free = None
        _copy_model(mj._address, self._built.mj._address)
        mujoco.mj_resetData(mj, data)
        built = replace(self._built, scene=scene, objects=objects, mj=mj)
        _put_in(built, loose, settings, data)
        mujoco.mj_resetData(mj, data)
        lease = ModelLease(built, data, self)
        self._lease = weakref.ref(lease)
        return lease

    def take_back(self, lease: ModelLease) -> None:
        with _lock:
            self._free = lease.built.mj, lease.data
            self._lease = _no_lease

    def _copied(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        mj = copy.copy(self._built.mj)
        return mj, mujoco.MjData(mj)


_models: LruCache[_PooledModel] = LruCache(4)
"""Pool of compiled models, by all inputs of `build` that `_put_in` does not write."""
_lock = threading.Lock()  # makes checking and leasing a model atomic


def lease_model(scene: PlanningScene, settings: PhysicsSettings) -> ModelLease:
    """Lease a compiled MuJoCo model and its `MjData` for the simulation of a scene. The model pool provides
    the model if possible; otherwise, the model is compiled.

    The model equals that of `build(scene, settings)`.
    """
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
    pooled = _models.get(key, lambda: _PooledModel(build(scene, settings)))
    with _lock:
        lease = pooled.lease(scene, objects, loose, settings)
    return lease or _new(build(scene, settings))


def _new(built: BuiltModel) -> ModelLease:
    return ModelLease(built, mujoco.MjData(built.mj))


def _seen(item: CollisionObject, loose: bool) -> Hashable:
    """Return the properties of an object that affect the MuJoCo model.
    They are part of its key in the model pool.

    For a free object, the result leaves out the values that `_put_in` writes.
    """
    shapes = tuple((shape, T.matrix.tobytes()) for shape, T in item.shapes)
    rest = () if loose else (item.T_world_object.matrix.tobytes(), item.mass, item.material)
    return item.name, loose, item.movable, tuple(item.color), item.belt and tuple(item.belt), shapes, rest


def _put_in(
    built: BuiltModel, loose: list[CollisionObject], settings: PhysicsSettings, scratch: mujoco.MjData
) -> None:
    """Write the poses, inertias and friction of free objects into a MuJoCo model that was leased from the
    pool.

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
        model.geom_friction[geoms : geoms + int(model.body_geomnum[there])] = friction_coefficients(item)
    mujoco.mj_setConst(model, scratch)
    # MuJoCo computes these only at compilation; summing in the same order gives the same bits
    model.stat.meaninertia = sum(model.dof_M0.tolist()) / max(model.nv, 1)
    model.stat.meanmass = sum(model.body_mass.tolist()[1:]) / (model.nbody - 1)
