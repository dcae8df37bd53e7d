"""ROS 2 through Cyclone DDS (extra `ros2`); needs no ROS installation.

names: ROS 2 names on DDS. dialect, codec: message definitions and serialization of a distribution. qos,
range: quality-of-service profiles and environment variables. idl, dds: the Cyclone DDS library. graph:
discovery of other nodes. context: state that all parts share. topics, services, goals, reaching, parameters:
the parts of the bridge. bridge: connects a bus to a domain.
"""

from armcell.ros.ros2.bridge import Ros2Bridge, Ros2Settings, Ros2Status
from armcell.ros.ros2.domain_scope import DomainScope, from_environment
from armcell.ros.ros2.qos import DEFAULT, LATCHED, PARAMETERS, SENSOR_DATA, SERVICES, QosProfile

__all__ = [
    "DEFAULT",
    "LATCHED",
    "PARAMETERS",
    "SENSOR_DATA",
    "SERVICES",
    "DomainScope",
    "QosProfile",
    "Ros2Bridge",
    "Ros2Settings",
    "Ros2Status",
    "from_environment",
]
