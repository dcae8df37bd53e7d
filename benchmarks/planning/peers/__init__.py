"""The planners that are compared, one file each."""

from __future__ import annotations

from benchmarks.planning.peers.armcell import Armcell
from benchmarks.planning.peers.base import Peer, Result
from benchmarks.planning.peers.ompl_coal import OmplCoal
from benchmarks.planning.peers.roboplan import Roboplan

NATIVE = "armcell"
KERNEL_OMPL = "OMPL on armcell's kernel"


def all_peers() -> list[Peer]:
    return [Armcell(NATIVE, "native"), Roboplan(), Armcell(KERNEL_OMPL, "ompl/RRTConnect"), OmplCoal()]


__all__ = ["KERNEL_OMPL", "NATIVE", "Peer", "Result", "all_peers"]
