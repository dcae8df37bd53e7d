"""Drawing of perception results into an image: object edges, axes and names."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, CameraImage, Pinhole, Shape
from armcell.perception.markers import DetectedMarker
from armcell.perception.object_detection import DetectionResult
from armcell.perception.solids import surface_mesh

F64 = NDArray[np.float64]
_SHARP = np.deg2rad(25.0)  # [rad] minimum angle between the faces of a sharp edge
_KNOWN, _GUESSED, _MARKER = (40, 200, 60), (255, 150, 20), (230, 60, 220)
_DOUBTFUL = (235, 60, 60)
_AXES = ((235, 50, 50), (50, 190, 50), (60, 90, 250))


def draw_detections(
    image: CameraImage, sight: DetectionResult | None = None, markers: tuple[DetectedMarker, ...] = ()
) -> NDArray[np.uint8]:
    """Return the image (h, w, 3) with the perceived objects and markers drawn over it.

    Objects of the scene are green, fitted boxes, cylinders and spheres orange, and ambiguous objects red, in
    all their poses. Without color, the image shows
    the depth (near is bright).
    """
    from PIL import Image, ImageDraw

    canvas = Image.fromarray(_background(image))
    pen = ImageDraw.Draw(canvas)
    T_camera_world = image.T_world_camera.inverse()
    for item in sight.objects if sight is not None else ():
        if item.T_world_object is None:
            middle = T_camera_world.apply(item.points.mean(axis=0))
            _text(pen, image.pinhole, middle, item.name, (255, 60, 60))
            continue
        color = _DOUBTFUL if not item.ok else _KNOWN if item.known else _GUESSED
        T = T_camera_world @ item.T_world_object
        for pose in (T, *(T_camera_world @ other for other in item.alternatives)):
            for line in _edges(item.shapes):
                _line(pen, image.pinhole, pose.apply(line), color)
        _axes(pen, image.pinhole, T, 0.03)
        _text(pen, image.pinhole, T.translation, item.name, color)
    for marker in markers:
        _axes(pen, image.pinhole, marker.T_camera_marker, 0.03)
        _text(pen, image.pinhole, marker.T_camera_marker.translation, str(marker.id), _MARKER)
    return np.asarray(canvas)


def _background(image: CameraImage) -> NDArray[np.uint8]:
    if image.rgb is not None:
        return image.rgb.copy()
    z = np.zeros((image.pinhole.height, image.pinhole.width)) if image.depth is None else image.depth
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(z) & (z > 0)
    grey = np.zeros(z.shape)
    if seen.any():
        low, high = np.percentile(z[seen], [1, 99])
        grey[seen] = np.clip(230 - 190 * (z[seen] - low) / max(high - low, 1e-6), 30, 230)
    return np.repeat(grey.astype(np.uint8)[:, :, None], 3, 2)


@lru_cache(maxsize=64)
def _edges(shapes: tuple[tuple[Shape, SE3], ...]) -> F64:
    """Return the end points (n, 2, 3) of an object's sharp edges, to draw the object into an image. For a
    smooth object, return some of the mesh edges.
    """
    import trimesh

    mesh = surface_mesh(shapes)
    tri = trimesh.Trimesh(mesh.vertices, mesh.faces)
    sharp = tri.face_adjacency_edges[tri.face_adjacency_angles > _SHARP]
    if len(sharp) < 3:  # a smooth object, e.g. a sphere
        sharp = tri.edges_unique[::4]
    return np.asarray(tri.vertices)[sharp]


def _line(pen, pinhole: Pinhole, ends: F64, color: tuple[int, int, int]) -> None:
    pixels = pinhole.project(ends)
    if np.isfinite(pixels).all():
        pen.line([tuple(p) for p in pixels], fill=color, width=1)


def _axes(pen, pinhole: Pinhole, T: SE3, length: float) -> None:
    for k, color in enumerate(_AXES):
        ends = np.stack([T.translation, T.translation + T.rotation.matrix[:, k] * length])
        _line(pen, pinhole, ends, color)


def _text(pen, pinhole: Pinhole, point: F64, text: str, color: tuple[int, int, int]) -> None:
    u, v = pinhole.project(point)[0]
    if np.isfinite([u, v]).all():
        pen.text((u + 4, v + 4), text, fill=color, stroke_width=1, stroke_fill=(0, 0, 0))
