"""The planners that are compared, one file each."""

from __future__ import annotations

import sys
from importlib.util import find_spec

from benchmarks.planning.peers.armcell import Armcell
from benchmarks.planning.peers.base import Peer, Result, UnsupportedRobot
from benchmarks.planning.peers.ompl_coal import OmplCoal

NATIVE = "armcell"
VAMP = "VAMP"
FAST = (NATIVE, VAMP)  # a problem takes them milliseconds: they plan all problems of every robot
KERNEL_OMPL = "OMPL on armcell's kernel"


def all_peers() -> list[Peer]:
    """Those that are installed, in the order in which they get each problem."""
    peers: list[Peer] = [Armcell(NATIVE, "native"), Armcell(KERNEL_OMPL, "ompl/RRTConnect"), OmplCoal()]
    if find_spec("roboplan"):
        from benchmarks.planning.peers.roboplan import Roboplan

        peers.insert(1, Roboplan())
    else:
        print("Leaving out roboplan: pip install -r requirements-bench.txt", file=sys.stderr)
    try:
        from benchmarks.planning.peers.vamp import Vamp

        peers.insert(1, Vamp())
    except ImportError as error:
        print(f"Leaving out VAMP: {error}", file=sys.stderr)
    return peers


__all__ = [
    "FAST",
    "KERNEL_OMPL",
    "NATIVE",
    "VAMP",
    "OmplCoal",
    "Peer",
    "Result",
    "UnsupportedRobot",
    "all_peers",
]
