"""Octomap on the bus: point clouds and depth images of 3D sensors update the octomap of the planning scene.

The octomap is updated like by move_group's occupancy map monitor.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from armcell.core import SE3, InputError, JointState, Pinhole
from armcell.perception import Sensor3d, SensorMap, Sensors3d, cloud_points, depth_pixels, organized_cloud
from armcell.ros.bus import Bus, Publisher
from armcell.ros.convert import cloud_message, joint_state_from_message, pose_from_message
from armcell.ros.faults import FaultCounter
from armcell.ros.nodes.cell_motions import CellMotions
from armcell.ros.nodes.scene_node import SceneNode
from armcell.scene import PlanningScene

log = logging.getLogger(__name__)
BEFORE_FIRST = 0.1  # [s] a cloud may be older than the oldest joint state, and uses it
HISTORY = 256  # stored joint states: several seconds, to know the robot's state in a delayed cloud
CHANGED = 0.5  # [s] minimum time between scene messages that contain the octomap
DEPTH = 64  # maximum number of frames between a sensor and a frame of the scene
CLOUD, IMAGE = "sensor_msgs/PointCloud2", "sensor_msgs/Image"


class OctomapNode:
    """ROS node that updates the octomap in the planning scene with the measurements of 3D sensors on the bus.

    A message is interpreted in the frame of its header: a frame of the scene, or a frame that /tf or
    /tf_static connects with one. The robot's joint positions are those at the time stamp of the message.
    """

    def __init__(self, cell: CellMotions, bus: Bus, scene_node: SceneNode, sensors: Sensors3d):
        self._cell, self._bus, self._scene_node = cell, bus, scene_node
        self._map = SensorMap(sensors.resolution)
        self._lock, self._complaints = threading.Lock(), FaultCounter()
        self._frames: dict[str, tuple[str, SE3]] = {}
        self._states: deque[tuple[float, JointState]] = deque(maxlen=HISTORY)
        self._next: dict[str, float] = {}  # time of the next update [s, wall clock], by topic
        self._infos: dict[str, Any] = {}
        self._told = 0.0
        if sensors.frame and sensors.frame not in cell.model.links and sensors.frame != "world":
            log.warning("octomap_frame %s is not a frame of the robot: mapped in world", sensors.frame)
        self._filtered: dict[str, Publisher] = {}
        self._members: list[Any] = [
            bus.subscribe("/tf", "tf2_msgs/TFMessage", self._on_tf, 100),
            bus.subscribe("/tf_static", "tf2_msgs/TFMessage", self._on_tf, 100),
            bus.subscribe("/joint_states", "sensor_msgs/JointState", self._on_joints, 10),
        ]
        for sensor in sensors.sensors:
            self._listen(sensor)
        scene_node.on_clear_octomap(self.clear)

    def _listen(self, sensor: Sensor3d) -> None:
        topic, bus = sensor.topic, self._bus
        if sensor.image_topic:
            info, kind = sensor.info_topic, "sensor_msgs/CameraInfo"
            self._members.append(bus.subscribe(info, kind, lambda m: self._infos.update({info: m}), 1))
        kind = IMAGE if sensor.image_topic else CLOUD
        self._members.append(bus.subscribe(topic, kind, self._taker(sensor), 1))
        if name := sensor.filtered_cloud_topic:
            self._filtered[topic] = bus.advertise(name, CLOUD)
            self._members.append(self._filtered[topic])

    def close(self) -> None:
        for member in self._members:
            member.close()

    def clear(self) -> None:
        """Remove all measurements of 3D sensors from the octomap that the ROS node adds to the planning
        scene.
        """
        with self._lock:
            self._map.clear()

    # --- subscriptions ---
    def _on_tf(self, message: Any) -> None:
        for t in message.transforms:
            try:
                T = pose_from_message(t.transform)
            except InputError:
                continue
            self._frames[t.child_frame_id.lstrip("/")] = t.header.frame_id.lstrip("/"), T

    def _on_joints(self, message: Any) -> None:
        try:
            state = joint_state_from_message(message, self._cell.model)
        except InputError:
            return
        if state is not None:
            self._states.append((message.header.stamp.to_sec(), state))

    def _taker(self, sensor: Sensor3d) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            now = time.monotonic()
            if now < self._next.get(sensor.topic, 0.0):
                return
            if sensor.max_update_rate > 0:
                self._next[sensor.topic] = now + 1.0 / sensor.max_update_rate
            try:
                self._use(sensor, message)
            except InputError as error:
                if self._complaints.count(f"{sensor.topic}: {error}"):
                    log.warning("%s is not used: %s", sensor.topic, error)

        return take

    def _use(self, sensor: Sensor3d, message: Any) -> None:
        points = self._points(sensor, message)
        if points is None:
            return
        scene = self._scene_at(message.header.stamp.to_sec())
        T = self._pose(scene, message.header.frame_id.lstrip("/"))
        with self._lock:
            _, left = self._map.update(points, T, scene, sensor)
            self._cell.edit_scene(self._map.applied_to)
        now = time.monotonic()
        if now - self._told >= CHANGED:
            self._told = now
            self._scene_node.schedule_publication()
        publisher = self._filtered.get(sensor.topic)
        if publisher is not None and publisher.subscribers:
            publisher.publish(cloud_message(self._bus.schema, message.header, left[None].astype(np.float32)))

    def _points(self, sensor: Sensor3d, message: Any) -> np.ndarray | None:
        """Return the points (n, 3) [m] in a 3D sensor's ROS message (a point cloud or depth image) for the
        octomap of the planning scene, in the frame of the message.

        Raises:
            InputError: the camera info for a depth image has not arrived yet.
        """
        if not sensor.image_topic:
            return cloud_points(message)
        info = self._infos.get(sensor.info_topic)
        if info is None:
            raise InputError(f"no camera info on {sensor.info_topic} yet")
        K = np.asarray(getattr(info, "K", getattr(info, "k", None)), float).reshape(3, 3)
        size = int(info.width), int(info.height)
        pinhole = Pinhole(*size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
        depth = depth_pixels(message)
        near, far = sensor.near_clipping_plane_distance, sensor.far_clipping_plane_distance
        depth = np.where((depth >= near) & (depth <= far), depth, np.float32(0.0))
        v, u = sensor.skip_vertical_pixels, sensor.skip_horizontal_pixels
        return organized_cloud(depth, pinhole)[v : depth.shape[0] - v, u : depth.shape[1] - u].reshape(-1, 3)

    # --- robot state and pose of the sensor ---
    def _scene_at(self, stamp: float) -> PlanningScene:
        """Return the planning scene with the joint positions at the time `stamp` [s] of a 3D sensor's ROS
        message.

        A stamp of zero selects the newest joint positions.

        Raises:
            InputError: the stamp is older than all stored joint states.
        """
        scene, states = self._cell.scene(), list(self._states)
        if not states or stamp <= 0 or stamp >= states[-1][0]:
            return scene
        if stamp < states[0][0] - BEFORE_FIRST:
            text = f"its stamp is {states[-1][0] - stamp:.1f} s old; the robot's state is known for "
            text += f"{states[-1][0] - states[0][0]:.1f} s"
            raise InputError(text, hint="reduce the delay, or synchronize the clocks")
        _, state = min(states, key=lambda known: abs(known[0] - stamp))
        return scene.with_positions(scene.state.updated(state).positions)

    def _pose(self, scene: PlanningScene, frame: str) -> SE3:
        """Return the pose T_world_frame of the frame of a 3D sensor's ROS message, from the planning scene
        and the transforms on /tf.

        Raises:
            InputError: no transforms connect the frame with a frame of the scene.
        """
        T, at = SE3.identity(), frame
        for _ in range(DEPTH):
            if at in scene.frame_names or at == "world":
                return (SE3.identity() if at == "world" else scene.frame_pose(at)) @ T
            if at not in self._frames:
                break
            at, step = self._frames[at]
            T = step @ T
        raise InputError(
            f"frame {frame!r} is not connected with the robot",
            hint=f"publish a transform from a frame of the robot to {frame!r} on /tf_static",
        )
