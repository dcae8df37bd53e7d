"""Conversion of collision and visual shapes to MuJoCo geoms, and loading of a link's visual meshes."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.collision.convex_decomposition import convex_pieces
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
    """Builder that converts shapes to geoms in a MuJoCo spec. Geoms with the same mesh share one asset."""

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
        """Add colliding geoms for one shape to a MuJoCo body and return them.

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
        """Add a mesh geom to a MuJoCo body. If the mesh is not `convex`, it is only visual."""
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
    """Convert a cone to a closed convex mesh for MuJoCo. The vertices of its base are on a circle."""
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
    """Return the inertia matrix (3, 3) of a shape as a list in the order that MuJoCo uses.

    The order is xx, yy, zz, xy, xz, yz.
    """
    return [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
