"""Final paths looked at again, with exact meshes at small steps."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from benchmarks.planning.pinocchio_world import PinocchioWorld

STEP = 0.002  # [rad] between samples, in the norm of the joint space


def first_contact(world: PinocchioWorld, waypoints: NDArray[np.float64], step: float = STEP) -> str:
    """Where (fraction of the edges) and what the path (k, dof) touches first; empty if nothing."""
    for i, (a, b) in enumerate(itertools.pairwise(waypoints)):
        count = int(np.ceil(np.linalg.norm(b - a) / step))
        for k in range(count + 1):
            q = a + (b - a) * (k / max(count, 1))
            if world.touches(q):
                return f"edge {i} at {k / max(count, 1):.4f}: {world.contact(q)}"
    return ""
