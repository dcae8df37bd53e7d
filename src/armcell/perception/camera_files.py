"""Camera files: calibration (camera info) in ROS's YAML format, and images with depth as PNG and YAML.

The calibration has the format of ROS's camera_calibration package. An image NAME consists of three
files: NAME.yaml (camera info in ROS's format, and `camera_pose`), NAME_rgb.png, NAME_depth.png (16
bits, in millimeters). An image can also be loaded from a cloud.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from armcell.core import SE3, CameraImage, InputError, Pinhole
from armcell.model.untrusted_files import read_yaml

MODELS = ("plumb_bob", "")
F64 = NDArray[np.float64]
MAX_BYTES = 200_000_000
POSE = "camera_pose"
_SPLAT = 400  # [px] longer side of an image rendered from a point cloud


@dataclass(frozen=True)
class CameraInfo:
    """Content of a camera calibration file: the camera's name, and its intrinsics with distortion."""

    name: str
    pinhole: Pinhole

    def rectified(self) -> Pinhole:
        """Return the intrinsics from a camera calibration file without the distortion. They apply to
        rectified images.
        """
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


def save_image(path: str | Path, image: CameraImage) -> list[Path]:
    """Write a camera image with depth to NAME.yaml, NAME_rgb.png and NAME_depth.png.
    Return the paths of these files.

    Depth is rounded to millimeters, up to 65 m.
    """
    from PIL import Image

    base = Path(path).with_suffix("")
    info = base.with_suffix(".yaml")
    save_camera_info(info, image.camera, image.pinhole)
    T = image.T_world_camera
    data = yaml.safe_load(info.read_text(encoding="utf-8"))
    data[POSE] = {"xyz": T.translation.tolist(), "quat_xyzw": T.quat_xyzw.tolist()}
    data["stamp"] = float(image.time)
    info.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    written = [info]
    if image.rgb is not None:
        written.append(base.with_name(base.name + "_rgb.png"))
        Image.fromarray(image.rgb).save(written[-1])
    if image.depth is not None:
        z = np.where(np.isfinite(image.depth) & (image.depth > 0), image.depth, 0.0) * 1000
        written.append(base.with_name(base.name + "_depth.png"))
        Image.fromarray(np.clip(np.rint(z), 0, 65535).astype(np.uint16)).save(written[-1])
    return written


def load_image(
    info: str | Path,
    rgb: str | Path | None = None,
    depth: str | Path | None = None,
    T_world_camera: SE3 | None = None,
) -> CameraImage:
    """Load a camera image from its camera info, color and depth files, and rectify it.

    Args:
        info: NAME.yaml. Without `rgb` and `depth`, NAME_rgb.png and NAME_depth.png are used.
        depth: 16-bit PNG in millimeters, or .npy array in meters.
        T_world_camera: overrides the file's `camera_pose`; without both, the camera is at the origin.
    Raises:
        InputError: a file is missing or damaged, or does not match the camera's size.
    """
    file = Path(info)
    camera = load_camera_info(file)
    if rgb is None and depth is None:
        base = file.with_suffix("")
        rgb, depth = (
            p if os.path.exists(p) else None for p in (Path(f"{base}_rgb.png"), Path(f"{base}_depth.png"))
        )
        if rgb is None and depth is None:
            raise InputError(f"no {base.name}_rgb.png and no {base.name}_depth.png beside it", file=file)
    data = read_yaml(file)
    T = T_world_camera
    if T is None:
        T = SE3.from_mapping(data[POSE], POSE) if POSE in data else SE3.identity()
    stamp = data.get("stamp", 0.0)
    if isinstance(stamp, bool) or not isinstance(stamp, int | float):
        raise InputError("needs a number of seconds", file=file, element="stamp")
    color = None if rgb is None else load_rgb(rgb)
    z = None if depth is None else load_depth(depth)
    try:
        image = CameraImage(camera.name, camera.pinhole, T, float(stamp), color, z)
    except InputError as error:
        raise InputError(error.reason, file=file, hint=error.hint) from None
    return rectified(image)


def load_rgb(path: str | Path) -> NDArray[np.uint8]:
    """Load the colors (h, w, 3) uint8 of a camera image from a file."""
    return np.asarray(_opened(path).convert("RGB"), dtype=np.uint8)


def load_depth(path: str | Path) -> NDArray[np.float32]:
    """Load a depth image (h, w) [m] from a file: a 16-bit PNG in millimeters or an .npy file in meters."""
    file = Path(path)
    if file.suffix.lower() == ".npy":
        try:
            array = np.load(file, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise InputError(f"cannot be read as a NumPy array: {error}", file=file) from None
        if not isinstance(array, np.ndarray):
            raise InputError("is an archive of arrays (.npz), depth is one array", file=file)
        if array.ndim != 2 or array.dtype.kind != "f":
            raise InputError(
                f"holds {array.dtype} of shape {array.shape}, depth needs meters (h, w)", file=file
            )
        return array.astype(np.float32)
    picture = _opened(file)
    if picture.mode not in ("I;16", "I;16B", "I"):
        raise InputError(
            f"is a picture of kind {picture.mode!r}, depth needs 16 bits of millimeters", file=file,
            hint="write it as mono16, or as .npy of meters",
        )  # fmt: skip
    return (np.asarray(picture).astype(np.float32) * np.float32(1e-3)).astype(np.float32)


def _opened(path: str | Path):
    from PIL import Image, UnidentifiedImageError

    file = Path(path)
    try:
        if file.stat().st_size > MAX_BYTES:
            raise InputError(f"is larger than {MAX_BYTES} bytes", file=file)
        # From memory: from a file, a damaged chunk length of 2 GB reserves 2 GB.
        picture = Image.open(io.BytesIO(file.read_bytes()))
        picture.load()
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError) as error:
        raise InputError(f"cannot be read as a picture: {error}", file=file) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=file) from None
    return picture


def cloud_image(points: F64, T_world_camera: SE3, name: str = "cloud") -> CameraImage:
    """Convert the points (n, 3) [m, world frame] from a cloud file to a camera image with depth, as if it
    were loaded from camera files. The camera sees all points.

    Raises:
        InputError: no points are in front of the camera.
    """
    p = T_world_camera.inverse().apply(points)
    p = p[np.isfinite(p).all(axis=1) & (p[:, 2] > 1e-3)]
    if len(p) < 10:
        raise InputError("no points in front of the camera", hint="give the sensor's place and direction")
    x, y = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    low, high = np.array([x.min(), y.min()]), np.array([x.max(), y.max()])
    spread = np.maximum(high - low, 1e-3)
    pixels = float(np.clip(np.sqrt(len(p) * spread.max() / spread.min()) * 0.9, 32, _SPLAT))
    f = pixels / float(spread.max())
    width, height = (int(v) + 1 for v in np.ceil(spread * f))
    pinhole = Pinhole(width, height, f, f, float(-low[0] * f), float(-low[1] * f))
    u, v = np.rint(x * f + pinhole.cx).astype(int), np.rint(y * f + pinhole.cy).astype(int)
    depth = np.full((height, width), np.inf, np.float32)
    np.minimum.at(depth, (np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)), p[:, 2].astype(np.float32))
    depth[~np.isfinite(depth)] = 0.0
    return CameraImage(name, pinhole, T_world_camera, 0.0, None, depth)
