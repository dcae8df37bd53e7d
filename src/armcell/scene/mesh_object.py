"""Objects from mesh files, looked at before they are used: the units, whether they are closed and solid."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from armcell.core import SE3, InputError, Mesh
from armcell.model.assets import load_mesh
from armcell.scene.objects import CollisionObject

log = logging.getLogger(__name__)

LARGEST_MOVABLE = 3.0  # [m] along one axis; what is larger was hardly meant to be gripped
LARGEST = 200.0  # [m] of what stands: a hall
SMALLEST = 5e-4  # [m] along the longest axis


@dataclass(frozen=True)
class MeshFacts:
    """What was found out about a mesh."""

    size: tuple[float, float, float]  # [m] along its axes
    closed: bool  # every edge has two triangles, consistently turned
    open_edges: int
    convex: bool
    volume: float  # [m^3]; of the convex hull where it is not closed


def mesh_facts(mesh: Mesh) -> MeshFacts:
    """What a mesh is like.

    Raises:
        InputError: it is flat: it has no volume, so nothing can be held and nothing has an inertia.
    """
    import trimesh

    x, y, z = (float(v) for v in np.ptp(mesh.vertices, axis=0))
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    _, count = np.unique(np.sort(solid.edges, axis=1), axis=0, return_counts=True)
    if min(x, y, z) < 1e-9:
        raise InputError("mesh is flat: it has no volume", file=mesh.file, cure="give it a thickness")
    hull = float(solid.convex_hull.volume)
    closed = bool(solid.is_watertight and abs(solid.volume) > 0)
    volume = abs(float(solid.volume)) if closed else hull
    return MeshFacts((x, y, z), closed, int(np.sum(count != 2)), closed and volume > 0.98 * hull, volume)


def check_mesh(mesh: Mesh, movable: bool) -> MeshFacts:
    """Refuse what cannot be meant, warn of what will be guessed.

    Raises:
        InputError: a size that only a wrong unit explains (with the scale that would cure it), or no volume.
    """
    facts = mesh_facts(mesh)
    size = max(facts.size)
    if size > (LARGEST_MOVABLE if movable else LARGEST):
        raise InputError(
            f"mesh is {size:.4g} m large: it is probably in millimetres",
            file=mesh.file, cure="give 'scale: 0.001'",
        )  # fmt: skip
    if size < SMALLEST:
        raise InputError(
            f"mesh is {size * 1000:.2g} mm large: it is probably in kilometres or was scaled twice",
            file=mesh.file, cure="give 'scale: 1000'",
        )  # fmt: skip
    if movable and not facts.closed:
        log.warning(
            "%s: mesh is not closed (%d open edges): its mass and inertia are those of its convex hull; "
            "close it or give a mass",
            mesh.file or "mesh", facts.open_edges,
        )  # fmt: skip
    return facts


def mesh_object(
    name: str,
    file: str | Path,
    pose: SE3 | None = None,
    scale: float = 1.0,
    density: float | None = None,
    movable: bool = True,
    **properties,
) -> CollisionObject:
    """An object of one mesh file: OBJ, STL, PLY, GLB, DAE or OFF.

    Args:
        scale: metres per unit of the file.
        density: [kg/m^3]; gives the mass, unless `mass` is among the properties.
        properties: of `CollisionObject`.
    Raises:
        InputError: unreadable, flat, or of a size that cannot be meant.
    """
    mesh = load_mesh(Path(file), (scale, scale, scale))
    facts = check_mesh(mesh, movable)
    if density is not None:
        properties.setdefault("mass", density * facts.volume)
    return CollisionObject.single(name, mesh, pose, movable=movable, **properties)
