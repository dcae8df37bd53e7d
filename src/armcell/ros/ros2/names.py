"""Names of ROS 2 topics, services and types on DDS.

Source: design.ros2.org/articles/topic_and_service_names.html and rmw_cyclonedds_cpp. A topic `/chatter` is
`rt/chatter` with the type `std_msgs::msg::dds_::String_`; a service is `rq/<name>Request` and
`rr/<name>Reply`; an action is three services and two topics below `<name>/_action`.
"""

from __future__ import annotations

import re
from typing import NamedTuple

SEND_GOAL, CANCEL_GOAL, GET_RESULT = "/_action/send_goal", "/_action/cancel_goal", "/_action/get_result"
FEEDBACK, STATUS = "/_action/feedback", "/_action/status"
_TYPE = re.compile(r"^(\w+)::(msg|srv|action)::dds_::(\w+)_$")


class DdsName(NamedTuple):
    """Names of a ROS 2 topic and of its message type, as DDS uses them."""

    topic: str
    type: str  # type name on DDS
    message: str  # armcell's name of the message: `std_msgs/String`, `std_srvs/TriggerRequest`
    has_header: bool = False  # requests and replies begin with the client's id and the call's number


def dds_type(full: str) -> str:
    """Convert the name of a ROS 2 type, such as `std_msgs/msg/String`, to its name in DDS,
    `std_msgs::msg::dds_::String_`.
    """
    package, kind, item = full.split("/")
    return f"{package}::{kind}::dds_::{item}_"


def _dds(name: str, kind: str) -> str:
    package, _, item = name.partition("/")
    return dds_type(f"{package}/{kind}/{item}")


def ros_type(name: str) -> str | None:
    """Convert the name of a type in DDS, such as `std_msgs::msg::dds_::String_`, to its ROS name,
    `std_msgs/String`.

    Returns:
        The ROS type name, or None if the DDS type is not a ROS type.
    """
    match = _TYPE.match(name)
    return f"{match[1]}/{match[3]}" if match else None


def topic(name: str, type_name: str, kind: str = "msg") -> DdsName:
    """Return the DDS name of a ROS 2 topic.

    Args:
        name: full name of the topic with its leading slash.
        kind: part of the type's full name: "msg", or "action" for feedback messages.
    """
    return DdsName(f"rt{name}", _dds(type_name, kind), type_name)


def request(name: str, type_name: str, kind: str = "srv") -> DdsName:
    """Return the DDS name of the topic that carries the requests to a ROS 2 service.

    Args:
        kind: "srv", or "action" for the services of an action.
    """
    message = f"{type_name}Request" if kind == "srv" else f"{type_name}_Request"
    return DdsName(f"rq{name}Request", _dds(f"{type_name}_Request", kind), message, True)


def reply(name: str, type_name: str, kind: str = "srv") -> DdsName:
    """Return the DDS name of the topic that carries the replies of a ROS 2 service.

    Args:
        kind: "srv", or "action" for the services of an action.
    """
    message = f"{type_name}Response" if kind == "srv" else f"{type_name}_Response"
    return DdsName(f"rr{name}Reply", _dds(f"{type_name}_Response", kind), message, True)


DISCOVERY = DdsName(
    "ros_discovery_info",
    "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_",
    "rmw_dds_common/ParticipantEntitiesInfo",
)


def action_name(name: str, type_name: str) -> str:
    """Return the ROS 2 name of an action on the bus.

    ROS 1's MoveIt action `move_group` is `move_action` in MoveIt 2; other names do not change. Source:
    move_group/capability_names.h.
    """
    if type_name == "moveit_msgs/MoveGroup" and name.endswith("/move_group"):
        return name.removesuffix("move_group") + "move_action"
    return name


def ros_topic(dds_topic: str) -> str | None:
    """Convert the name of a DDS topic, such as `rt/chatter`, to the name of the ROS topic, `/chatter`.

    Returns:
        The ROS topic, or None if the DDS topic is not a ROS topic.
    """
    return dds_topic[2:] if dds_topic.startswith("rt/") else None


def ros_service(dds_topic: str) -> str | None:
    """Convert the name of a DDS topic, such as `rq/add_two_intsRequest`,
    to the name of the ROS service, `/add_two_ints`.

    Returns:
        The service name, or None if the DDS topic is not a ROS request topic.
    """
    if dds_topic.startswith("rq/") and dds_topic.endswith("Request"):
        return dds_topic[2 : -len("Request")]
    return None
