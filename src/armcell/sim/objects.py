"""Scene objects and shapes in a MuJoCo model: fixed, free, on a conveyor belt, screwed into others."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.collision.convex_decomposition import convex_pieces
from armcell.collision.object_decomposition import object_pieces
from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cone,
    Cylinder,
    Mesh,
    Octree,
    Plane,
    PointCloud,
    Shape,
    Sphere,
)
from armcell.scene import CollisionObject, ScrewThread, solid_inertia
from armcell.sim.settings import PhysicsSettings

logger = logging.getLogger(__name__)

GEOM = mujoco.mjtGeom

Splitter = Callable[[Mesh], tuple[Mesh, ...]]

_CONE_EDGES = 48

OBJECT_GROUP, VISUAL_GROUP, COLLISION_GROUP = 0, 2, 3

"""MuJoCo geom groups of objects, visuals and collision shapes; viewers show groups 0 to 2."""

_PRIMITIVES: dict[type, tuple[Any, Callable[[Any], list[float]]]] = {
    Box: (GEOM.mjGEOM_BOX, lambda s: [s.x / 2, s.y / 2, s.z / 2]),
    Sphere: (GEOM.mjGEOM_SPHERE, lambda s: [s.radius, 0, 0]),
    Cylinder: (GEOM.mjGEOM_CYLINDER, lambda s: [s.radius, s.length / 2, 0]),
    Capsule: (GEOM.mjGEOM_CAPSULE, lambda s: [s.radius, s.length / 2, 0]),
    Plane: (GEOM.mjGEOM_PLANE, lambda s: [0, 0, 1]),  # size 0 means infinite
}


class GeomAdder:
    """Builder that converts the shapes of objects and links to geoms in a MuJoCo spec. Geoms with the same
    mesh share one asset.
    """

    def __init__(self, spec: mujoco.MjSpec):
        self.spec = spec
        self._assets: dict[int, str] = {}
        self._kept: list[Mesh] = []  # keeps the meshes alive, so that their id() stays unique

    def add_solid(
        self,
        body: Any,
        shape: Shape,
        T_body_shape: SE3,
        name: str,
        split: Splitter = convex_pieces,
        **values: Any,
    ) -> list[Any]:
        """Add colliding geoms for one shape of an object or link to a MuJoCo body and return them.

        A primitive becomes one geom; `split` divides a mesh into convex pieces. Point clouds and octrees get
        no geoms, because physics ignores them.
        """
        if isinstance(shape, PointCloud | Octree):
            logger.warning("%s is a %s: physics does not see it", name, type(shape).__name__)
            return []
        kind = _PRIMITIVES.get(type(shape))
        if kind is not None:
            return [self._geom(body, T_body_shape, name, type=kind[0], size=kind[1](shape), **values)]
        mesh = cone_mesh(shape) if isinstance(shape, Cone) else shape
        assert isinstance(mesh, Mesh)
        return [
            self.add_mesh(body, piece, T_body_shape, f"{name}.{i}", convex=True, **values)
            for i, piece in enumerate(split(mesh))
        ]

    def add_mesh(
        self, body: Any, mesh: Mesh, T_body_mesh: SE3, name: str, convex: bool = False, **values: Any
    ) -> Any:
        """Add a mesh of an object or link as a geom to a MuJoCo body. If the mesh is not `convex`, it is only
        visual.
        """
        asset = self._assets.get(id(mesh))
        if asset is None:
            asset = self._assets[id(mesh)] = f"mesh{len(self._assets)}"
            self._kept.append(mesh)
            inertia = mujoco.mjtMeshInertia
            self.spec.add_mesh(
                name=asset,
                uservert=mesh.vertices.ravel(),
                userface=mesh.faces.ravel(),
                # a visual mesh may be open or flat, so its volume is meaningless
                inertia=inertia.mjMESH_INERTIA_CONVEX if convex else inertia.mjMESH_INERTIA_SHELL,
            )
        return self._geom(body, T_body_mesh, name, type=GEOM.mjGEOM_MESH, meshname=asset, **values)

    @staticmethod
    def _geom(body: Any, T: SE3, name: str, **values: Any) -> Any:
        return body.add_geom(name=name, pos=T.translation, quat=T.quat_wxyz, **values)


def cone_mesh(cone: Cone, edges: int = _CONE_EDGES) -> Mesh:
    """Convert the cone of a scene object to a closed convex mesh for MuJoCo. The vertices of its base are on
    a circle.
    """
    angle = 2 * np.pi * np.arange(edges) / edges
    base = np.stack(
        [cone.radius * np.cos(angle), cone.radius * np.sin(angle), 0 * angle - cone.length / 2], 1
    )
    vertices = np.vstack([base, [0, 0, -cone.length / 2], [0, 0, cone.length / 2]])
    i, j = np.arange(edges), (np.arange(edges) + 1) % edges
    foot = np.stack([j, i, np.full(edges, edges)], 1)
    side = np.stack([i, j, np.full(edges, edges + 1)], 1)
    return Mesh(vertices, np.vstack([foot, side]).astype(np.int32))


def full_inertia(inertia: NDArray[np.float64]) -> list[float]:
    """Return the inertia matrix (3, 3) of an object or link as a list in the order that MuJoCo uses.

    The order is xx, yy, zz, xy, xz, yz.
    """
    return [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]


_BELT_MASS = 1e5  # [kg] so heavy that the objects on a belt do not slow it down

Array = NDArray[np.float64]

Poses = tuple[Array, Array]

"""Positions (body, 3) [m] and quaternions (body, 4), wxyz, of all bodies in parent frames."""


def add_object(
    spec: mujoco.MjSpec, adder: GeomAdder, item: CollisionObject, attached: bool, settings: PhysicsSettings,
    into: Any = None, T_world_into: SE3 | None = None,
) -> Any:  # fmt: skip
    T = item.T_world_object if T_world_into is None else T_world_into.inverse() @ item.T_world_object
    values: dict[str, Any] = {
        "rgba": item.color,
        "group": OBJECT_GROUP,
        "density": 0.0,
        "friction": friction_coefficients(item),
    }
    free = item.movable or attached
    if free and item.thread is None:
        body = add_free_body(spec.worldbody, item, T)
    else:
        body = (into or spec.worldbody).add_body(name=item.name, pos=T.translation, quat=T.quat_wxyz)
    if free:
        if item.thread is not None:
            _add_thread(spec, body, item.name, item.thread)
            _set_inertia(body, item)
        values |= {
            "priority": 1,
            "condim": settings.object_condim,
            "solref": settings.object_solref,
            "solimp": settings.object_solimp,
        }
    elif item.belt is not None:
        _add_belt(body, item.name, item.belt)
    for i, (shape, T_object_shape) in enumerate(item.shapes):
        adder.add_solid(body, shape, T_object_shape, f"{item.name}:{i}", object_pieces, **values)
    return body


def add_free_body(parent: Any, item: CollisionObject, T_parent_object: SE3) -> Any:
    """Add a free scene object to a MuJoCo spec, as a body with a free joint and inertia but no geoms."""
    body = parent.add_body(name=item.name, pos=T_parent_object.translation, quat=T_parent_object.quat_wxyz)
    body.add_freejoint(name=f"{item.name}:free")
    _set_inertia(body, item)
    return body


def _set_inertia(body: Any, item: CollisionObject) -> None:
    center, inertia = solid_inertia(item.shapes, item.mass_kg)
    body.explicitinertial = True
    body.mass, body.ipos, body.fullinertia = item.mass_kg, center, full_inertia(inertia)


def friction_coefficients(item: CollisionObject) -> list[float]:
    """Return the material of a scene object as MuJoCo's list of coefficients: sliding, torsional and rolling
    friction.
    """
    return [item.material.friction, item.material.torsional_friction, item.material.rolling_friction]


def _add_belt(body: Any, name: str, velocity: tuple[float, float, float]) -> None:
    """Add a slide joint to the MuJoCo body of a scene object that is a conveyor belt, along the belt's
    direction of motion.

    Before every step, the world resets the joint's position to zero and its velocity to the belt speed. The
    belt therefore does not move, but the objects in contact with it see a moving surface.
    """
    speed = float(np.linalg.norm(velocity))
    body.add_joint(name=belt_name(name), type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.asarray(velocity) / speed)
    body.explicitinertial = True
    body.mass, body.inertia = _BELT_MASS, [_BELT_MASS] * 3
    body.gravcomp = 1.0


def _add_thread(spec: mujoco.MjSpec, body: Any, name: str, thread: ScrewThread) -> None:
    """Add a slide joint and a hinge joint to the MuJoCo body of a screwed-in scene object. The pitch of the
    thread couples the two joints.
    """
    per_radian = thread.pitch / (2 * np.pi)
    turns, axis = thread.travel / per_radian, [0.0, 0.0, 1.0]
    # In MuJoCo, a coupling of light joints is soft, so both joints get additional armature.
    for kind, joint, low, loss, armature in (
        (mujoco.mjtJoint.mjJNT_SLIDE, slide_name(name), -thread.travel, 0.0, 1.0),
        (mujoco.mjtJoint.mjJNT_HINGE, turn_name(name), -turns, thread.torque, 0.02),
    ):
        body.add_joint(
            name=joint, type=kind, axis=axis, limited=True, range=[low, -low * 0.1], frictionloss=loss,
            armature=armature, damping=[1e-3, 0.0, 0.0],
        )  # fmt: skip
    spec.add_equality(
        name=f"{name}:thread", type=mujoco.mjtEq.mjEQ_JOINT, name1=slide_name(name), name2=turn_name(name),
        data=[0.0, per_radian] + [0.0] * 10, solref=[0.004, 1.0], solimp=[0.9999, 0.9999, 0.001, 0.5, 2.0],
    )  # fmt: skip


def belt_name(name: str) -> str:
    return f"{name}:belt"


def slide_name(name: str) -> str:
    return f"{name}:slide"


def turn_name(name: str) -> str:
    return f"{name}:turn"


def weld_name(item: str, gripper: str) -> str:
    return f"{item}:{gripper}:weld"


def write_free(data: mujoco.MjData, start: int, T_world_object: SE3) -> None:
    """Write the pose of a free scene object into MuJoCo's qpos. The entries of the object's joint begin at
    index `start`.
    """
    data.qpos[start : start + 3] = T_world_object.translation
    data.qpos[start + 3 : start + 7] = T_world_object.quat_wxyz


class FixedBodyPoses:
    """Poses of the fixed bodies, such as fixed objects, in a compiled MuJoCo model. A body can be moved; the
    next reset restores the original poses.
    """

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self._first = self.get_state()

    def put(self, body: int, T_world_body: SE3) -> None:
        self._model.body_pos[body] = T_world_body.translation
        self._model.body_quat[body] = T_world_body.quat_wxyz

    def has_moved(self, body: int) -> bool:
        """Return whether the current pose of a fixed body, such as a fixed object, differs from its pose in
        the compiled MuJoCo model.
        """
        position, quaternion = self._first
        moved = (self._model.body_pos[body] != position[body]).any()
        return bool(moved or (self._model.body_quat[body] != quaternion[body]).any())

    def reset(self) -> None:
        self.set_state(self._first)

    def get_state(self) -> Poses:
        return self._model.body_pos.copy(), self._model.body_quat.copy()

    def set_state(self, poses: Poses) -> None:
        self._model.body_pos[:], self._model.body_quat[:] = poses
