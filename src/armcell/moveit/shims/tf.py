"""Shim of tf: the older listener and broadcaster, based on the tf2_ros shim."""

from __future__ import annotations

from typing import Any

from armcell.moveit.ros_time import Time
from armcell.moveit.session import current_session
from armcell.moveit.shims import tf2_ros, transformations
from armcell.moveit.shims.tf2_ros import (
    ConnectivityException,
    ExtrapolationException,
    LookupException,
    TransformException,
)

Exception = TransformException


class TransformListener:
    """Transform listener like that of tf in ROS 1.
    It returns transforms as a position (x, y, z) and a quaternion (x, y, z, w).
    """

    def __init__(self, *args: Any, **kwargs: Any):
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

    def lookupTransform(
        self, target_frame: str, source_frame: str, time: Any
    ) -> tuple[list[float], list[float]]:
        found = self._buffer.lookup_transform(target_frame, source_frame, time, 1.0).transform
        t, r = found.translation, found.rotation
        return [t.x, t.y, t.z], [r.x, r.y, r.z, r.w]

    def waitForTransform(
        self,
        target_frame: str,
        source_frame: str,
        time: Any,
        timeout: Any,
        polling_sleep_duration: Any = None,
    ) -> None:
        self._buffer.lookup_transform(target_frame, source_frame, time, timeout)

    def canTransform(self, target_frame: str, source_frame: str, time: Any) -> bool:
        return self._buffer.can_transform(target_frame, source_frame, time)

    def frameExists(self, frame_id: str) -> bool:
        return self._buffer.can_transform(frame_id, frame_id)

    def getLatestCommonTime(self, source_frame: str, target_frame: str) -> Any:
        return self._buffer.lookup_transform(target_frame, source_frame).header.stamp

    def transformPose(self, target_frame: str, ps: Any) -> Any:
        return self._buffer.transform(ps, target_frame, 1.0)

    def transformPoint(self, target_frame: str, ps: Any) -> Any:
        return self._buffer.transform(ps, target_frame, 1.0)

    def transformVector3(self, target_frame: str, v3s: Any) -> Any:
        return self._buffer.transform(v3s, target_frame, 1.0)

    def fromTranslationRotation(self, translation: Any, rotation: Any) -> Any:
        return transformations.concatenate_matrices(
            transformations.translation_matrix(translation), transformations.quaternion_matrix(rotation)
        )


class TransformBroadcaster:
    """Transform broadcaster like that of tf in ROS 1. Each call publishes one transform."""

    def __init__(self, queue_size: int = 100):
        self._broadcaster = tf2_ros.TransformBroadcaster()

    def sendTransform(self, translation: Any, rotation: Any, time: Any, child: str, parent: str) -> None:
        new = current_session().new
        header = new("std_msgs/Header", stamp=Time(time.sec, time.nanosec), frame_id=parent)
        transform = new(
            "geometry_msgs/Transform",
            new("geometry_msgs/Vector3", *map(float, translation)),
            new("geometry_msgs/Quaternion", *map(float, rotation)),
        )
        self._broadcaster.sendTransform(new("geometry_msgs/TransformStamped", header, child, transform))

    def sendTransformMessage(self, transform: Any) -> None:
        self._broadcaster.sendTransform(transform)


__all__ = [
    "ConnectivityException",
    "Exception",
    "ExtrapolationException",
    "LookupException",
    "TransformBroadcaster",
    "TransformException",
    "TransformListener",
    "transformations",
]
