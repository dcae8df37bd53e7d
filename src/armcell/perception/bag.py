"""Camera data from MCAP records: sensor_msgs Image, CameraInfo, PointCloud2 and tf2_msgs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, CameraImage, InputError, Pinhole
from armcell.model.untrusted_files import BoundedReader
from armcell.perception.camera_files import rectified
from armcell.perception.cloud import meters

F64 = NDArray[np.float64]
MAX_MESSAGES = 200_000
_COLORS = {"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0)),
           "mono8": (1, (0, 0, 0))}  # fmt: skip
_DEPTHS = {"32FC1": np.float32, "16UC1": np.uint16, "mono16": np.uint16}
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


@dataclass(eq=False)
class CameraRecord:
    """Newest camera images, point clouds and transforms in an MCAP file (bag), by the name of the frame."""

    file: Path
    infos: dict[str, Pinhole] = field(default_factory=dict)
    rgb: dict[str, tuple[float, NDArray[np.uint8]]] = field(default_factory=dict)
    depth: dict[str, tuple[float, NDArray[np.float32]]] = field(default_factory=dict)
    clouds: dict[str, tuple[float, F64]] = field(default_factory=dict)  # (n, 3) [m, camera frame]
    transforms: dict[str, tuple[str, SE3]] = field(default_factory=dict)  # child -> parent, T_parent_child

    def pose(self, frame: str) -> SE3:
        """Return the pose T_world_frame of a frame according to the transforms in an MCAP bag of camera data.

        The world is the root of the transform tree.
        """
        T, seen = SE3.identity(), set()
        while frame in self.transforms and frame not in seen:
            seen.add(frame)
            frame, T_parent = self.transforms[frame]
            T = T_parent @ T
        return T

    def image(self, frame: str | None = None) -> CameraImage:
        """Return the newest image in an MCAP bag from the camera with the given frame.

        By default, the camera is the only one.

        Raises:
            InputError: no such camera, several cameras, or no camera info; the text lists the cameras.
        """
        frames = sorted(set(self.rgb) | set(self.depth))
        if frame is None and len(frames) == 1:
            frame = frames[0]
        if frame not in frames:
            what = f"no camera {frame!r}" if frame else f"{len(frames)} cameras"
            raise InputError(f"has {what}; known: {', '.join(frames) or 'none'}", file=self.file)
        if frame not in self.infos:
            raise InputError(
                f"has pictures of {frame!r} but no CameraInfo of it", file=self.file,
                hint="record the camera_info topic too",
            )  # fmt: skip
        stamp, rgb = self.rgb.get(frame, (0.0, None))
        when, depth = self.depth.get(frame, (stamp, None))
        if rgb is not None and depth is not None and rgb.shape[:2] != depth.shape:
            rgb = None  # from another sensor: object poses come from the depth image
        image = CameraImage(frame, self.infos[frame], self.pose(frame), when, rgb, depth)
        return rectified(image)


def load_record(path: str | Path) -> CameraRecord:
    """Read camera images and point clouds from an MCAP bag with ROS 2 messages.

    Raises:
        InputError: the file is not MCAP or is truncated, or an image's data do not match its size.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader
    from rosbags.typesys import Stores, get_typestore

    file, store = Path(path), get_typestore(Stores.ROS2_HUMBLE)
    found, count = CameraRecord(file), 0
    try:
        with file.open("rb") as stream:
            for schema, channel, message in make_reader(cast(Any, BoundedReader(stream))).iter_messages():
                put = _READERS.get(schema.name if schema else "")
                if put is None or channel.message_encoding != "cdr":
                    continue
                count += 1
                if count > MAX_MESSAGES:
                    raise InputError(f"has more than {MAX_MESSAGES} messages of cameras", file=file)
                put(found, store.deserialize_cdr(message.data, schema.name))  # type: ignore[union-attr]
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=file) from None
    except InputError as error:
        raise InputError(error.reason, file=file, hint=error.hint) from None
    except (McapError, ValueError, KeyError, EOFError, AssertionError, IndexError) as error:
        raise InputError(f"is no MCAP record of ROS 2 messages, or cut off: {error}", file=file) from None
    except Exception as error:  # damaged chunks raise struct.error and others
        raise InputError(f"is damaged: {type(error).__name__}: {error}", file=file) from None
    return found


