"""ROS 2 through Cyclone DDS (extra `ros2`), with nothing of ROS installed.

names: how ROS 2 calls things on DDS. dialect, codec: its message definitions and bytes. qos, range: its
profiles and environment variables. idl, dds: the library. graph: who else is there. context: what the parts
share. topics, services, goals, reaching, parameters, descriptions: the parts. bridge: joins a bus to a
domain.
"""

from armcell.ros.ros2.bridge import Ros2Bridge, Ros2Settings, Ros2Status
from armcell.ros.ros2.qos import DEFAULT, LATCHED, PARAMETERS, SENSOR_DATA, SERVICES, Profile
from armcell.ros.ros2.range import Reach, from_environment

__all__ = [
    "DEFAULT",
    "LATCHED",
    "PARAMETERS",
    "SENSOR_DATA",
    "SERVICES",
    "Profile",
    "Reach",
    "Ros2Bridge",
    "Ros2Settings",
    "Ros2Status",
    "from_environment",
]
