"""Conversion of shapes, meshes and robot links to colored triangles and viser scene nodes.

viser quaternions are scalar first. Colors are RGBA in 0..1, as everywhere in armcell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
import trimesh
from numpy.typing import NDArray

from armcell.core import SE3, Box, Capsule, Cone, Cylinder, Mesh, Octree, Plane, PointCloud, Shape, Sphere
from armcell.model.assets import DEFAULT_COLOR, load_visual_parts
from armcell.model.mesh_decimation import decimated
from armcell.model.robot import Link, Visual

if TYPE_CHECKING:
    from viser import SceneApi

Array = NDArray[np.float64]
Color = tuple[float, float, float, float]

COLLISION_COLOR: Color = (0.90, 0.45, 0.0, 0.45)
COLLISION_SWELL_M = 0.0015
MAX_FACES = 10_000
"""Maximum faces per colored mesh part; larger parts are decimated, because software rendering is slow."""
SMOOTH_ANGLE = np.deg2rad(35.0)
"""Edges with a larger angle [rad] between their faces are shaded as sharp edges."""
MAX_POINTS = 100_000
"""Maximum number of points drawn per point cloud."""
PLANE_DRAWN_M = 6.0
PLANE_THICKNESS_M = 0.01
_SECTIONS = 32


@dataclass(frozen=True, eq=False)
class ColoredMesh:
    """Triangle mesh in a single color, drawn by the viewer. The vertices [m] are in the frame of the link or
    object to which the mesh belongs.
    """

    vertices: Array  # (v, 3)
    faces: NDArray[np.int32]  # (f, 3)
    color: Color


# --- shapes ---
def _plane(_: Plane) -> trimesh.Trimesh:
    slab = trimesh.creation.box((PLANE_DRAWN_M, PLANE_DRAWN_M, PLANE_THICKNESS_M))
    return slab.apply_translation((0.0, 0.0, -PLANE_THICKNESS_M / 2))


def _cone(shape: Cone) -> trimesh.Trimesh:
    cone = trimesh.creation.cone(shape.radius, shape.length, sections=_SECTIONS)
    return cone.apply_translation((0.0, 0.0, -shape.length / 2))  # trimesh puts the base at z = 0


def _capsule(shape: Capsule) -> trimesh.Trimesh:
    capsule = trimesh.creation.capsule(shape.length, shape.radius, count=(_SECTIONS, _SECTIONS))
    return capsule.apply_translation(-capsule.bounds.mean(axis=0))


_TESSELLATE: dict[type, Callable[[Any], trimesh.Trimesh]] = {
    Box: lambda s: trimesh.creation.box((s.x, s.y, s.z)),
    Sphere: lambda s: trimesh.creation.icosphere(3, s.radius),
    Cylinder: lambda s: trimesh.creation.cylinder(s.radius, s.length, sections=_SECTIONS),
    Capsule: _capsule,
    Cone: _cone,
    Plane: _plane,
    Mesh: lambda s: trimesh.Trimesh(s.vertices, s.faces, process=False),
}


def shape_part(shape: Shape, color: Color) -> ColoredMesh:
    """Convert a shape to a triangle mesh that the viewer draws. An infinite plane becomes a thin slab."""
    kind = Mesh if isinstance(shape, Mesh) else type(shape)
    return _shaded(_TESSELLATE[kind](shape), color)


def collision_part(shape: Shape) -> ColoredMesh:
    """Return the mesh that shows a collision shape in the viewer.
    It is translucent and slightly larger than the shape.

    The inflation avoids flicker where the collision shape coincides with the visual mesh.
    """
    part = shape_part(shape, COLLISION_COLOR)
    normals = trimesh.Trimesh(part.vertices, part.faces, process=False).vertex_normals
    return ColoredMesh(part.vertices + COLLISION_SWELL_M * normals, part.faces, part.color)


# --- mesh files ---
@lru_cache(maxsize=256)
def file_parts(path: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> tuple[ColoredMesh, ...]:
    """Load a visual mesh file as meshes for the viewer, one per color. Large meshes are decimated.

    Raises:
        InputError: the file is unreadable or contains no triangles.
    """
    return tuple(
        _shaded(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), color)
        for mesh, color in load_visual_parts(path, scale)
    )


def _shaded(mesh: Any, color: Color) -> ColoredMesh:
    """Merge the pieces of a mesh for the viewer, reduce their triangles, and split the result at sharp edges.

    A browser shades smoothly across shared vertices; the split keeps sharp edges visible.
    """
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    vertices, faces = decimated(np.asarray(mesh.vertices), np.asarray(mesh.faces), MAX_FACES)
    split = trimesh.graph.smooth_shade(trimesh.Trimesh(vertices, faces, process=False), angle=SMOOTH_ANGLE)
    return ColoredMesh(np.asarray(split.vertices), np.asarray(split.faces, dtype=np.int32), color)


# --- viser nodes ---
def node_name(*parts: str) -> str:
    """Return the name of a scene node in the viewer (viser) under which geometry is drawn, built from the
    given name parts.

    Slashes inside a part are percent-encoded, so that they do not add a level to the scene tree.
    """
    return "/" + "/".join(quote(part, safe="") for part in parts)


def add_part(api: SceneApi, name: str, part: ColoredMesh, T: SE3, visible: bool = True) -> Any:
    """Draw a mesh in the viewer (viser) at the pose `T`, given in the frame of the parent node.

    Returns:
        viser's handle.
    """
    alpha = part.color[3]
    return api.add_mesh_simple(
        name,
        part.vertices,
        part.faces,
        color=tuple(round(255 * c) for c in part.color[:3]),  # pyright: ignore[reportArgumentType]
        opacity=None if alpha >= 1.0 else alpha,
        side="double",
        wxyz=T.quat_wxyz,
        position=T.translation,
        visible=visible,
    )


def visual_parts(visual: Visual) -> tuple[ColoredMesh, ...]:
    """Return the meshes that the viewer draws for one visual element of a link.

    A color given in the URDF overrides the colors of the mesh file, as in RViz.
    """
    if visual.shape is not None:
        return (shape_part(visual.shape, visual.color or DEFAULT_COLOR),)
    if visual.file is None:
        return ()
    parts = file_parts(visual.file, visual.scale)
    if visual.color is None:
        return parts
    return tuple(ColoredMesh(p.vertices, p.faces, visual.color) for p in parts)


def add_link(api: SceneApi, name: str, link: Link) -> tuple[list[Any], list[Any]]:
    """Draw the meshes of a robot link in the viewer, below the viser scene node `name`.

    A link without visual elements shows its collision shapes in gray.

    Returns:
        viser handles of the visual meshes, and of the collision shapes (hidden at first).
    """
    drawn = [(p, v.T_link_visual) for v in link.visuals for p in visual_parts(v)]
    if not drawn:
        drawn = [(shape_part(c.shape, DEFAULT_COLOR), c.T_link_shape) for c in link.collisions]
    visuals = [add_part(api, f"{name}/visual/{i}", part, T) for i, (part, T) in enumerate(drawn)]
    collisions = [
        add_part(api, f"{name}/collision/{i}", collision_part(c.shape), c.T_link_shape, visible=False)
        for i, c in enumerate(link.collisions)
    ]
    return visuals, collisions


def _add_points(api: SceneApi, name: str, shape: PointCloud, T: SE3, color: Color) -> Any:
    points = shape.points[:: max(len(shape.points) // MAX_POINTS, 1)]
    return api.add_point_cloud(
        name,
        points.astype(np.float32),
        tuple(round(255 * c) for c in color[:3]),  # pyright: ignore[reportArgumentType]
        point_size=2 * shape.radius,
        wxyz=T.quat_wxyz,
        position=T.translation,
    )


def _add_cells(api: SceneApi, name: str, shape: Octree, T: SE3, color: Color) -> Any:
    cube = trimesh.creation.box((1.0, 1.0, 1.0))
    some = np.argsort(-shape.sizes, kind="stable")[:MAX_POINTS]  # only the largest cells are drawn
    return api.add_batched_meshes_simple(
        name,
        np.asarray(cube.vertices, np.float32),
        np.asarray(cube.faces),
        batched_wxyzs=np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (len(some), 1)),
        batched_positions=shape.centers[some],
        batched_scales=shape.sizes[some],
        batched_colors=tuple(round(255 * c) for c in color[:3]),  # pyright: ignore[reportArgumentType]
        wxyz=T.quat_wxyz,
        position=T.translation,
    )


def add_object_shape(api: SceneApi, name: str, shape: Shape, T: SE3, color: Color) -> Any:
    """Draw the shape of an object in the viewer and return its viser handle.

    A plane gets a grid on top; point clouds are drawn as points and octrees as cubes.
    """
    if isinstance(shape, PointCloud):
        return _add_points(api, name, shape, T, color)
    if isinstance(shape, Octree):
        return _add_cells(api, name, shape, T, color)
    handle = add_part(api, name, shape_part(shape, color), T)
    if isinstance(shape, Plane):
        api.add_grid(
            f"{name}/grid",
            width=PLANE_DRAWN_M,
            height=PLANE_DRAWN_M,
            cell_size=0.1,
            section_size=0.5,
            cell_color=(175, 175, 175),
            section_color=(130, 130, 130),
            position=(0.0, 0.0, 0.001),  # above the slab, to avoid flicker
        )
    return handle
