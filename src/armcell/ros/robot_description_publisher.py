"""Latched topics with the robot's URDF and SRDF, for Unity and ROS 2 programs.

ROS 1 programs read both texts from the parameter server instead.
"""

from __future__ import annotations

from armcell.ros.bus import Bus, Publisher

TOPICS = ("/robot_description", "/robot_description_semantic")
TYPE = "std_msgs/String"


class RobotDescriptionPublisher:
    """Publisher of robot descriptions.
    It publishes the URDF and the SRDF, which are parameters of the bus, on latched topics.

    A topic that already has another publisher is skipped.
    """

    def __init__(self, bus: Bus):
        self._bus = bus
        self._publishers: dict[str, Publisher] = {}
        self._told: dict[str, str] = {}

    def publish_changes(self) -> None:
        """Publish each robot description (URDF, SRDF) that has changed since the previous call."""
        published = {t.name for t in self._bus.topics() if t.publishers}
        for topic in TOPICS:
            text = self._bus.parameters.get(topic, None)
            if not isinstance(text, str) or text == self._told.get(topic):
                continue
            if topic not in self._publishers:
                if topic in published:
                    continue
                self._publishers[topic] = self._bus.advertise(topic, TYPE, latch=True)
            self._told[topic] = text
            self._publishers[topic].publish(self._bus.schema.new(TYPE, text))

    def close(self) -> None:
        for publisher in self._publishers.values():
            publisher.close()
