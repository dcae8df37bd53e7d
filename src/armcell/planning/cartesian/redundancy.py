"""Redundancy resolution along a line by dynamic programming over the null space of the arm.

All joint solutions of a pose that are reachable without a jump form a curve, the null space. The search
cuts the line coarsely and keeps, at each cut, one configuration per stretch of this curve. It continues from
each configuration by staying or by moving one stretch to either side (dynamic programming as over Descartes'
ladder graph, but restricted to the curve through the start). The fine steps are then pulled toward the
cheapest solution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3
from armcell.kinematics import IKSolver

Array = NDArray[np.float64]

STRIDE = 4  # steps of the line between two cuts
STRETCH = 0.15  # [rad or m] of the joint that moves most along the null space
WIDEST = 16  # stretches to either side of the start
LARGEST = 0.6  # [rad or m] largest joint step between two cuts; a larger step means another branch
NEAR_LIMIT = 0.2  # weight of nearness to a limit relative to squared joint motion


@dataclass(frozen=True, eq=False)
class _Node:
    q: Array  # (n,)
    along: Array  # (n,) null-space direction, with the same orientation at all cuts
    cost: float
    before: _Node | None


def plan_redundancy(
    ik: IKSolver,
    poses: list[SE3],
    start: Array,
    rest: Array,
    bounds: Array,
    zone: Array,
    allowed: Callable[[Array], bool],
) -> Array | None:
    """Choose how a redundant arm moves along a line. Return joint positions (len(poses), n) that guide the
    arm, or None if no suitable motion exists.

    Args:
        start: (n,). rest: (dof,) of all joints. bounds: (n, 2) joint limits. zone: (n,) distance from the
            limits that is penalized.
        allowed: returns whether the arm may be at positions (n,).
    """
    cuts = [*range(STRIDE - 1, len(poses) - 1, STRIDE), len(poses) - 1]
    full = rest.copy()
    full[ik.columns] = start
    layer = {0: _Node(start, _null(ik, full, None), 0.0, None)}
    for cut in cuts:
        found: dict[int, _Node] = {}
        for number, node in layer.items():
            for side in (0, -1, 1):
                at = number + side
                if abs(at) > WIDEST:
                    continue
                full[ik.columns] = node.q
                if not ik.descend(full, poses[cut], wish=side * STRETCH * node.along, bounds=bounds)[2]:
                    continue
                q = full[ik.columns].copy()
                moved = q - node.q
                if np.max(np.abs(moved)) > LARGEST:
                    continue
                inside = np.minimum(q - bounds[:, 0], bounds[:, 1] - q)
                near = np.maximum(1.0 - inside / np.maximum(zone, 1e-9), 0.0)
                cost = node.cost + float(moved @ moved) + NEAR_LIMIT * float(near @ near)
                if (at in found and found[at].cost <= cost) or not allowed(q):
                    continue
                found[at] = _Node(q, _null(ik, full, node.along), cost, node)
        if not found:
            return None
        layer = found
    return _between(min(layer.values(), key=lambda node: node.cost), cuts, len(poses))


def _null(ik: IKSolver, full: Array, like: Array | None) -> Array:
    """Compute the direction (n,) in which a redundant arm can move its joints without moving the tip. Its
    largest component is 1, and its sign agrees with `like`.
    """
    J = ik.tree.jacobian(full, ik.tip_link, ik.joint_names)
    along = np.linalg.svd(J)[2][-1]
    along = along / np.max(np.abs(along))
    return -along if like is not None and along @ like < 0 else along


def _between(last: _Node, cuts: list[int], count: int) -> Array:
    """Interpolate a redundant arm's joint positions linearly along a line, between the configurations that
    the search chose at a few steps of the line (`cuts`).
    """
    nodes: list[Array] = []
    node: _Node | None = last
    while node is not None:
        nodes.append(node.q)
        node = node.before
    points = np.array(nodes[::-1])
    at = np.array([-1, *cuts])
    steps = np.arange(count)
    return np.column_stack([np.interp(steps, at, points[:, j]) for j in range(points.shape[1])])
