"""A domain for each test, and the peer process that meets us there."""

import itertools
import json
import os
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest

from armcell.ros import Bus, schema

PEER = Path(__file__).parent / "peer.py"
DOMAINS = itertools.count(os.getpid())
# What rmw_cyclonedds_cpp makes of ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST.
LOCALHOST = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    '<Peers><Peer address="localhost"/></Peers></Discovery></Domain></CycloneDDS>'
)

POSITIONAL = {
    "publish": ("topic", "fields"),
    "publish_bytes": ("topic", "data"),
    "take": ("topic", "count"),
    "call": ("service", "name", "request"),
    "answer": ("service", "name", "seq"),
    "serve_trigger": ("service", "message"),
    "serve_gripper": ("name", "seconds"),
    "serve_arm": ("name", "joints", "start"),
    "node": ("namespace", "name"),
}


class PeerProcess:
    """Sends commands to a peer and gives its answers."""

    def __init__(self, domain, tag, range_config=LOCALHOST):
        config = f"{range_config},{tag}"
        self.process = subprocess.Popen(
            [sys.executable, PEER, str(domain), config],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert json.loads(self.process.stdout.readline()) == "ready"

    def __getattr__(self, command):
        def run(*positional, **arguments):
            names = POSITIONAL.get(command, ("topic", "type"))
            arguments |= dict(zip(names, positional))
            self.process.stdin.write(json.dumps({"do": command, **arguments}) + "\n")
            self.process.stdin.flush()
            answer = json.loads(self.process.stdout.readline())
            assert "error" not in answer, answer["error"]
            return answer["ok"]

        return run

    def wait_matched(self, topic, count=1, timeout=5.0):
        end = time.monotonic() + timeout
        while self.matched(topic) != count:
            assert time.monotonic() < end, f"{topic}: {self.matched(topic)} matched, not {count}"
            time.sleep(0.02)

    def close(self):
        self.process.stdin.close()
        self.process.wait(10)


@pytest.fixture(scope="module")
def reach():
    """A domain that no other module's tests are in, at the same time and on the same machine."""
    from armcell.ros.ros2 import DomainScope

    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (pip install 'armcell[ros2]')")
    tag = f"<CycloneDDS><Domain><Discovery><Tag>{uuid.uuid4().hex}</Tag></Discovery></Domain></CycloneDDS>"
    return DomainScope(1 + next(DOMAINS) % 100, config=tag)


@pytest.fixture(scope="module")
def peer(reach):
    """One for all tests of a module: each uses names of its own."""
    process = PeerProcess(reach.domain, reach.config)
    yield process
    process.close()


@pytest.fixture
def mortal(reach):
    """A peer that may be killed."""
    process = PeerProcess(reach.domain, reach.config)
    yield process
    process.process.kill()
    process.process.wait(10)


@pytest.fixture
def bus():
    return Bus(schema())


@pytest.fixture
def bridge(bus, reach):
    """The bus, joined to the domain."""
    from armcell.ros.ros2 import Ros2Bridge, Ros2Settings

    with Ros2Bridge(bus, Ros2Settings(reach, distro="jazzy")) as made:
        yield made
