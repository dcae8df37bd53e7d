"""Discovery range and domain number, from the environment variables that ROS 2 defines.

Source: docs.ros.org, "Improved Dynamic Discovery"; the XML follows rmw_cyclonedds_cpp (Jazzy). Listening on
the loopback interface alone does not suffice: Cyclone nodes that use another interface ignore packets from
loopback.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass

from armcell.core import InputError, UnknownNameError

RANGES = ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT")
MAX_DOMAIN = 232  # higher numbers exceed the range of UDP ports
MAX_PARTICIPANTS = 32  # participants per machine that discovery contacts, as in rmw_cyclonedds_cpp
ANNOUNCE = "1s"  # period of announcements (default 30 s), so that nodes without peers find us soon as well
ELSEWHERE = ("192.0.2.1", 9)  # address reserved for documentation (RFC 5737)
WATERMARK = "64MB"  # unacknowledged data at which a writer blocks; QoS depth is the effective limit


INTERFACES = (
    '<Interfaces><NetworkInterface autodetermine="true" priority="1"/>'
    '<NetworkInterface address="127.0.0.1" priority="0"/></Interfaces>'
)
"""Network interfaces of Cyclone DDS: its own choice (preferred for data), and loopback.

Without loopback, Cyclone 11 drops packets to 127.0.0.1, such as the first messages of Fast DDS in the range
LOCALHOST."""


def _has_network() -> bool:
    """Return whether a ROS 2 domain can extend to other machines: whether this machine has a network
    interface for discovery.

    The test sends no packets.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(ELSEWHERE)
        except OSError:
            return False
        return not probe.getsockname()[0].startswith("127.")


@dataclass(frozen=True)
class DomainScope:
    """Number of a ROS 2 domain, and the range (e.g. only this
    machine) within which discovery finds other nodes.
    """

    domain: int = 0
    range: str = "LOCALHOST"
    peers: tuple[str, ...] = ()  # further addresses that discovery contacts
    config: str = ""  # CYCLONEDDS_URI, which overrides all other settings

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= MAX_DOMAIN:
            raise InputError(f"domain {self.domain} does not exist", hint=f"0 to {MAX_DOMAIN}")
        if self.range not in RANGES:
            raise UnknownNameError("discovery range", self.range, RANGES)

    @property
    def is_open(self) -> bool:
        """Return whether this domain scope lets ROS 2 nodes on other machines discover this process."""
        return self.range in ("SUBNET", "SYSTEM_DEFAULT") or (bool(self.peers) and self.range == "LOCALHOST")

    def xml(self) -> str:
        """Return the domain and the discovery range as an XML configuration of Cyclone DDS."""
        multicast = interfaces = peers = tag = ""
        index = "auto"
        if self.range in ("LOCALHOST", "SUBNET"):
            peers = '<Peer address="localhost"/>'
            if "NetworkInterface" not in self.config and _has_network():
                interfaces = INTERFACES
        if self.range in ("LOCALHOST", "OFF"):
            multicast = "<AllowMulticast>false</AllowMulticast>"
        if self.range == "OFF":
            index, tag = "none", f"<Tag>ros_discovery_off_{os.getpid()}</Tag>"
        if self.range in ("LOCALHOST", "SUBNET"):
            peers += "".join(f'<Peer address="{peer}"/>' for peer in self.peers)
        if peers:  # also in SUBNET, because nodes in the range LOCALHOST receive no multicast
            peers = f'<Peers addlocalhost="true">{peers}</Peers>'
        discovery = (
            f"<ParticipantIndex>{index}</ParticipantIndex>"
            f"<MaxAutoParticipantIndex>{MAX_PARTICIPANTS}</MaxAutoParticipantIndex>{tag}"
            f"<SPDPInterval>{ANNOUNCE}</SPDPInterval>"
            # Cyclone 11 drops addresses that stay silent for 30 s and would never find nodes that start later
            "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
            f"{peers}"
        )
        if self.range == "SYSTEM_DEFAULT":
            discovery = ""
        found = (
            f"<CycloneDDS><Domain><General>{interfaces}{multicast}</General>"
            f"<Discovery>{discovery}</Discovery>"
            f"<Internal><Watermarks><WhcHigh>{WATERMARK}</WhcHigh></Watermarks></Internal>"
            "</Domain></CycloneDDS>"
        )
        return f"{found},{self.config}" if self.config else found


def from_environment(
    domain: int | None = None, network: bool = False, environ: Mapping[str, str] = os.environ
) -> DomainScope:
    """Read the domain number and the discovery range from the environment variables of ROS 2.

    The variables are ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_LOCALHOST_ONLY, ROS_STATIC_PEERS and
    CYCLONEDDS_URI.

    Args:
        domain: domain number that replaces ROS_DOMAIN_ID.
        network: use the range SUBNET if no variable sets a range. ROS 2 does so by default; armcell does not,
            because every node that can reach it can move the robot.
    Raises:
        InputError: a variable has a value that ROS 2 does not accept.
    """
    if domain is None:
        text = environ.get("ROS_DOMAIN_ID") or "0"
        if not text.isdigit():
            raise InputError(f"ROS_DOMAIN_ID is {text!r}", hint=f"a number, 0 to {MAX_DOMAIN}")
        domain = int(text)
    range_ = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or ("SUBNET" if network else "LOCALHOST")
    if environ.get("ROS_LOCALHOST_ONLY") == "1":
        range_ = "LOCALHOST"
    peers = [p.strip() for p in environ.get("ROS_STATIC_PEERS", "").split(";") if p.strip()]
    if bad := [p for p in peers if not all(c.isalnum() or c in ".:-_" for c in p)]:
        raise InputError(f"ROS_STATIC_PEERS has {bad[0]!r}", hint="addresses with ';' between them")
    return DomainScope(domain, range_, tuple(peers), environ.get("CYCLONEDDS_URI", ""))
