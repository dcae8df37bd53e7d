"""RRT-Connect kernel (Kuffner and LaValle, ICRA 2000) with a dynamic domain.

Design choices follow VAMP (Thomason, Kingston and Kavraki, ICRA 2024).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.block import ints
from armcell.collision.kernel.layout import DOF
from armcell.collision.kernel.motion import edge_free
from armcell.collision.kernel.simd import pointer
from armcell.planning.planners.native.nearest_neighbors import nearest_node, reset_leaves
from armcell.planning.planners.native.tree import get, put, trace

# Radius of a node's domain after its first failure, and its minimum, as shares of the typical distance of
# two random configurations (4 and 1 rad for a Panda).
DOMAIN = 0.75
DOMAIN_MIN = 0.19
DOMAIN_STEP = 1e-4
UNLIMITED = 1e9

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
    """Compute the steps of Roberts' R sequence, a low-discrepancy sequence from which RRT-Connect takes its
    samples.

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


@inner_njit
def _search(k, lower, upper, steps, sample, edge, closest, reach, step,
            nodes, parents, radii, leaves, leaf_ints, capacity, room, stop, max_iterations,
            found):  # fmt: skip
    """Run the compiled search of RRT-Connect on raw pointers.

    Tree 0 grows from the start, tree 1 from the goals. Node i of tree t is node t * capacity + i.
    """
    dof = ints(k)[DOF]
    q = 2 * dof  # edge: its two ends, then the sample
    n0, n1, tree = found[NODES_0], found[NODES_1], found[TURN]
    apart = 0.0
    for j in range(dof):
        apart += (upper[j] - lower[j]) ** 2 / 6
    domain, domain_min = DOMAIN * np.sqrt(apart), DOMAIN_MIN * np.sqrt(apart)
    for iteration in range(found[ITERATIONS] + 1, found[ITERATIONS] + max_iterations + 1):
        if stop[0] != 0 or n0 + 64 > capacity or n1 + 64 > capacity:
            break
        found[ITERATIONS], found[NODES], found[NODES_0], found[NODES_1] = iteration, n0 + n1, n0, n1
        mine, other = (n1, n0) if tree == 1 else (n0, n1)
        if abs(mine - other) < mine:  # take turns, unless the other tree is twice as large
            tree = 1 - tree
            mine, other = other, mine
        found[TURN] = tree
        first, first_other = tree * capacity, (1 - tree) * capacity
        for j in range(dof):
            u = sample[j] + steps[j]
            sample[j] = u - 1.0 if u >= 1.0 else u
            edge[q + j] = lower[j] + (upper[j] - lower[j]) * sample[j]
        i = nearest_node(nodes, parents, leaves, leaf_ints, dof, capacity, tree, mine, edge, q, room)
        get(nodes, dof, first + i, edge, 0)
        distance = 0.0
        for j in range(dof):
            distance += (edge[q + j] - edge[j]) ** 2
        distance, radius = np.sqrt(distance), radii[first + i]
        if distance > radius:
            continue
        # Where long edges failed, every other edge is half as long: short edges leave narrow passages.
        longest = reach if radius == UNLIMITED or iteration % 2 == 0 else 0.5 * reach
        f = min(1.0, longest / max(distance, 1e-9))
        for j in range(dof):
            edge[dof + j] = edge[j] + f * (edge[q + j] - edge[j])
        if not edge_free(k, edge, 0, dof, step):
            shrunk = max(radius * (1 - DOMAIN_STEP), domain_min)
            radii[first + i] = domain if radius == UNLIMITED else shrunk
            continue
        if radius != UNLIMITED:
            radii[first + i] = radius * (1 + DOMAIN_STEP)
        put(nodes, dof, first + mine, edge, dof)
        parents[first + mine], radii[first + mine] = i, UNLIMITED
        mine += 1
        # Continue toward the nearest node of the other tree, as far as the motion is free.
        near = nearest_node(
            nodes, parents, leaves, leaf_ints, dof, capacity, 1 - tree, other, edge, dof, room
        )
        get(nodes, dof, first_other + near, edge, q)
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
                put(nodes, dof, first + mine, edge, dof)
                parents[first + mine], radii[first + mine] = mine - 1, UNLIMITED
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
def rrt_connect(
    handle,
    start,
    goals,
    lower,
    upper,
    shift,
    reach,
    step,
    nodes,
    parents,
    radii,
    leaves,
    leaf_ints,
    room,
    space,
    found,
    stop,
    max_iterations,
    path,
):
    """Search by RRT-Connect, in a compiled kernel, for a path from the start to one of the goals, and write
    its waypoints (m, dof).

    Args:
        goals: (g, dof). shift: (dof,) in [0, 1), start of the sample sequence (the seed).
        reach: longest edge [rad]. step: distance between validity checks [rad].
        nodes, parents, radii: memory of both trees (see tree.new_trees). leaves, leaf_ints: see
            nearest_neighbors.new_leaves. room: float32 scratch.
        space: float64 scratch, see `space_size`. found: int64, see FOUND. Both keep the search between
            calls: the search restarts if found[ITERATIONS] is 0 and continues otherwise.
        stop: stop[0] != 0 ends the search at once; set by another thread.
        max_iterations: of this call.
    Returns:
        Number of waypoints (0: none found), iterations and nodes of all calls.
    """
    dof, capacity = len(start), len(parents) // 2
    n, p, c, x = pointer(nodes), pointer(parents), pointer(radii), pointer(space)
    if found[ITERATIONS] == 0:
        put(n, dof, 0, pointer(start), 0)
        parents[0], radii[0] = -1, UNLIMITED
        for g in range(len(goals)):
            put(n, dof, capacity + g, pointer(goals), g * dof)
            parents[capacity + g], radii[capacity + g] = -1 - g, UNLIMITED
        found[NODES_0], found[NODES_1], found[TURN] = 1, len(goals), 1
        reset_leaves(pointer(leaf_ints), capacity)
        kronecker_steps(dof, space[3 * dof :])
        space[4 * dof : 5 * dof] = shift
        space[5 * dof] = np.inf
    if not _search(
        pointer(handle), pointer(lower), pointer(upper), pointer(space[3 * dof :]),
        pointer(space[4 * dof :]), x, pointer(space[5 * dof :]), reach, step, n, p, c, pointer(leaves),
        pointer(leaf_ints), capacity, pointer(room), pointer(stop), max_iterations, pointer(found),
    ):  # fmt: skip
        return 0, found[ITERATIONS], found[NODES]
    count, goal = trace(n, p, dof, capacity, found[FROM], found[TO], dof, x, pointer(path), len(path))
    if count > 0:  # the trees are float32; restore the exact ends
        path[0] = start
        path[count - 1] = goals[goal]
    return count, found[ITERATIONS], found[NODES]
