"""RRT-Connect on a constraint manifold: the planner projects every step (Numba).

After CBiRRT2 (Berenson, Srinivasa and Kuffner, IJRR 2011). Samples are projected too (as in the projected
state space of Kingston, Moll and Kavraki, IJRR 2019), so that extensions head for reachable configurations.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from armcell.collision.kernel.block import EXACT, PADDED, check_block, ints, lanes_of
from armcell.collision.kernel.motion import edge_free
from armcell.collision.kernel.pack import DOF as DOF_OF_PACK
from armcell.collision.kernel.simd import L, pointer
from armcell.planning.constraints.error_kernels import (
    DOF,
    MAX_ROWS,
    WORK,
    manifold_pointers,
    within_tolerances,
)
from armcell.planning.constraints.projection import project
from armcell.planning.constraints.proof import edge_keeps_tolerances
from armcell.planning.planners.native.nearest_neighbors import nearest_node
from armcell.planning.planners.native.rrt_connect import (
    FROM,
    ITERATIONS,
    NODES,
    NODES_0,
    NODES_1,
    TO,
    TURN,
    UNLIMITED,
    Samples,
    begin_search,
    next_sample,
    write_path,
)
from armcell.planning.planners.native.tree import add, get, next_tree, tree_pointers

ROWS = 64  # rows of one walk
STALL = 0.1  # smallest progress of a step, as a share of its length


def space_size(dof: int) -> int:
    """Compute the size, in doubles, of the scratch memory that RRT-Connect with constraints needs.

    Layout: [two ends and steps], [sample steps], [sample], [closest approach], [zeros].
    """
    return (ROWS + 2) * dof + 5 * dof + 1


def closest_at(dof: int) -> int:
    """Return the index in scratch memory at which constrained RRT-Connect stores the smallest distance
    between its two trees.

    The closest approach is a length [rad], then its two ends.
    """
    return (ROWS + 4) * dof


class Steps(NamedTuple):
    """Parameters of the steps that constrained RRT-Connect takes on the constraint manifold. Its compiled
    kernels take them as one argument.

    Attributes:
        lower, upper: pointers to the joint limits (dof,). zeros: pointer to dof zeros.
        delta: length of a step [rad]. step: distance between validity checks [rad].
        allowance: [rad and m] added to the tolerances.
        projecting: if False, the walk ends at a step with a sample outside the tolerances (rejection).
    """

    lower: Any
    upper: Any
    zeros: Any
    delta: float
    step: float
    allowance: float
    projecting: bool


@njit(cache=True)
def _apart(p, a, b, dof):
    total = 0.0
    for j in range(dof):
        total += (p[b + j] - p[a + j]) ** 2
    return np.sqrt(total)


@njit(cache=True)
def _sampled(n, c, x, p, a, b, step):
    """Sample joint positions along an edge of RRT-Connect, from p[a:] to p[b:]. Return whether all samples
    are within the constraint tolerances.
    """
    dof = n[DOF]
    count = max(int(np.ceil(_apart(p, a, b, dof) / step)), 1)
    at = n[WORK] + 32 + MAX_ROWS * (dof + 2) + MAX_ROWS * MAX_ROWS
    for i in range(1, count + 1):
        for j in range(dof):
            x[at + j] = p[a + j] + i / count * (p[b + j] - p[a + j])
        if not within_tolerances(n, c, x, x, at, False):
            return False
    return True


@njit(cache=True)
def _clear(k, p, a, out, first, end, step):
    """Check consecutive steps of RRT-Connect on the constraint manifold for collisions. Return the number of
    collision-free steps before the first contact.

    Step e leads from row e - 1 to row e of the walk, for e from `first` to `end` - 1; row -1 is p[a:]. Short
    steps share one block of samples.
    """
    I, w, edges = ints(k), lanes_of(k), end - first
    dof = I[DOF_OF_PACK]
    if edges > 1:
        each, lane = L // edges, 0
        for e in range(first, end):
            row = out + e * dof
            before = a if e == 0 else row - dof
            for i in range(1, each + 1):
                for j in range(dof):
                    w[j * L + lane] = np.float32(p[before + j] + i / each * (p[row + j] - p[before + j]))
                lane += 1
        if check_block(k, (np.int64(1) << lane) - 1, np.int64(EXACT | PADDED)) == 0:
            return edges
    for e in range(first, end):
        row = out + e * dof
        if not edge_free(k, p, a if e == 0 else row - dof, row, step):
            return e - first
    return edges


@njit(cache=True)
def walk(k, n, c, x, p, a, to, out, most, rules, stop):
    """Extend an RRT-Connect tree in steps from the joint positions p[a:] toward p[to:]. Each step is
    projected onto the constraints, and the extension ends at the first step in collision.

    Args:
        out: where the rows are written in p. most: maximal number of rows, at least one less than the buffer
            holds. rules: see `Steps`.
    Returns:
        Number of rows written, and whether the last row is p[to:].
    """
    delta, step, projecting = rules.delta, rules.step, rules.projecting
    dof, count, clear, at = n[DOF], 0, 0, a
    left, arrived, going = _apart(p, a, to, n[DOF]), False, True
    together = min(max(int(L * step / delta), 1), L)
    while going:
        row = out + count * dof
        going = False
        if left <= delta:
            arrived = (
                edge_keeps_tolerances(n, c, x, p, at, to, rules.zeros, rules.allowance)
                if projecting
                else _sampled(n, c, x, p, at, to, step)
            )
            if arrived:
                for j in range(dof):
                    p[row + j] = p[to + j]
                count += 1
        if (
            not arrived
            and count < most
            and stop[0] == 0
            and (left > delta or (projecting and left > 0.1 * delta))
        ):
            f = min(delta / left, 0.5 if projecting else 1.0)
            for j in range(dof):
                p[row + j] = p[at + j] + f * (p[to + j] - p[at + j])
            if projecting:
                if project(n, c, x, p, row, rules.lower, rules.upper):
                    near = _apart(p, row, to, dof)
                    going = (
                        _apart(p, at, row, dof) <= 2.0 * delta
                        and near <= left - STALL * f * left
                        and edge_keeps_tolerances(n, c, x, p, at, row, rules.zeros, rules.allowance)
                    )
                    left = near
            else:
                left -= f * left
                going = _sampled(n, c, x, p, at, row, step)
            if going:
                at = row
                count += 1
        if count - clear >= together or not going:
            free = _clear(k, p, a, out, clear, count, step)
            if free < count - clear:
                return clear + free, False
            clear = count
    return count, arrived


@njit(cache=True)
def _search(k, n, c, x, t, samples, closest, p, reach, rules, stop, max_iterations, found):
    """Run the search loop of RRT-Connect under path constraints, in compiled code.

    The arguments are pointers to arrays. The trees have the memory layout of `native.rrt_connect`.
    """
    dof = n[DOF]
    q, out = dof, 2 * dof
    n0, n1, tree = found[NODES_0], found[NODES_1], found[TURN]
    for iteration in range(found[ITERATIONS] + 1, found[ITERATIONS] + max_iterations + 1):
        if stop[0] != 0 or n0 + 4 * ROWS > t.capacity or n1 + 4 * ROWS > t.capacity:
            break
        found[ITERATIONS], found[NODES], found[NODES_0], found[NODES_1] = iteration, n0 + n1, n0, n1
        next_sample(samples, dof, p, q)
        if rules.projecting:
            if not project(n, c, x, p, q, rules.lower, rules.upper):
                continue
        elif not within_tolerances(n, c, x, p, q, False):
            continue
        tree, mine, other = next_tree(tree, n0, n1)
        found[TURN] = tree
        first, first_other = tree * t.capacity, (1 - tree) * t.capacity
        i = nearest_node(t, tree, mine, p, q)
        get(t.nodes, dof, first + i, p, 0)
        most = min(int(np.ceil(reach / rules.delta)), ROWS - 1)
        count, _ = walk(k, n, c, x, p, 0, q, out, most, rules, stop)
        if count == 0:
            continue
        near, reached = 0, False  # reaching a sample is not reaching the other tree
        while True:
            for row in range(count - 1 if reached else count):  # the last row belongs to the other tree
                add(t, first + mine, p, out + row * dof, i, UNLIMITED)
                i = mine
                mine += 1
            if count > 0:
                for j in range(dof):
                    p[j] = p[out + (count - 1) * dof + j]
            if reached or mine + 2 * ROWS > t.capacity:
                break
            if near > 0 and count < ROWS - 1:  # the walk toward the other tree has ended
                left = _apart(p, 0, q, dof)
                if left < closest[0]:
                    closest[0] = left
                    for j in range(2 * dof):
                        closest[1 + j] = p[j]
                break
            # Continue toward the nearest node of the other tree.
            to = nearest_node(t, 1 - tree, other, p, 0)
            near = 1 + to
            get(t.nodes, dof, first_other + to, p, q)
            count, reached = walk(k, n, c, x, p, 0, q, out, ROWS - 1, rules, stop)
        n0, n1 = (mine, other) if tree == 0 else (other, mine)
        if reached:
            found[FROM], found[TO] = (i, near - 1) if tree == 0 else (near - 1, i)
            return True
    found[NODES_0], found[NODES_1] = n0, n1
    return False


@njit(cache=True, nogil=True)
def constrained_rrt_connect(
    handle, constraints, query, delta, allowance, projecting, trees, space, found, stop, max_iterations, path
):  # fmt: skip
    """Search by RRT-Connect for a path under constraints from the start to one of the goals, and write its
    waypoints (m, dof) to `path`.

    See `rrt_connect`.

    Args:
        constraints: handle of the manifold. delta, allowance, projecting: see `Steps`.
        space: see `space_size`.
    Returns:
        Number of waypoints (0: none found), iterations and nodes of all calls.
    """
    dof, t, p = len(query.start), tree_pointers(trees), pointer(space)
    n, c, x = manifold_pointers(constraints)
    at = (ROWS + 2) * dof
    if found[ITERATIONS] == 0:
        begin_search(t, query, dof, space[at:], found)
    lower, upper = pointer(query.lower), pointer(query.upper)
    samples = Samples(lower, upper, pointer(space[at:]), pointer(space[at + dof :]))
    zeros = pointer(space[at + 4 * dof + 1 :])
    rules = Steps(lower, upper, zeros, delta, query.step, allowance, projecting)
    closest = pointer(space[at + 2 * dof :])
    if not _search(
        pointer(handle), n, c, x, t, samples, closest, p, query.reach, rules, pointer(stop), max_iterations,
        pointer(found),
    ):  # fmt: skip
        return 0, found[ITERATIONS], found[NODES]
    return write_path(t, query, dof, found, p, path), found[ITERATIONS], found[NODES]
