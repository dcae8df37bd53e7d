"""Bridged topics between the bus and the ROS 2 domain: one class for each direction."""

from __future__ import annotations

from typing import Any

from armcell.core import ArmcellError
from armcell.ros.bus import Attachment
from armcell.ros.ros2 import names
from armcell.ros.ros2.context import Context
from armcell.ros.ros2.dds import OFFERED_INCOMPATIBLE, REQUESTED_INCOMPATIBLE, Reader, Sample
from armcell.ros.ros2.names import DdsName
from armcell.ros.ros2.qos import LARGE, TF_STATIC, QosProfile, publisher_profile, subscriber_profile

ON_DEMAND = (
    "sensor_msgs/CameraInfo",
    "tf2_msgs/TFMessage",
    *LARGE,
)  # the bus's publishers produce these only while a subscriber exists
OTHER = "this definition of the message"  # the only remaining cause if all QoS policies are compatible


class OutgoingTopic:
    """Topic of the bus that the bridge publishes in the ROS 2 domain."""

    def __init__(
        self, context: Context, owner: object, topic: str, type_name: str, latched: bool,
        profile: QosProfile | None = None,
    ):  # fmt: skip
        self._context, self.topic, self.type, self.latched = context, topic, type_name, latched
        self.profile = profile or publisher_profile(topic, type_name, latched)
        self.sent = 0
        context.codec.prepare(type_name)
        self._owner = owner
        self._writer = context.writer(names.topic(topic, type_name), self.profile)
        self._attachment: Attachment | None = None
        self.update_subscription()

    def update_subscription(self) -> None:
        """Subscribe to the outgoing topic on the bus, but only while ROS 2 nodes need its messages.

        Messages that are expensive to produce (images, point clouds, TF) are needed only while the domain has
        a reader for them.
        """
        wanted = self.type not in ON_DEMAND or self.profile.latched or bool(self._writer.readers())
        if wanted and self._attachment is None:
            self._attachment = self._context.bus.attach(self.topic, self.type, self._put, self._owner)
        elif not wanted and self._attachment is not None:
            self._attachment.close()
            self._attachment = None

    def close(self) -> None:
        if self._attachment is not None:
            self._attachment.close()
        self._context.drop(self._writer)

    def _put(self, message: Any) -> None:
        """Send a message of a bridged topic from the bus to the ROS 2 domain without blocking. If the
        writer's queue is full, the message is dropped.

        The method runs in the publisher's thread.
        """
        context = self._context
        if context.closed or not (self.profile.latched or self._writer.readers()):
            return
        try:
            written = self._writer.write(context.codec.encode(message))
        except ArmcellError as error:
            if not context.closed:
                context.complain(f"encode {self.topic}", f"{self.topic}: {error}")
            return
        if written:
            self.sent += 1
        else:
            context.has_dropped()

    def check_qos(self) -> None:
        """Report the ROS 2 subscribers that cannot receive a bridged topic of the bus, each with
        the reason.
        """
        others = self._context.graph.endpoints(self._writer.name.topic, writes=False)
        _check_types(self._context, self.topic, self._writer.name, [e.type for e in others])
        same = [e for e in others if e.type == self._writer.name.type]
        if self._writer.newly_incompatible(OFFERED_INCOMPATIBLE) and same:
            missing = {lack for e in same for lack in self.profile.missing_policies(e.profile)} or {OTHER}
            self._context.complain(
                f"offered {self.topic}",
                f"{self.topic}: a ROS 2 subscriber asks for {' and '.join(sorted(missing))}, which is not "
                f"offered ({self.profile}): it gets nothing",
            )


class IncomingTopic:
    """Topic of the ROS 2 domain that the bridge publishes on the bus."""

    def __init__(
        self, context: Context, owner: object, topic: str, type_name: str, profile: QosProfile | None = None
    ):
        self._context, self._owner, self.topic, self.type = context, owner, topic, type_name
        self._fixed = profile
        self._name = names.topic(topic, type_name)
        self.received = 0
        context.codec.prepare(type_name)
        self.profile = self._wanted()
        self._publisher = context.bus.advertise(topic, type_name, self.profile.latched, owner)
        self._reader = self._read()

    def _wanted(self) -> QosProfile:
        """Choose the QoS profile of a bridged topic that comes in from the ROS 2 domain.

        The result is the configured profile, or else the profile that all known publishers offer.
        """
        if self._fixed is not None:
            return self._fixed
        others = self._context.graph.endpoints(self._name.topic, writes=True)
        depth = TF_STATIC.depth if self.topic in ("/tf", "/tf_static") else QosProfile().depth
        return subscriber_profile((e.profile for e in others if e.type == self._name.type), depth)

    def _read(self) -> Reader:
        return self._context.reader(self._name, self.profile, self._take)

    def close(self) -> None:
        self._context.drop(self._reader)
        self._publisher.close()

    def _take(self, sample: Sample) -> None:
        context = self._context
        try:
            message = context.codec.decode(self.type, sample.data)
            self._publisher.publish(message)
            self.received += 1
        except ArmcellError as error:
            if not self._publisher.closed:
                context.complain(f"decode {self.topic}", f"{self.topic}: {error}")

    def check_qos(self) -> None:
        """Adapt a bridged topic, which comes in from the ROS 2 domain, to the QoS of its ROS 2 publishers,
        and report incompatible publishers.
        """
        context = self._context
        others = context.graph.endpoints(self._name.topic, writes=True)
        _check_types(context, self.topic, self._name, [e.type for e in others])
        if (wanted := self._wanted()) != self.profile:
            self.profile = wanted
            context.drop(self._reader)
            if wanted.latched != self._publisher.latch:
                self._publisher.close()
                self._publisher = context.bus.advertise(self.topic, self.type, wanted.latched, self._owner)
            self._reader = self._read()
            return
        same = [e for e in others if e.type == self._name.type]
        if self._reader.newly_incompatible(REQUESTED_INCOMPATIBLE) and same:
            missing = {lack for e in same for lack in e.profile.missing_policies(self.profile)} or {OTHER}
            context.complain(
                f"requested {self.topic}",
                f"{self.topic}: a ROS 2 publisher does not offer {' and '.join(sorted(missing))}: "
                "nothing is heard of it",
            )


def _check_types(context: Context, topic: str, name: DdsName, others: list[str]) -> None:
    for other in sorted(set(others) - {name.type}):
        context.complain(
            f"type {topic} {other}",
            f"{topic}: a ROS 2 node has it as {names.ros_type(other) or other}, ours is "
            f"{names.ros_type(name.type)}: they do not meet",
        )
