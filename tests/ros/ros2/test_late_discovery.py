"""Nodes that start long after armcell find it: Cyclone 11 gives up silent addresses after 30 s by default."""

import time
import uuid
from contextlib import ExitStack

import pytest
from tests.ros.ros2.conftest import LOCALHOST, PeerProcess

from armcell.ros import Bus, schema
from armcell.ros.ros2 import DomainScope, Ros2Bridge, Ros2Settings

ALONE = 35.0  # [s]
SUBNET = (
    "<CycloneDDS><Domain><Discovery><ParticipantIndex>auto</ParticipantIndex></Discovery></Domain>"
    "</CycloneDDS>"
)
TAG = "<CycloneDDS><Domain><Discovery><Tag>{}</Tag></Discovery></Domain></CycloneDDS>"
LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex></Discovery></Domain></CycloneDDS>"
)
PEERS = {"asks only 127.0.0.1": LOCALHOST, "uses only multicast": SUBNET}
IN_TIME = 2.0  # [s]


@pytest.mark.long
def test_nodes_that_start_after_half_a_minute_are_found_at_once():
    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (pip install 'armcell[ros2]')")
    with ExitStack() as stack:
        alone = {}
        for k, name in enumerate(("LOCALHOST", "SUBNET")):
            reach = DomainScope(140 + 2 * k, name, config=TAG.format(uuid.uuid4().hex))
            bus = Bus(schema())
            stack.enter_context(Ros2Bridge(bus, Ros2Settings(reach, distro="jazzy")))
            bus.advertise("/late", "std_msgs/String")
            alone[name] = reach
        time.sleep(ALONE)
        late = []
        for name, reach in alone.items():
            for peer, config in PEERS.items():
                process = PeerProcess(reach.domain, reach.config, config)
                stack.callback(process.close)
                began = time.monotonic()
                process.subscribe("rt/late", "String")
                while process.matched("rt/late") != 1 and time.monotonic() < began + 6:
                    time.sleep(0.02)
                if (took := time.monotonic() - began) > IN_TIME:
                    late.append(f"armcell in {name}, a node that {peer}: {took:.1f} s")
        assert not late


@pytest.mark.slow
@pytest.mark.cases("armcell-SUBNET-LOCALHOST", "node-LOCALHOST-SUBNET", "node-SUBNET-loopback only")
@pytest.mark.parametrize(
    "config", [LOCALHOST, SUBNET, LOOPBACK], ids=["LOCALHOST", "SUBNET", "loopback only"]
)
@pytest.mark.parametrize("range_", ["LOCALHOST", "SUBNET"])
@pytest.mark.parametrize("first", ["armcell", "node"])
def test_nodes_find_each_other_in_every_range_and_order(range_, config, first):
    """A node of Humble with ROS_LOCALHOST_ONLY uses the loopback interface alone."""
    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (pip install 'armcell[ros2]')")
    reach = DomainScope(146, range_, config=TAG.format(uuid.uuid4().hex))
    with ExitStack() as stack:

        def armcell():
            bus = Bus(schema())
            stack.enter_context(Ros2Bridge(bus, Ros2Settings(reach, distro="jazzy")))
            bus.advertise("/late", "std_msgs/String")

        def node():
            process = PeerProcess(reach.domain, reach.config, config)
            stack.callback(process.close)
            process.subscribe("rt/late", "String")
            return process

        if first == "armcell":
            armcell()
        process = node()
        began = time.monotonic()
        if first == "node":
            time.sleep(0.5)
            began = time.monotonic()
            armcell()
        while process.matched("rt/late") != 1:
            assert time.monotonic() < began + IN_TIME
            time.sleep(0.02)
