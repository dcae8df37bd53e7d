"""ROS 2's quality-of-service profiles, and the choice of a profile for each topic.

Source of the values: rmw's qos_profiles.h, tf2_ros/qos.hpp, rclcpp's ClockQoS.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from armcell.core.checks import require


@dataclass(frozen=True)
class QosProfile:
    """Quality-of-service (QoS) profile that a ROS 2 endpoint offers or requests."""

    reliable: bool = True
    latched: bool = False  # transient local: the last `depth` messages are kept for late subscribers
    depth: int = 10  # number of messages kept; 0 keeps all

    def __post_init__(self) -> None:
        require(self.depth >= 0, f"depth is {self.depth}, it must be 0 (all) or more")

    def __str__(self) -> str:
        reliability = "reliable" if self.reliable else "best effort"
        return f"{reliability}, {'transient local' if self.latched else 'volatile'}"

    def missing_policies(self, requested: QosProfile) -> list[str]:
        """List the QoS policies that a ROS 2 subscriber requests but that the profile of the publisher does
        not offer.

        The list is empty if publisher and subscriber are compatible.
        """
        missing = []
        if requested.reliable and not self.reliable:
            missing.append("reliable delivery")
        if requested.latched and not self.latched:
            missing.append("transient local durability (latched messages)")
        return missing


DEFAULT = QosProfile()
SENSOR_DATA = QosProfile(reliable=False, depth=5)
SERVICES = QosProfile()
PARAMETERS = QosProfile(depth=1000)
LATCHED = QosProfile(latched=True, depth=1)
TF = QosProfile(depth=100)
TF_STATIC = QosProfile(latched=True, depth=100)
CLOCK = QosProfile(depth=1)
DISCOVERY = QosProfile(latched=True, depth=1)
DISCOVERY_READER = QosProfile(latched=True, depth=0)

LARGE = ("sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/PointCloud2")


def publisher_profile(topic: str, type_name: str, latched: bool) -> QosProfile:
    """Return the QoS profile with which the bridge publishes a ROS 2 topic.

    Images and point clouds are reliable as well, with the short queue of sensor data, so that subscribers of
    either kind receive them (RViz requests reliable ones, camera pipelines best effort).
    """
    if topic == "/tf_static":
        return TF_STATIC
    if latched:
        return LATCHED
    if topic == "/tf":
        return TF
    if topic == "/clock":
        return CLOCK
    if type_name in LARGE:
        return QosProfile(depth=SENSOR_DATA.depth)
    return DEFAULT


def subscriber_profile(publishers: Iterable[QosProfile], depth: int = DEFAULT.depth) -> QosProfile:
    """Return the QoS profile for a ROS 2 subscription. It is the strongest profile that every known publisher
    offers.

    Without known publishers, the profile is ROS 2's default.
    """
    known = list(publishers)
    if not known:
        return QosProfile(depth=depth)
    return QosProfile(all(p.reliable for p in known), all(p.latched for p in known), depth)


BLOCKING = 100_000_000  # [ns] longest wait for queue space when writing a service message


def to_dds_qos(
    profile: QosProfile, user_data: bytes = b"", ignore_own: bool = False, wait: bool = False
) -> Any:
    """Convert a QoS profile of ROS 2 to a `cyclonedds` Qos.

    Args:
        user_data: user data of the endpoint, which discovery distributes.
        ignore_own: a reader ignores samples of its own participant.
        wait: writing waits up to `BLOCKING` for queue space; otherwise a full writer fails immediately.
    """
    from cyclonedds.qos import Policy, Qos

    kept = Policy.History.KeepAll if profile.depth == 0 else Policy.History.KeepLast(profile.depth)
    found: list[Any] = [
        Policy.Reliability.Reliable(BLOCKING if wait else 0)
        if profile.reliable
        else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if profile.latched else Policy.Durability.Volatile,
        kept,
        Policy.DataRepresentation(use_cdrv0_representation=True),
    ]
    if profile.latched:
        found.append(Policy.DurabilityService(0, kept, -1, -1, -1))
    if user_data:
        found.append(Policy.Userdata(user_data))
    if ignore_own:
        found.append(Policy.IgnoreLocal.Participant)
    return Qos(*found)


def profile_of(qos: Any) -> QosProfile:
    """Convert the `cyclonedds` Qos of another endpoint to a QoS profile of ROS 2.

    Discovery does not report the depth, which keeps its default.
    """
    from cyclonedds.qos import Policy

    return QosProfile(
        reliable=_policy(qos, "Reliability") != Policy.Reliability.BestEffort,
        latched=_policy(qos, "Durability") not in (None, Policy.Durability.Volatile),
    )


def user_values(qos: Any) -> dict[str, str]:
    """Parse the `key=value;` pairs that ROS 2 stores in the QoS policy "user data" of an endpoint."""
    policy = _policy(qos, "Userdata")
    text: str = policy.data.decode("latin-1") if policy is not None else ""
    pairs = [part.partition("=") for part in text.split(";")]
    return {key: value for key, equals, value in pairs if equals}


def _policy(qos: Any, scope: str) -> Any:
    return next((policy for policy in qos if policy.__scope__.split(".")[0] == scope), None)
