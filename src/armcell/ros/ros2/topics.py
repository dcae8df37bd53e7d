"""Topics between the bus and the domain, one direction each."""

from __future__ import annotations

from typing import Any

from armcell.core import ArmcellError
from armcell.ros.bus import Attachment
from armcell.ros.ros2 import names
from armcell.ros.ros2.context import Context
from armcell.ros.ros2.dds import OFFERED_INCOMPATIBLE, REQUESTED_INCOMPATIBLE, Reader, Sample
from armcell.ros.ros2.names import DdsName
from armcell.ros.ros2.qos import LARGE, TF_STATIC, Profile, offered, requested

ON_DEMAND = (
    "sensor_msgs/CameraInfo",
    "tf2_msgs/TFMessage",
    *LARGE,
)  # publishers look whether anybody listens
OTHER = "this definition of the message"  # ours, where everything else would fit


def type_hash_data(context: Context, type_name: str) -> str:
    """The user data in which REP 2016's hash travels."""
    found = context.codec.type_hash(type_name)
    return f"typehash={found};" if found else ""


class Outgoing:
    """A topic of the bus, published in the domain."""

    def __init__(
        self, context: Context, owner: object, topic: str, type_name: str, latched: bool,
        profile: Profile | None = None,
    ):  # fmt: skip
        self._context, self.topic, self.type, self.latched = context, topic, type_name, latched
        self.profile = profile or offered(topic, type_name, latched)
        self.sent = 0
        context.codec.prepare(type_name)
        user_data = type_hash_data(context, type_name)
        self._owner = owner
        self._writer = context.writer(names.topic(topic, type_name), self.profile, user_data)
        self._attachment: Attachment | None = None
        self.follow()

    def follow(self) -> None:
        """Listen on the bus, or do not: what costs much is made only for those who listen."""
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
        """From the publisher's thread: a full writer refuses and does not wait."""
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

    def look(self) -> None:
        """Say who cannot listen, and why."""
        others = self._context.graph.endpoints(self._writer.name.topic, writes=False)
        _check_types(self._context, self.topic, self._writer.name, [e.type for e in others])
        same = [e for e in others if e.type == self._writer.name.type]
        if self._writer.newly_incompatible(OFFERED_INCOMPATIBLE) and same:
            missing = {lack for e in same for lack in self.profile.lacks(e.profile)} or {OTHER}
            self._context.complain(
                f"offered {self.topic}",
                f"{self.topic}: a ROS 2 subscriber asks for {' and '.join(sorted(missing))}, which is not "
                f"offered ({self.profile}): it gets nothing",
            )


class Incoming:
    """A topic of the domain, published on the bus."""

    def __init__(
        self, context: Context, owner: object, topic: str, type_name: str, profile: Profile | None = None
    ):
        self._context, self._owner, self.topic, self.type = context, owner, topic, type_name
        self._fixed = profile
        self._name = names.topic(topic, type_name)
        self.received = 0
        context.codec.prepare(type_name)
        self.profile = self._wanted()
        self._publisher = context.bus.advertise(topic, type_name, self.profile.latched, owner)
        self._reader = self._read()

    def _wanted(self) -> Profile:
        """What all publishers outside give, or what was asked for."""
        if self._fixed is not None:
            return self._fixed
        others = self._context.graph.endpoints(self._name.topic, writes=True)
        depth = TF_STATIC.depth if self.topic in ("/tf", "/tf_static") else Profile().depth
        return requested((e.profile for e in others if e.type == self._name.type), depth)

    def _read(self) -> Reader:
        return self._context.reader(
            self._name, self.profile, self._take, type_hash_data(self._context, self.type)
        )

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

    def look(self) -> None:
        """Follow what the publishers offer; say whom we cannot hear, and why."""
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
            missing = {lack for e in same for lack in e.profile.lacks(self.profile)} or {OTHER}
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