def _image(found: CameraRecord, m: Any) -> None:
    h, w, stamp, frame = m.height, m.width, _seconds(m.header.stamp), m.header.frame_id
    if m.encoding in _COLORS:
        channels, order = _COLORS[m.encoding]
        rows = _rows(m, w * channels)
        found.rgb[frame] = stamp, np.ascontiguousarray(rows.reshape(h, w, channels)[..., list(order)])
    elif m.encoding in _DEPTHS:
        found.depth[frame] = stamp, depth_pixels(m)


def depth_pixels(m: Any) -> NDArray[np.float32]:
    """Return the depths (h, w) [m] of a sensor_msgs/Image message from a bag; 0 where the depth is missing.

    Raises:
        InputError: the encoding has no depth, or the data do not match the size.
    """
    if m.encoding not in _DEPTHS:
        raise InputError(f"encoding {m.encoding!r} is not a depth image's", hint=" or ".join(_DEPTHS))
    dtype = np.dtype(_DEPTHS[m.encoding]).newbyteorder(">" if m.is_bigendian else "<")
    return meters(_rows(m, m.width * dtype.itemsize).view(dtype).astype(_DEPTHS[m.encoding]))


def _rows(m: Any, used: int) -> NDArray[np.uint8]:
    data = np.frombuffer(bytes(m.data), np.uint8)
    if m.step < used or data.size != m.step * m.height:
        raise InputError(f"a picture of {m.width} x {m.height} {m.encoding} has {data.size} bytes")
    return np.ascontiguousarray(data.reshape(m.height, m.step)[:, :used])


def _info(found: CameraRecord, m: Any) -> None:
    K = np.asarray(m.k, float).reshape(3, 3)
    d = np.asarray(m.d, float)
    if m.distortion_model not in ("", "plumb_bob") and np.any(d):
        raise InputError(
            f"distortion model {m.distortion_model!r} is not known", hint="record rectified pictures"
        )
    distortion = tuple(float(v) for v in d[:5]) if np.any(d) else ()
    found.infos[m.header.frame_id] = Pinhole(
        int(m.width),
        int(m.height),
        float(K[0, 0]),
        float(K[1, 1]),
        float(K[0, 2]),
        float(K[1, 2]),
        distortion,
    )


def _cloud(found: CameraRecord, m: Any) -> None:
    found.clouds[m.header.frame_id] = _seconds(m.header.stamp), cloud_points(m)


def cloud_points(m: Any) -> F64:
    """Return the points (n, 3) [m] of a sensor_msgs/PointCloud2 message from a bag; NaN for missing points.

    Raises:
        InputError: x, y or z is missing, or the data do not match the size.
    """
    fields = {f.name: f for f in m.fields}
    count = m.width * m.height
    data = np.frombuffer(bytes(m.data), np.uint8)
    if not all(axis in fields for axis in "xyz"):
        raise InputError(f"a cloud has no x, y, z; its fields: {', '.join(fields) or 'none'}")
    if data.size < count * m.point_step:
        raise InputError(f"a cloud of {count} points of {m.point_step} bytes has {data.size} bytes")
    rows = data[: count * m.point_step].reshape(count, m.point_step)
    columns = []
    for axis in "xyz":
        f = fields[axis]
        kind = np.dtype(_KINDS[f.datatype]).newbyteorder(">" if m.is_bigendian else "<")
        if f.offset + kind.itemsize > m.point_step:
            raise InputError(f"a cloud's field {axis} is beyond its points")
        columns.append(np.ascontiguousarray(rows[:, f.offset : f.offset + kind.itemsize]).view(kind)[:, 0])
    return np.column_stack(columns).astype(float)


def _tf(found: CameraRecord, m: Any) -> None:
    for t in m.transforms:
        p, q = t.transform.translation, t.transform.rotation
        T = SE3.from_quat_xyzw([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
        found.transforms[t.child_frame_id] = t.header.frame_id, T


def _seconds(stamp: Any) -> float:
    return stamp.sec + stamp.nanosec * 1e-9


_READERS = {
    "sensor_msgs/msg/Image": _image,
    "sensor_msgs/msg/CameraInfo": _info,
    "sensor_msgs/msg/PointCloud2": _cloud,
    "tf2_msgs/msg/TFMessage": _tf,
}
