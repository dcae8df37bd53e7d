"""How far discovery reaches, and the domain's number: ROS 2's environment variables, as ROS 2 reads them.

Source: docs.ros.org, "Improved Dynamic Discovery"; the XML is what rmw_cyclonedds_cpp (Jazzy) makes of them.
The loopback interface alone would not do: nodes that use another one ignore what comes from it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

from armcell.core import InputError, UnknownNameError

RANGES = ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT")
MAX_DOMAIN = 232  # above, UDP has no ports left
MAX_PARTICIPANTS = 32  # of one machine, as rmw_cyclonedds_cpp looks for them
ANNOUNCE = "1s"  # between two announcements (30 s by default): found soon by nodes that ask nobody, too
WATERMARK = "64MB"  # unacknowledged data at which a writer stops; each keeps no more than its depth anyway


@dataclass(frozen=True)
class Reach:
    """Which domain, and who in it is looked for."""

    domain: int = 0
    range: str = "LOCALHOST"
    peers: tuple[str, ...] = ()  # addresses that are asked besides
    config: str = ""  # CYCLONEDDS_URI, which has the last word

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= MAX_DOMAIN:
            raise InputError(f"domain {self.domain} does not exist", cure=f"0 to {MAX_DOMAIN}")
        if self.range not in RANGES:
            raise UnknownNameError("discovery range", self.range, RANGES)

    @property
    def is_open(self) -> bool:
        """Whether other machines may find us."""
        return self.range in ("SUBNET", "SYSTEM_DEFAULT") or (bool(self.peers) and self.range == "LOCALHOST")

    def xml(self) -> str:
        """The configuration of Cyclone DDS."""
        multicast = peers = tag = ""
        index = "auto"
        if self.range in ("LOCALHOST", "SUBNET"):  # SUBNET: nodes in range LOCALHOST hear no multicast
            peers = '<Peer address="localhost"/>'
        if self.range in ("LOCALHOST", "OFF"):
            multicast = "<AllowMulticast>false</AllowMulticast>"
        if self.range == "OFF":
            index, tag = "none", f"<Tag>ros_discovery_off_{os.getpid()}</Tag>"
        if self.range in ("LOCALHOST", "SUBNET"):
            peers += "".join(f'<Peer address="{peer}"/>' for peer in self.peers)
        discovery = (
            f"<ParticipantIndex>{index}</ParticipantIndex>"
            f"<MaxAutoParticipantIndex>{MAX_PARTICIPANTS}</MaxAutoParticipantIndex>{tag}"
            f"<SPDPInterval>{ANNOUNCE}</SPDPInterval>"
            # Cyclone 11 gives up addresses that stay silent for 30 s: later nodes would never be found
            "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
            f"{f'<Peers>{peers}</Peers>' if peers else ''}"
        )
        if self.range == "SYSTEM_DEFAULT":
            discovery = ""
        found = (
            f"<CycloneDDS><Domain><General>{multicast}</General>"
            f"<Discovery>{discovery}</Discovery>"
            f"<Internal><Watermarks><WhcHigh>{WATERMARK}</WhcHigh></Watermarks></Internal>"
            "</Domain></CycloneDDS>"
        )
        return f"{found},{self.config}" if self.config else found


def from_environment(
    domain: int | None = None, network: bool = False, environ: Mapping[str, str] = os.environ
) -> Reach:
    """ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_LOCALHOST_ONLY, ROS_STATIC_PEERS, CYCLONEDDS_URI.

    Args:
        domain: instead of ROS_DOMAIN_ID.
        network: reach the subnet where no variable says otherwise. ROS 2 does so by itself, we do not:
            who can talk to us can move the robot.
    Raises:
        InputError: a variable has a value that ROS 2 does not know.
    """
    if domain is None:
        text = environ.get("ROS_DOMAIN_ID") or "0"
        if not text.isdigit():
            raise InputError(f"ROS_DOMAIN_ID is {text!r}", cure=f"a number, 0 to {MAX_DOMAIN}")
        domain = int(text)
    range_ = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or ("SUBNET" if network else "LOCALHOST")
    if environ.get("ROS_LOCALHOST_ONLY") == "1":
        range_ = "LOCALHOST"
    peers = [p.strip() for p in environ.get("ROS_STATIC_PEERS", "").split(";") if p.strip()]
    if bad := [p for p in peers if not all(c.isalnum() or c in ".:-_" for c in p)]:
        raise InputError(f"ROS_STATIC_PEERS has {bad[0]!r}", cure="addresses with ';' between them")
    return Reach(domain, range_, tuple(peers), environ.get("CYCLONEDDS_URI", ""))
