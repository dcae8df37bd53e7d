"""Visual meshes, one per colour."""

from __future__ import annotations

import logging
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh

from armcell.core import Mesh
from armcell.model import Visual
from armcell.model.assets import MAX_MESH_BYTES, MESH_SUFFIXES

log = logging.getLogger(__name__)

Color = tuple[float, float, float, float]
DEFAULT_COLOR: Color = (0.75, 0.75, 0.77, 1.0)


def visual_parts(visual: Visual) -> tuple[tuple[Mesh, Color], ...]:
    """The meshes [m, visual frame] and RGBA colours of a visual mesh file; none if it cannot be read.

    A picture without one link is better than no run at all, so a broken file is logged, not raised.
    """
    if visual.file is None:
        return ()
    parts = _file_parts(visual.file, visual.scale)
    return parts if visual.color is None else tuple((mesh, visual.color) for mesh, _ in parts)


@lru_cache(maxsize=256)
def _file_parts(file: Path, scale: tuple[float, float, float]) -> tuple[tuple[Mesh, Color], ...]:
    if file.suffix.lower() not in MESH_SUFFIXES or file.stat().st_size > MAX_MESH_BYTES:
        log.warning("visual mesh %s is not drawn: its format is not read, or it is too large", file)
        return ()
    try:
        loaded = trimesh.load(file, process=False)
        parts = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
        by_color: dict[Color, list[trimesh.Trimesh]] = {}
        for part in parts:
            if isinstance(part, trimesh.Trimesh) and len(part.faces):
                by_color.setdefault(_color(part), []).append(part)
        return tuple((_merged(meshes, scale, file), color) for color, meshes in by_color.items())
    except Exception as error:  # each mesh library raises its own
        log.warning("visual mesh %s is not drawn: %s", file, error)
        return ()


def _color(part: trimesh.Trimesh) -> Color:
    """Its material's or its mean face colour."""
    source = getattr(part.visual, "material", None) or part.visual
    rgba = np.asarray(getattr(source, "main_color", ()), dtype=float)
    if rgba.shape != (4,):
        return DEFAULT_COLOR
    r, g, b, a = (round(float(v) / 255, 3) for v in rgba)
    return (r, g, b, a if a > 0.05 else 1.0)  # some exporters write opaque parts with alpha 0


def _merged(meshes: list[trimesh.Trimesh], scale: tuple[float, float, float], file: Path) -> Mesh:
    vertices, faces, start = [], [], 0
    for mesh in meshes:
        vertices.append(np.asarray(mesh.vertices) * scale)
        faces.append(np.asarray(mesh.faces) + start)
        start += len(mesh.vertices)
    whole = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    whole.merge_vertices(merge_tex=True, merge_norm=True)  # files keep a vertex per normal
    whole.update_faces(whole.nondegenerate_faces())
    whole.remove_unreferenced_vertices()
    return Mesh(whole.vertices, whole.faces.astype(np.int32), file)
