"""Shim of tf2_ros: buffer, listeners and broadcasters for /tf on the bus.

The buffer stores the newest transform of each frame, not the history: a lookup in the past returns the newest
transform.
"""

from __future__ import annotations

import threading
import time
from typing import Any

from armcell.core import SE3
from armcell.moveit.message_classes import classes
from armcell.moveit.ros_time import Time
from armcell.moveit.session import current_session
from armcell.ros.convert import pose_from_message, transform_message

TransformStamped = classes()["geometry_msgs/TransformStamped"]
TF = "tf2_msgs/TFMessage"
TOPICS = ("/tf", "/tf_static")
MAX_DEPTH = 200


class TransformException(Exception):
    """Base class of the exceptions that tf2_ros raises."""


class LookupException(TransformException):
    """Exception that tf2_ros raises if a frame has never been published on /tf or /tf_static."""


class ConnectivityException(TransformException):
    """Exception that tf2_ros raises if no chain of transforms connects two frames."""


class ExtrapolationException(TransformException):
    """Exception that tf2_ros raises if no transform is known at the requested time."""


class InvalidArgumentException(TransformException):
    """Exception that tf2_ros raises if an argument of a call, such as a transform, is invalid."""


class TimeoutException(TransformException):
    """Exception that tf2_ros raises if no transform between two frames arrives within the timeout."""


def _seconds(timeout: Any) -> float:
    return timeout.to_sec() if hasattr(timeout, "to_sec") else float(timeout)


class Buffer:
    """Buffer that keeps the newest transform of each child frame, like tf2_ros.Buffer."""

    def __init__(self, cache_time: Any = None, debug: bool = True):
        self._session = current_session()
        self._lock = threading.Condition()
        self._frames: dict[str, tuple[str, SE3, Any]] = {}

    def set_transform(self, transform: Any, authority: str = "") -> None:
        child, parent = transform.child_frame_id.lstrip("/"), transform.header.frame_id.lstrip("/")
        with self._lock:
            self._frames[child] = (parent, pose_from_message(transform.transform), transform.header.stamp)
            self._lock.notify_all()

    set_transform_static = set_transform

    def take(self, message: Any) -> None:
        for transform in message.transforms:
            self.set_transform(transform)

    def lookup_transform(
        self, target_frame: str, source_frame: str, time: Any = None, timeout: Any = 0.0
    ) -> Any:
        """Return T_target_source as a TransformStamped, like tf2_ros.Buffer. The call waits up to `timeout`
        [s] for the transform.

        Raises:
            TransformException: a frame does not exist, or the frames are not connected.
        """
        T, stamp = self._wait(target_frame, source_frame, _seconds(timeout))
        schema = self._session.bus.schema
        header = schema.new("std_msgs/Header", stamp=stamp, frame_id=target_frame)
        return self._session.messages.local(transform_message(schema, header, source_frame, T))

    def can_transform(
        self, target_frame: str, source_frame: str, time: Any = None, timeout: Any = 0.0, **more: Any
    ) -> bool:
        try:
            self._wait(target_frame, source_frame, _seconds(timeout))
        except TransformException:
            return False
        return True

    def transform(
        self, object_stamped: Any, target_frame: str, timeout: Any = 0.0, new_type: Any = None
    ) -> Any:
        """Transform a stamped pose, point or vector to another frame, like tf2_ros.Buffer.transform.

        Raises:
            TransformException: a frame is unknown, the frames are not connected, or the type is not
                supported.
        """
        from armcell.moveit.shims import tf2_geometry_msgs as convert

        found = self.lookup_transform(target_frame, object_stamped.header.frame_id, Time(), timeout)
        kind = object_stamped._type.split("/")[1]
        make = {
            "PoseStamped": convert.do_transform_pose,
            "PointStamped": convert.do_transform_point,
            "Vector3Stamped": convert.do_transform_vector3,
        }
        if kind not in make:
            raise InvalidArgumentException(f"a {kind} is not transformed; known: {', '.join(make)}")
        return make[kind](object_stamped, found)

    def _wait(self, target: str, source: str, seconds: float) -> tuple[SE3, Any]:
        give_up = time.monotonic() + max(seconds, 0.0)
        while True:
            try:
                with self._lock:
                    return self._lookup(target.lstrip("/"), source.lstrip("/"))
            except TransformException:
                left = give_up - time.monotonic()
                if left <= 0 or self._session.shutting_down.is_set():
                    raise
                with self._lock:
                    self._lock.wait(min(left, 0.05))

    def _lookup(self, target: str, source: str) -> tuple[SE3, Any]:
        roots, Ts, stamps = [], [], []
        for frame in (target, source):
            known = {f for child, (parent, _, _) in self._frames.items() for f in (child, parent)}
            if frame not in known:
                raise LookupException(f'"{frame}" passed to lookupTransform argument does not exist.')
            T, at, stamp = SE3.identity(), frame, Time()
            for _ in range(MAX_DEPTH):
                if at not in self._frames:
                    break
                parent, step, stamp = self._frames[at]
                T, at = step @ T, parent
            roots.append(at)
            Ts.append(T)
            stamps.append(stamp)
        if roots[0] != roots[1]:
            raise ConnectivityException(f"Could not find a connection between '{target}' and '{source}'")
        newest = max(stamps, key=lambda s: s.to_nsec())
        return Ts[0].inverse() @ Ts[1], newest


class TransformListener:
    """Listener that fills a buffer with the transforms from /tf and /tf_static, like
    tf2_ros.TransformListener.
    """

    def __init__(self, buffer: Buffer, queue_size: Any = None, **more: Any):
        session = current_session()
        self.buffer = buffer
        self._subscriptions = [
            session.close_on_shutdown(session.bus.subscribe(topic, TF, buffer.take, 100)) for topic in TOPICS
        ]

    def unregister(self) -> None:
        for subscription in self._subscriptions:
            subscription.close()


class TransformBroadcaster:
    """Broadcaster that publishes transforms on /tf, like tf2_ros.TransformBroadcaster."""

    TOPIC, LATCH = "/tf", False

    def __init__(self) -> None:
        self._session = current_session()
        self._publisher = self._session.bus.advertise(self.TOPIC, TF, self.LATCH)

    def sendTransform(self, transform: Any) -> None:
        self._publish(list(transform) if isinstance(transform, list | tuple) else [transform])

    def _publish(self, transforms: list[Any]) -> None:
        self._publisher.publish(self._session.messages.local(self._session.new(TF, transforms)))


class StaticTransformBroadcaster(TransformBroadcaster):
    """Broadcaster that publishes static transforms on /tf_static, like tf2_ros.StaticTransformBroadcaster.

    Each message contains all transforms sent so far, so that late subscribers receive all of them.
    """

    TOPIC, LATCH = "/tf_static", True

    def __init__(self) -> None:
        super().__init__()
        self._sent: dict[str, Any] = {}  # by child frame

    def _publish(self, transforms: list[Any]) -> None:
        for transform in transforms:
            self._sent[transform.child_frame_id] = self._session.messages.local(transform)
        super()._publish(list(self._sent.values()))


__all__ = [
    "Buffer",
    "ConnectivityException",
    "ExtrapolationException",
    "InvalidArgumentException",
    "LookupException",
    "StaticTransformBroadcaster",
    "TimeoutException",
    "TransformBroadcaster",
    "TransformException",
    "TransformListener",
    "TransformStamped",
]
