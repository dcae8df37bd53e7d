"""Camera calibration files in the YAML format of ROS's camera_calibration package."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from armcell.core import CameraImage, InputError, Pinhole
from armcell.model.untrusted_files import read_yaml

MODELS = ("plumb_bob", "")


@dataclass(frozen=True)
class CameraInfo:
    """A calibrated camera: its name and its intrinsics with distortion."""

    name: str
    pinhole: Pinhole

    def rectified(self) -> Pinhole:
        """Return the intrinsics of a calibrated camera without distortion. They apply to rectified images."""
        p = self.pinhole
        return Pinhole(p.width, p.height, p.fx, p.fy, p.cx, p.cy)


def load_camera_info(path: str | Path) -> CameraInfo:
    """Load a camera calibration file as written by ROS's `cameracalibrator` or read by image_transport.

    Raises:
        InputError: a key is missing or has the wrong size, or the distortion model is not plumb_bob.
    """
    file = Path(path)
    data = read_yaml(file)

    def numbers(key: str, sizes: tuple[int, ...]) -> np.ndarray:
        entry = data.get(key)
        values = entry.get("data") if isinstance(entry, dict) else entry
        try:
            array = np.asarray(values, dtype=float).ravel()
        except (TypeError, ValueError):
            array = np.zeros(0)
        if array.size not in sizes or not np.all(np.isfinite(array)):
            raise InputError(f"needs {' or '.join(map(str, sizes))} numbers", file=file, element=key)
        return array

    size: list[int] = []
    for key in ("image_width", "image_height"):
        value = data.get(key)
        if not isinstance(value, int) or isinstance(value, bool):
            raise InputError("needs a whole number of pixels", file=file, element=key)
        size.append(value)
    K = numbers("camera_matrix", (9,)).reshape(3, 3)
    model = str(data.get("distortion_model", ""))
    if model not in MODELS:
        raise InputError(
            f"distortion model {model!r} is not known", file=file, element="distortion_model",
            hint="calibrate with plumb_bob, or rectify the pictures and leave the distortion out",
        )  # fmt: skip
    distortion = ()
    if "distortion_coefficients" in data:
        d = numbers("distortion_coefficients", (0, 4, 5))
        distortion = tuple(float(v) for v in d) if np.any(d) else ()
    try:
        fx, fy, cx, cy = (float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
        pinhole = Pinhole(size[0], size[1], fx, fy, cx, cy, distortion)
    except InputError as error:
        raise InputError(error.reason, file=file, hint=error.hint) from None
    return CameraInfo(str(data.get("camera_name", file.stem)), pinhole)


def save_camera_info(path: str | Path, name: str, pinhole: Pinhole) -> None:
    """Write a camera calibration file that both ROS and `load_camera_info` can read."""
    p = pinhole
    d = [*p.distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5]

    def matrix(rows: int, columns: int, values: list[float]) -> dict[str, Any]:
        return {"rows": rows, "cols": columns, "data": [float(v) for v in values]}

    data = {
        "image_width": p.width,
        "image_height": p.height,
        "camera_name": name,
        "camera_matrix": matrix(3, 3, [p.fx, 0, p.cx, 0, p.fy, p.cy, 0, 0, 1]),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": matrix(1, 5, d),
        "rectification_matrix": matrix(3, 3, [1, 0, 0, 0, 1, 0, 0, 0, 1]),
        "projection_matrix": matrix(3, 4, [p.fx, 0, p.cx, 0, 0, p.fy, p.cy, 0, 0, 0, 1, 0]),
    }
    Path(path).write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")


def rectified(image: CameraImage) -> CameraImage:
    """Remove the lens distortion from an image of a calibrated camera and return the image.
    The focal length does not change.

    The distortion model is Brown's, as in OpenCV.

    Color is interpolated. Depth uses the nearest pixel, because interpolation would mix depths across edges.
    Pixels outside the original image are black and have no depth.
    """
    p = image.pinhole
    if not p.distortion:
        return image
    k1, k2, p1, p2, k3 = (*p.distortion, 0.0)[:5]
    v, u = np.mgrid[0 : p.height, 0 : p.width]
    x, y = (u - p.cx) / p.fx, (v - p.cy) / p.fy
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    column, row = xd * p.fx + p.cx, yd * p.fy + p.cy
    inside = (column >= 0) & (column <= p.width - 1) & (row >= 0) & (row <= p.height - 1)
    rgb = depth = None
    if image.depth is not None:
        at = np.rint(row[inside]).astype(int), np.rint(column[inside]).astype(int)
        depth = np.zeros_like(image.depth)
        depth[inside] = image.depth[at]
    if image.rgb is not None:
        i, j = np.floor(row[inside]).astype(int), np.floor(column[inside]).astype(int)
        i2, j2 = np.minimum(i + 1, p.height - 1), np.minimum(j + 1, p.width - 1)
        f, g = (row[inside] - i)[:, None], (column[inside] - j)[:, None]
        c = image.rgb.astype(float)
        mixed = (c[i, j] * (1 - g) + c[i, j2] * g) * (1 - f) + (c[i2, j] * (1 - g) + c[i2, j2] * g) * f
        rgb = np.zeros_like(image.rgb)
        rgb[inside] = np.rint(mixed).astype(np.uint8)
    plain = Pinhole(p.width, p.height, p.fx, p.fy, p.cx, p.cy)
    return CameraImage(image.camera, plain, image.T_world_camera, image.time, rgb, depth)
