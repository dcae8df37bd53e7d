"""How ROS 2 calls its topics, services and types on DDS.

Source: design.ros2.org/articles/topic_and_service_names.html and rmw_cyclonedds_cpp: `rt/chatter` with type
`std_msgs::msg::dds_::String_`; a service is `rq/<name>Request` and `rr/<name>Reply`; an action is three
services and two topics below `<name>/_action`.
"""

from __future__ import annotations

import re
from typing import NamedTuple

SEND_GOAL, CANCEL_GOAL, GET_RESULT = "/_action/send_goal", "/_action/cancel_goal", "/_action/get_result"
FEEDBACK, STATUS = "/_action/feedback", "/_action/status"
_TYPE = re.compile(r"^(\w+)::(msg|srv|action)::dds_::(\w+)_$")


class DdsName(NamedTuple):
    """A DDS topic."""

    topic: str
    type: str  # as DDS has it
    message: str  # our name of the message: `std_msgs/String`, `std_srvs/TriggerRequest`
    has_header: bool = False  # requests and replies begin with who asked and the number of the call


def dds_type(name: str, kind: str = "msg") -> str:
    """`std_msgs/String` as `std_msgs::msg::dds_::String_`."""
    package, _, item = name.partition("/")
    return f"{package}::{kind}::dds_::{item}_"


def ros_type(name: str) -> str | None:
    """`std_msgs::msg::dds_::String_` as `std_msgs/String`; None for what is no ROS type."""
    match = _TYPE.match(name)
    return f"{match[1]}/{match[3]}" if match else None


def topic(name: str, type_name: str, kind: str = "msg") -> DdsName:
    """A ROS topic on DDS. `name` is a full name with its leading slash."""
    return DdsName(f"rt{name}", dds_type(type_name, kind), type_name)


def request(name: str, type_name: str, kind: str = "srv") -> DdsName:
    """What a service's client writes; `kind` is action for the services of an action."""
    message = f"{type_name}Request" if kind == "srv" else f"{type_name}_Request"
    return DdsName(f"rq{name}Request", dds_type(f"{type_name}_Request", kind), message, True)


def reply(name: str, type_name: str, kind: str = "srv") -> DdsName:
    """What a service's server writes."""
    message = f"{type_name}Response" if kind == "srv" else f"{type_name}_Response"
    return DdsName(f"rr{name}Reply", dds_type(f"{type_name}_Response", kind), message, True)


DISCOVERY = DdsName(
    "ros_discovery_info",
    "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_",
    "rmw_dds_common/ParticipantEntitiesInfo",
)


def action_name(name: str, type_name: str) -> str:
    """An action's name in ROS 2: what MoveIt calls `move_group` in ROS 1 is `move_action` in MoveIt 2.

    Source: move_group/capability_names.h.
    """
    if type_name == "moveit_msgs/MoveGroup" and name.endswith("/move_group"):
        return name.removesuffix("move_group") + "move_action"
    return name


def ros_topic(dds_topic: str) -> str | None:
    """`rt/chatter` as `/chatter`; None for what is no ROS topic."""
    return dds_topic[2:] if dds_topic.startswith("rt/") else None


def ros_service(dds_topic: str) -> str | None:
    """`rq/add_two_intsRequest` as `/add_two_ints`; None for what is no request topic of ROS."""
    if dds_topic.startswith("rq/") and dds_topic.endswith("Request"):
        return dds_topic[2 : -len("Request")]
    return None
