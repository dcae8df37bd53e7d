"""Robot descriptions as parameters, as RViz and moveit_commander expect them.

The parameters are `/robot_description` (URDF), `/robot_description_semantic` (SRDF),
`/robot_description_planning` (joint limits, default scaling) and `/robot_description_kinematics`.
"""

from __future__ import annotations

from armcell.model import RobotModel
from armcell.model.setup import srdf_of, srdf_text
from armcell.model.setup.defaults import joint_limits, kinematics
from armcell.model.urdf_writer import urdf_of
from armcell.ros.bus import Bus
from armcell.ros.robot_description_publisher import RobotDescriptionPublisher

NAME = "/robot_description"


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
