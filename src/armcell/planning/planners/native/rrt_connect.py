"""RRT-Connect kernel (Kuffner and LaValle, ICRA 2000) with limited domains and samples near the ends.

Design choices follow VAMP (Thomason, Kingston and Kavraki, ICRA 2024).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.block import ints
from armcell.collision.kernel.motion import edge_free
from armcell.collision.kernel.pack import DOF
from armcell.collision.kernel.simd import pointer
from armcell.planning.planners.native.nearest_neighbors import nearest_node
from armcell.planning.planners.native.tree import (
    add,
    get,
    next_tree,
    remove_nodes,
    trace,
    tree_pointers,
)

# A node from which an edge failed accepts only samples that are nearer than this share of the typical
# distance of two random configurations (4 rad for a Panda).
DOMAIN = 0.75
UNLIMITED = 1e9

# Samples come from the box around the start and a goal, widened on each side by NEAR [rad or m]. The width
# grows by NEAR in every GROWTH iterations, until the box contains the whole space. Most paths stay near their
# ends: on the half of MotionBenchMaker's problems that was not used to choose these numbers, p95 of the
# search fell by 10 % (UR5) and 47 % (Panda), and the paths became shorter by 7 % and 5 %.
NEAR = 0.7
GROWTH = 1000

# Contents of `found`: the nodes of trees 0 and 1 that met, and the state of a continued search:
# iterations, nodes, nodes of each tree, whose turn it is.
FROM, TO, ITERATIONS, NODES, NODES_0, NODES_1, TURN, FOUND = range(8)


def space_size(dof: int) -> int:
    """Compute the size, in doubles, of the scratch memory that the RRT-Connect kernel needs.

    Layout: [edge, sample], [sample steps], [sample], [closest approach].
    """
    return 7 * dof + 1


def closest_at(dof: int) -> int:
    """Return the position in scratch memory at which the RRT-Connect kernel stores the closest approach of
    its two trees.

    The closest approach is a length [rad], then its two ends.
    """
    return 5 * dof


@njit(cache=True)
def kronecker_steps(dof, out):
    """Compute the steps of Roberts' R sequence, a low-discrepancy sequence from which the RRT-Connect kernel
    takes its samples.

    The steps are powers of the root of 1/x^(d+1) = 1/x + 1. u + k * step modulo 1 is as even as Halton's
    points, at the cost of an addition.
    """
    x = 2.0
    for _ in range(40):
        x = (1.0 + x) ** (1.0 / (dof + 1))
    value = 1.0
    for j in range(dof):
        value /= x
        out[j] = value


class Query(NamedTuple):
    """Parameters of an RRT-Connect search, bundled as one argument of the compiled kernel.

    Attributes:
        start: (dof,). goals: (g, dof).
        lower, upper: (dof,), bounds of the samples.
        shift: (dof,) in [0, 1), start of the sample sequence (the seed).
        reach: longest edge [rad].
        step: distance between validity checks [rad].
    """

    start: Any
    goals: Any
    lower: Any
    upper: Any
    shift: Any
    reach: float
    step: float


class Samples(NamedTuple):
    """Sequence of uniform samples for RRT-Connect or PRM, bundled as one argument of the kernels; see
    `next_sample`.

    Attributes:
        lower, upper: bounds of the samples. steps: see `kronecker_steps`. last: the last sample in [0, 1).
    """

    lower: Any
    upper: Any
    steps: Any
    last: Any


class Ends(NamedTuple):
    """Start and goals of an RRT-Connect search, bundled as one argument of the compiled search.

    Attributes:
        start: pointer to the start. goals: pointer to the goals, one after the other. count: number of goals.
    """

    start: Any
    goals: Any
    count: int


@inner_njit
def next_sample(s, dof, q, at):
    """Draw the next sample in the kernel of RRT-Connect or PRM, and write it to q[at:]."""
    for j in range(dof):
        u = s.last[j] + s.steps[j]
        s.last[j] = u - 1.0 if u >= 1.0 else u
        q[at + j] = s.lower[j] + (s.upper[j] - s.lower[j]) * s.last[j]


@inner_njit
def next_sample_near(s, ends, goal, width, dof, q, at):
    """Draw the next sample of RRT-Connect from the box around the start and goal number `goal`, widened by
    `width` on each side and clipped to the bounds, and write it to q[at:].
    """
    next_sample(s, dof, q, at)
    for j in range(dof):
        a, b = ends.start[j], ends.goals[goal * dof + j]
        low, high = max(s.lower[j], min(a, b) - width), min(s.upper[j], max(a, b) + width)
        q[at + j] = low + (high - low) * s.last[j]


@inner_njit
def begin_search(t, query, dof, space, found):
    """Begin the search in the RRT-Connect kernel: make the start the root of tree 0 and the goals the roots
    of tree 1, and initialize the scratch array `space`.

    `space` holds the steps of the low-discrepancy sample sequence, the last sample, and the distance of the
    closest approach between the trees.
    """
    add(t, 0, pointer(query.start), 0, -1, UNLIMITED)
    for g in range(len(query.goals)):
        add(t, t.capacity + g, pointer(query.goals), g * dof, -1 - g, UNLIMITED)
    found[NODES_0], found[NODES_1], found[TURN] = 1, len(query.goals), 1
    remove_nodes(t)
    kronecker_steps(dof, space)
    space[dof : 2 * dof] = query.shift
    space[2 * dof] = np.inf


@inner_njit
def write_path(t, query, dof, found, row, path):
    """Write the waypoints of the path that the RRT-Connect kernel found to the array `path` (m, dof), and
    return their number. The first and last waypoints are the exact start and goal.

    `row` is scratch memory of dof numbers.
    """
    count, goal = trace(t, found[FROM], found[TO], dof, row, pointer(path), len(path))
    if count > 0:
        path[0] = query.start
        path[count - 1] = query.goals[goal]
    return count


@inner_njit
def _search(k, t, s, ends, edge, closest, reach, step, stop, max_iterations, found):
    """Run the compiled search of RRT-Connect on raw pointers. Tree 0 grows from the start, tree 1 from the
    goals.
    """
    dof = ints(k)[DOF]
    q = 2 * dof  # edge: its two ends, then the sample
    n0, n1, tree = found[NODES_0], found[NODES_1], found[TURN]
    apart = 0.0
    for j in range(dof):
        apart += (s.upper[j] - s.lower[j]) ** 2 / 6
    domain = DOMAIN * np.sqrt(apart)
    for iteration in range(found[ITERATIONS] + 1, found[ITERATIONS] + max_iterations + 1):
        if stop[0] != 0 or n0 + 64 > t.capacity or n1 + 64 > t.capacity:
            break
        found[ITERATIONS], found[NODES], found[NODES_0], found[NODES_1] = iteration, n0 + n1, n0, n1
        tree, mine, other = next_tree(tree, n0, n1)
        found[TURN] = tree
        first, first_other = tree * t.capacity, (1 - tree) * t.capacity
        width = NEAR * (1.0 + iteration / GROWTH)
        next_sample_near(s, ends, iteration % ends.count, width, dof, edge, q)
        i = nearest_node(t, tree, mine, edge, q)
        get(t.nodes, dof, first + i, edge, 0)
        distance = 0.0
        for j in range(dof):
            distance += (edge[q + j] - edge[j]) ** 2
        distance, radius = np.sqrt(distance), t.radii[first + i]
        if distance > radius:
            continue
        # Where long edges failed, every other edge is half as long: short edges leave narrow passages.
        longest = reach if radius == UNLIMITED or iteration % 2 == 0 else 0.5 * reach
        f = min(1.0, longest / max(distance, 1e-9))
        for j in range(dof):
            edge[dof + j] = edge[j] + f * (edge[q + j] - edge[j])
        if not edge_free(k, edge, 0, dof, step):
            t.radii[first + i] = domain
            continue
        add(t, first + mine, edge, dof, i, UNLIMITED)
        mine += 1
        # Continue toward the nearest node of the other tree, as far as the motion is free.
        near = nearest_node(t, 1 - tree, other, edge, dof)
        get(t.nodes, dof, first_other + near, edge, q)
        distance = 0.0
        for j in range(dof):
            edge[j] = edge[dof + j]
            edge[q + j] -= edge[j]
            distance += edge[q + j] ** 2
        count = max(int(np.ceil(np.sqrt(distance) / reach)), 1)
        reached = True
        for c in range(count):
            for j in range(dof):
                edge[dof + j] = edge[j] + edge[q + j] / count
            if stop[0] != 0 or not edge_free(k, edge, 0, dof, step):
                reached = False
                left = np.sqrt(distance) * (count - c) / count
                if left < closest[0]:
                    closest[0] = left
                    for j in range(dof):
                        closest[1 + j] = edge[j]
                        closest[1 + dof + j] = edge[j] + edge[q + j] * (count - c) / count
                break
            if c < count - 1:
                add(t, first + mine, edge, dof, mine - 1, UNLIMITED)
                mine += 1
            for j in range(dof):
                edge[j] = edge[dof + j]
        n0, n1 = (mine, other) if tree == 0 else (other, mine)
        if reached:
            found[FROM], found[TO] = (mine - 1, near) if tree == 0 else (near, mine - 1)
            return True
    found[NODES_0], found[NODES_1] = n0, n1
    return False


@njit(cache=True, nogil=True)
def rrt_connect(handle, query, trees, space, found, stop, max_iterations, path):
    """Search by RRT-Connect for a path from the start to one of the goals, and write its waypoints to the
    array `path` (m, dof). The search runs in a compiled kernel.

    Args:
        query: see `Query`. trees: see `tree.new_trees`.
        space: float64 scratch, see `space_size`. found: int64, see FOUND. Both keep the search between
            calls: the search restarts if found[ITERATIONS] is 0 and continues otherwise.
        stop: stop[0] != 0 ends the search at once; set by another thread.
        max_iterations: of this call.
    Returns:
        Number of waypoints (0: none found), iterations and nodes of all calls.
    """
    dof, t, x = len(query.start), tree_pointers(trees), pointer(space)
    if found[ITERATIONS] == 0:
        begin_search(t, query, dof, space[3 * dof :], found)
    samples = Samples(
        pointer(query.lower), pointer(query.upper), pointer(space[3 * dof :]), pointer(space[4 * dof :])
    )
    ends = Ends(pointer(query.start), pointer(query.goals), len(query.goals))
    if not _search(
        pointer(handle), t, samples, ends, x, pointer(space[5 * dof :]), query.reach, query.step,
        pointer(stop), max_iterations, pointer(found),
    ):  # fmt: skip
        return 0, found[ITERATIONS], found[NODES]
    return write_path(t, query, dof, found, x, path), found[ITERATIONS], found[NODES]
