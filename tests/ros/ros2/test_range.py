"""ROS 2's environment variables and quality of service, by their documented meaning."""

import xml.etree.ElementTree as ET

import pytest

from armcell.core import InputError
from armcell.ros.ros2 import QosProfile, from_environment
from armcell.ros.ros2.qos import LATCHED, publisher_profile, subscriber_profile


def read(reach):
    return ET.fromstring(reach.xml().split(",")[0])


def test_the_domain():
    assert from_environment(environ={}).domain == 0
    assert from_environment(environ={"ROS_DOMAIN_ID": "42"}).domain == 42
    assert from_environment(7, environ={"ROS_DOMAIN_ID": "42"}).domain == 7
    for bad in ("x", "-1", "1.5"):
        with pytest.raises(InputError, match="ROS_DOMAIN_ID"):
            from_environment(environ={"ROS_DOMAIN_ID": bad})
    with pytest.raises(InputError, match="233 does not exist"):
        from_environment(environ={"ROS_DOMAIN_ID": "233"})


def test_only_this_machine_unless_asked():
    near = from_environment(environ={})
    assert near.range == "LOCALHOST" and not near.is_open
    assert read(near).find(".//AllowMulticast").text == "false"
    assert [p.get("address") for p in read(near).iter("Peer")] == ["localhost"]
    for far in (
        from_environment(network=True, environ={}),
        from_environment(environ={"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}),
    ):
        assert far.range == "SUBNET" and far.is_open
        assert read(far).find(".//AllowMulticast") is None
        assert [p.get("address") for p in read(far).iter("Peer")] == ["localhost"]
    only = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOCALHOST_ONLY": "1"}
    assert from_environment(network=True, environ=only).range == "LOCALHOST"
    assert from_environment(network=True, environ={"ROS_LOCALHOST_ONLY": "0"}).range == "SUBNET"
    off = from_environment(environ={"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"})
    assert read(off).find(".//Tag").text.startswith("ros_discovery_off_") and not off.is_open
    with pytest.raises(InputError, match="LOCALHOST"):
        from_environment(environ={"ROS_AUTOMATIC_DISCOVERY_RANGE": "FAR"})


def test_static_peers_and_an_own_configuration():
    found = from_environment(
        environ={"ROS_STATIC_PEERS": "192.168.1.5; robot.local", "CYCLONEDDS_URI": "<x/>"}
    )
    assert found.peers == ("192.168.1.5", "robot.local") and found.is_open
    assert [p.get("address") for p in read(found).iter("Peer")] == ["localhost", "192.168.1.5", "robot.local"]
    assert found.xml().endswith(",<x/>")
    with pytest.raises(InputError, match="ROS_STATIC_PEERS"):
        from_environment(environ={"ROS_STATIC_PEERS": '"/><Tag>x</Tag>'})


def test_profiles():
    assert publisher_profile("/joint_states", "sensor_msgs/JointState", False) == QosProfile(True, False, 10)
    assert publisher_profile("/robot_description", "std_msgs/String", True) == LATCHED
    assert publisher_profile("/tf_static", "tf2_msgs/TFMessage", False).latched
    assert publisher_profile("/tf", "tf2_msgs/TFMessage", False).depth == 100
    assert publisher_profile("/camera/image", "sensor_msgs/Image", False).depth == 5
    best_effort, latched = QosProfile(reliable=False), QosProfile(latched=True)
    assert subscriber_profile([]) == QosProfile()
    assert subscriber_profile([QosProfile(), best_effort]) == best_effort
    assert (
        subscriber_profile([latched, latched]) == latched
        and subscriber_profile([latched, QosProfile()]) == QosProfile()
    )
    assert best_effort.missing_policies(QosProfile()) == [
        "reliable delivery"
    ] and not QosProfile().missing_policies(best_effort)
    assert len(best_effort.missing_policies(latched)) == 2
    with pytest.raises(InputError, match="depth"):
        QosProfile(depth=-1)
