"""Robot descriptions (URDF, SRDF) as parameters and latched topics, for RViz, Unity and ROS 2 programs.

The parameters are `/robot_description` (URDF), `/robot_description_semantic` (SRDF),
`/robot_description_planning` (joint limits, default scaling) and `/robot_description_kinematics`, as
RViz and moveit_commander expect them. ROS 1 programs read the texts from the parameter server, Unity
and ROS 2 programs from the topics.
"""

from __future__ import annotations

from armcell.model import RobotModel
from armcell.model.setup import srdf_of, srdf_text
from armcell.model.setup.defaults import joint_limits, kinematics
from armcell.model.urdf_writer import urdf_of
from armcell.ros.bus import Bus, Publisher

TOPICS = ("/robot_description", "/robot_description_semantic")
TYPE = "std_msgs/String"
NAME = "/robot_description"


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


def publish_robot_description(bus: Bus, model: RobotModel) -> RobotDescriptionPublisher:
    """Set the parameters robot_description and robot_description_semantic.
    Also publish the URDF and the SRDF on latched topics.

    An existing URDF parameter is kept. Unity and ROS 2 have no parameter server, so their programs read the
    topics.
    """
    if NAME not in bus.parameters:
        bus.parameters.set(NAME, urdf_of(model))
    bus.parameters.set(f"{NAME}_semantic", srdf_text(srdf_of(model)))
    bus.parameters.set(f"{NAME}_planning", joint_limits(model))
    bus.parameters.set(f"{NAME}_kinematics", kinematics(model))
    topics = RobotDescriptionPublisher(bus)
    topics.publish_changes()
    return topics
