"""Collision objects from mesh files, with checks for wrong units and open surfaces."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from armcell.core import SE3, InputError, Mesh, open_edges, with_small_holes_filled
from armcell.model.assets import load_mesh
from armcell.scene.objects import CollisionObject

log = logging.getLogger(__name__)

LARGEST_MOVABLE = 3.0  # [m] along one axis: a larger object is hardly meant to be grasped
LARGEST = 200.0  # [m] along one axis of a fixed object, such as a factory hall
SMALLEST = 5e-4  # [m] along the longest axis


@dataclass(frozen=True)
class MeshFacts:
    """Measurements of an object that a mesh file describes: its size and volume, and whether it is closed and
    convex.
    """

    size: tuple[float, float, float]  # [m] along its axes
    closed: bool  # the mesh encloses a volume
    open_edges: int
    convex: bool
    volume: float  # [m^3]; that of the convex hull if the mesh is not closed


def mesh_facts(mesh: Mesh) -> MeshFacts:
    """Measure the mesh of an object: its size and volume, and whether it is closed and convex.

    Raises:
        InputError: the mesh is flat, so it has no volume and no inertia.
    """
    import trimesh

    x, y, z = (float(v) for v in np.ptp(mesh.vertices, axis=0))
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if min(x, y, z) < 1e-9:
        raise InputError("mesh is flat: it has no volume", file=mesh.file, hint="give it a thickness")
    hull = float(solid.convex_hull.volume)
    holes = len(open_edges(mesh))
    with np.errstate(invalid="ignore"):  # a sheet with two faces encloses nothing
        enclosed = abs(float(solid.volume))
    closed = not holes and enclosed > 0
    volume = enclosed if closed else hull
    return MeshFacts((x, y, z), closed, holes, closed and volume > 0.98 * hull, volume)


def check_mesh(mesh: Mesh, movable: bool) -> MeshFacts:
    """Check the mesh of an object: reject an implausible size, and warn if the mesh is not closed.

    For a movable object with an open mesh, mass and inertia are those of the convex hull.

    Args:
        mesh: the mesh [m].
        movable: whether the object is movable, with a smaller size limit (3 m instead of 200 m).
    Raises:
        InputError: only a wrong unit explains the size (the message suggests a scale), or the mesh is flat.
    """
    facts = mesh_facts(mesh)
    size = max(facts.size)
    if size > (LARGEST_MOVABLE if movable else LARGEST):
        raise InputError(
            f"mesh is {size:.4g} m large: it is probably in millimeters",
            file=mesh.file, hint="give 'scale: 0.001'",
        )  # fmt: skip
    if size < SMALLEST:
        raise InputError(
            f"mesh is {size * 1000:.2g} mm large: it is probably in kilometers or was scaled twice",
            file=mesh.file, hint="give 'scale: 1000'",
        )  # fmt: skip
    if movable and not facts.closed:
        _warn_open(mesh.file or "mesh", facts.open_edges)
    return facts


@lru_cache(maxsize=1024)
def _warn_open(file: str, open_edges: int) -> None:
    """Warn once per process that a mesh is not closed: a cell loads its meshes several times."""
    log.warning(
        "%s: mesh is not closed (%d open edges): its mass and inertia are those of its convex hull; "
        "close it or give a mass",
        file, open_edges,
    )  # fmt: skip


def mesh_object(
    name: str,
    file: str | Path,
    pose: SE3 | None = None,
    scale: float = 1.0,
    density: float | None = None,
    movable: bool = True,
    **properties,
) -> CollisionObject:
    """Create a collision object from a mesh file (OBJ, STL, PLY, GLB, DAE or OFF).

    Small holes in the mesh of a movable object are filled.

    Args:
        name: name of the object.
        file: the mesh file.
        pose: T_world_object; by default the identity.
        scale: meters per unit of the file.
        density: [kg/m^3] from which the mass follows, unless `properties` contain `mass`.
        movable: whether the object can be moved.
        properties: other fields of `CollisionObject`.
    Raises:
        InputError: the mesh is not readable, flat, or of an implausible size.
    """
    mesh = load_mesh(Path(file), (scale, scale, scale))
    mesh = with_small_holes_filled(mesh) if movable else mesh
    facts = check_mesh(mesh, movable)
    if density is not None:
        properties.setdefault("mass", density * facts.volume)
    return CollisionObject.single(name, mesh, pose, movable=movable, **properties)
