"""Camera topics on the bus: color and depth images, camera info and point clouds."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from armcell.cell import LiveCamera
from armcell.core import SE3, CameraImage
from armcell.perception import organized_cloud
from armcell.records.mcap_writer import ros_name
from armcell.ros.bus import Bus, Publisher
from armcell.ros.convert import camera_info_message, cloud_message, image_message, transform_message
from armcell.scene import WORLD

LINK, OPTICAL = "{}_link", "{}_optical_frame"
# From ROS's camera frame (x forward, z up) to its optical frame (z forward, y down), see REP 103
T_LINK_OPTICAL = SE3.from_quat_xyzw([0, 0, 0], [-0.5, 0.5, -0.5, 0.5])


class CameraPublisher:
    """Publisher that sends the images of a live cell's cameras to ROS topics.

    Call it in the thread that steps the driver. Topics of a camera NAME, as in image_pipeline:

    - /NAME/color/image_raw (rgb8) and /NAME/color/camera_info
    - /NAME/depth/image_rect_raw (32FC1, meters, NaN for pixels without a measurement) and
      /NAME/depth/camera_info
    - /NAME/depth/points (organized PointCloud2 with x, y, z and rgb)
    - /tf: NAME_link and NAME_optical_frame, relative to the link that carries the camera, or to the world

    Only images with subscribers are rendered. If the cell runs in real time, another process renders the
    images and a separate thread publishes them, each with the time stamp of the state that it shows. The
    camera's rate and the rendering speed limit the frame rate. Late images are dropped, and each subscriber's
    queue drops its oldest message, so a camera never delays the cell.
    """

    def __init__(self, bus: Bus, cameras: dict[str, LiveCamera]):
        self._bus = bus
        self._cameras = [_Topics(bus, camera) for camera in cameras.values()]

    def publish(self, tf: Publisher | None = None) -> None:
        """Publish the camera images that are due. If a publisher of /tf is given, also publish the camera
        frames on /tf.

        Args:
            tf: publisher of /tf; None publishes no frames.
        """
        for topics in self._cameras:
            topics.publish(tf)

    def frames(self) -> dict[str, int]:
        """Return how many images of each camera have been published on ROS topics so far, by camera name."""
        return {topics.name: topics.delivered for topics in self._cameras}

    def close(self) -> None:
        """Remove the publishers of the camera topics from the bus."""
        for topics in self._cameras:
            topics.close()


class _Topics:
    def __init__(self, bus: Bus, camera: LiveCamera):
        self._bus, self._camera = bus, camera
        self._next = 0.0
        self._closed, self._giving = False, threading.Lock()
        self.name, self.delivered = camera.name, 0
        name = ros_name(camera.name)
        self._link, self._optical = LINK.format(name), OPTICAL.format(name)
        self._color = bus.advertise(f"/{name}/color/image_raw", "sensor_msgs/Image")
        self._infos = [bus.advertise(f"/{name}/color/camera_info", "sensor_msgs/CameraInfo")]
        self._depth = self._points = None
        if camera.camera.has_depth:
            self._depth = bus.advertise(f"/{name}/depth/image_rect_raw", "sensor_msgs/Image")
            self._infos.append(bus.advertise(f"/{name}/depth/camera_info", "sensor_msgs/CameraInfo"))
            self._points = bus.advertise(f"/{name}/depth/points", "sensor_msgs/PointCloud2")
        self._members = [p for p in (self._color, self._depth, self._points, *self._infos) if p is not None]

    def publish(self, tf: Publisher | None) -> None:
        now, period = self._bus.clock.now(), 1.0 / self._camera.camera.rate
        if now < self._next - 1e-9:
            return
        self._next = max(self._next, now - period / 2) + period  # avoids a burst of images after a pause
        wanted = [p for p in self._members if p.subscribers]
        if not wanted and (tf is None or not tf.subscribers):
            return
        schema = self._bus.schema
        if tf is not None and tf.subscribers:
            tf.publish(schema.new("tf2_msgs/TFMessage", self._frames()))
        if not wanted:
            return
        points = self._points is not None and self._points.subscribers
        depth = points or (self._depth is not None and self._depth.subscribers)
        self._camera.ask(self, self._give, rgb=bool(self._color.subscribers or points), depth=bool(depth))

    def _give(self, image: CameraImage) -> None:
        """Publish a rendered camera image on its ROS topics.
        The thread that delivers the image calls this method.
        """
        with self._giving:
            if not self._closed:
                self._publish(image)

    def _publish(self, image: CameraImage) -> None:
        schema, header = self._bus.schema, self._bus.header(self._optical)
        header.stamp = schema.message("builtin_interfaces/Time").from_sec(image.time)
        for publisher in self._infos:
            if publisher.subscribers:
                publisher.publish(camera_info_message(schema, header, image.pinhole))
        if self._color.subscribers and image.rgb is not None:
            self._color.publish(image_message(schema, header, image.rgb))
        if image.depth is not None:
            self._publish_depth(image.depth, image, header)
        if image.rgb is not None or image.depth is not None:
            self.delivered += 1

    def _publish_depth(self, depth: np.ndarray, image: CameraImage, header: Any) -> None:
        schema = self._bus.schema
        if self._depth is not None and self._depth.subscribers:
            self._depth.publish(image_message(schema, header, _with_nan(depth)))
        if self._points is not None and self._points.subscribers and image.rgb is not None:
            points = organized_cloud(depth, image.pinhole).astype(np.float32)
            self._points.publish(cloud_message(schema, header, points, image.rgb))

    def _frames(self) -> list[Any]:
        """Return the transforms that a camera publishes on /tf:
        from the parent link to the camera's link and to its optical frame.
        """
        camera, bus = self._camera.camera, self._bus
        parent = WORLD if camera.link is None else camera.link
        T = camera.T_world_camera if camera.T_link_camera is None else camera.T_link_camera
        return [
            transform_message(bus.schema, bus.header(parent), self._link, T @ T_LINK_OPTICAL.inverse()),
            transform_message(bus.schema, bus.header(self._link), self._optical, T_LINK_OPTICAL),
        ]

    def close(self) -> None:
        with self._giving:
            self._closed = True
        for member in self._members:
            member.close()


def _with_nan(depth: np.ndarray) -> np.ndarray:
    """Return the depth image that a camera publishes on a ROS topic, with NaN in pixels that have no
    measurement, as REP 118 requires.
    """
    return np.where(depth > 0, depth, np.float32(np.nan)).astype(np.float32)
