"""Shapes as MuJoCo geoms, and the inertia of a solid."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from armcell.collision.convex import convex_pieces
from armcell.core import SE3, Box, Capsule, Cone, Cylinder, Mesh, Plane, Shape, Sphere
from armcell.scene import shape_volume

Array = NDArray[np.float64]
GEOM = mujoco.mjtGeom
_CONE_EDGES = 48

_PRIMITIVES: dict[type, tuple[Any, Callable[[Any], list[float]]]] = {
    Box: (GEOM.mjGEOM_BOX, lambda s: [s.x / 2, s.y / 2, s.z / 2]),
    Sphere: (GEOM.mjGEOM_SPHERE, lambda s: [s.radius, 0, 0]),
    Cylinder: (GEOM.mjGEOM_CYLINDER, lambda s: [s.radius, s.length / 2, 0]),
    Capsule: (GEOM.mjGEOM_CAPSULE, lambda s: [s.radius, s.length / 2, 0]),
    Plane: (GEOM.mjGEOM_PLANE, lambda s: [0, 0, 1]),  # zero: infinite
}


class GeomAdder:
    """Adds shapes to bodies of one spec; each mesh piece becomes an asset once."""

    def __init__(self, spec: mujoco.MjSpec):
        self.spec = spec
        self._assets: dict[int, str] = {}
        self._kept: list[Mesh] = []  # ids stay valid while the meshes live

    def add_solid(self, body: Any, shape: Shape, T_body_shape: SE3, name: str, **values: Any) -> list[Any]:
        """Colliding geoms of one shape: a primitive stays one, a mesh becomes its convex pieces."""
        kind = _PRIMITIVES.get(type(shape))
        if kind is not None:
            return [self._geom(body, T_body_shape, name, type=kind[0], size=kind[1](shape), **values)]
        mesh = cone_mesh(shape) if isinstance(shape, Cone) else shape
        assert isinstance(mesh, Mesh)
        return [
            self.add_mesh(body, piece, T_body_shape, f"{name}.{i}", convex=True, **values)
            for i, piece in enumerate(convex_pieces(mesh))
        ]

    def add_mesh(
        self, body: Any, mesh: Mesh, T_body_mesh: SE3, name: str, convex: bool = False, **values: Any
    ) -> Any:
        """One mesh geom. A mesh that is not `convex` is for drawing only."""
        asset = self._assets.get(id(mesh))
        if asset is None:
            asset = self._assets[id(mesh)] = f"mesh{len(self._assets)}"
            self._kept.append(mesh)
            inertia = mujoco.mjtMeshInertia
            self.spec.add_mesh(
                name=asset,
                uservert=mesh.vertices.ravel(),
                userface=mesh.faces.ravel(),
                # a visual mesh may be open or flat, so its volume means nothing
                inertia=inertia.mjMESH_INERTIA_CONVEX if convex else inertia.mjMESH_INERTIA_SHELL,
            )
        return self._geom(body, T_body_mesh, name, type=GEOM.mjGEOM_MESH, meshname=asset, **values)

    @staticmethod
    def _geom(body: Any, T: SE3, name: str, **values: Any) -> Any:
        return body.add_geom(name=name, pos=T.translation, quat=T.quat_wxyz, **values)


def cone_mesh(cone: Cone, edges: int = _CONE_EDGES) -> Mesh:
    """A cone as a closed convex mesh, base corners on the circle."""
    angle = 2 * np.pi * np.arange(edges) / edges
    base = np.stack(
        [cone.radius * np.cos(angle), cone.radius * np.sin(angle), 0 * angle - cone.length / 2], 1
    )
    vertices = np.vstack([base, [0, 0, -cone.length / 2], [0, 0, cone.length / 2]])
    i, j = np.arange(edges), (np.arange(edges) + 1) % edges
    foot = np.stack([j, i, np.full(edges, edges)], 1)
    side = np.stack([i, j, np.full(edges, edges + 1)], 1)
    return Mesh(vertices, np.vstack([foot, side]).astype(np.int32))


def _unit_inertia(shape: Shape) -> tuple[Array, Array]:
    """Centre of mass (3,) [m] and inertia (3, 3) [m^2] about it, of one kilogram of a uniform solid."""
    match shape:
        case Box():
            x, y, z = shape.x**2, shape.y**2, shape.z**2
            return np.zeros(3), np.diag([y + z, x + z, x + y]) / 12
        case Sphere():
            return np.zeros(3), np.eye(3) * 0.4 * shape.radius**2
        case Cylinder():
            r, h = shape.radius**2, shape.length**2
            return np.zeros(3), np.diag([r / 4 + h / 12, r / 4 + h / 12, r / 2])
        case Cone():
            r, h = shape.radius**2, shape.length**2
            side = 3 / 20 * r + 3 / 80 * h
            return np.array([0, 0, -shape.length / 4]), np.diag([side, side, 0.3 * r])
        case Capsule():
            r, h = shape.radius, shape.length
            ball = 4 / 3 * r / (h + 4 / 3 * r)  # the two half spheres' share of the mass
            rod = 1 - ball
            axial = rod * r**2 / 2 + ball * 0.4 * r**2
            side = rod * (r**2 / 4 + h**2 / 12) + ball * (0.4 * r**2 + h**2 / 4 + 3 / 8 * h * r)
            return np.zeros(3), np.diag([side, side, axial])
        case Mesh():
            mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
            if not (mesh.is_watertight and abs(mesh.volume) > 0):
                mesh = mesh.convex_hull
            return np.array(mesh.center_mass), np.array(mesh.moment_inertia) / mesh.volume
        case Plane():
            raise ValueError("a plane has no inertia")


def solid_inertia(shapes: Iterable[tuple[Shape, SE3]], mass: float) -> tuple[Array, Array]:
    """Centre of mass (3,) [m] and inertia (3, 3) [kg m^2] about it, in the object's frame.

    The mass is spread evenly over the shapes' volumes (overlaps count twice).
    """
    parts = []
    volumes = []
    for shape, T in shapes:
        centre, inertia = _unit_inertia(shape)
        R = T.rotation.matrix
        parts.append((T.apply(centre), R @ inertia @ R.T))
        volumes.append(shape_volume(shape))
    masses = mass * np.array(volumes) / sum(volumes)
    centre = masses @ np.array([c for c, _ in parts]) / mass
    total = np.zeros((3, 3))
    for m, (c, inertia) in zip(masses, parts, strict=True):
        d = c - centre
        total += m * (inertia + (d @ d) * np.eye(3) - np.outer(d, d))
    return centre, total
