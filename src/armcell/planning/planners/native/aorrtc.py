"""AORRTC kernel: RRT-Connect over configurations and costs, below a cost bound.

Wilson, Thomason, Kingston, Kavraki and Gammell, "AORRTC: Almost-surely asymptotically optimal planning with
RRT-Connect" (2025), after Hauser and Zhou's AO-x ("Asymptotically optimal planning by feasible kinodynamic
planning in a state-cost space", T-RO 2016). A node is a configuration with its cost to come; nearest-node
queries use both. A node through which no path below the bound can go is never added. The caller simplifies
each path found; the length of this path is the bound of the next search (see planners/aorrtc.py).

Samples come from the configurations that a path below the bound can pass (Gammell, Srinivasa and Barfoot,
"Informed RRT*", IROS 2014). Cost is path length [rad].
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
from armcell.planning.planners.native.rrt_connect import FROM, ITERATIONS, NODES, TO
from armcell.planning.planners.native.tree import add, get, remove_nodes, trace, tree_pointers

TRIES = 8  # attempts in the box, then in the ellipsoid, to sample a point of a cheaper path
PARENTS = 3  # other parents tried for a new node
PARTNERS = 3  # nodes tried, at ever lower costs, to find one with a path below the bound
SHORTER, SHORTEST = 0.7, 0.05  # factor by which a node's longest edge shrinks on failure, and its minimum
GAIN = 1e-3  # [rad] smallest cost reduction for another parent of a node


class Improvement(NamedTuple):
    """Parameters of an AORRTC search for a path that is shorter than a bound, bundled as one argument of the
    kernels.

    The fields hold arrays in Python and pointers within the kernels.

    Attributes:
        roots: (1 + g, dof), start and goals. goals: g.
        lower, upper: (dof,), bounds of the samples.
        bound: [rad]. reach: longest edge of the trees [rad]. step: distance between validity checks [rad].
        random: uint64 (1,), the generator's state.
    """

    roots: Any
    goals: int
    lower: Any
    upper: Any
    bound: float
    reach: float
    step: float
    random: Any


@inner_njit(forceinline=True)
def uniform(random):
    """Return a random number in [0, 1) for the AORRTC kernel; random[0] holds the state of the generator.

    The generator is splitmix64 (Steele, Lea and Flood 2014).
    """
    z = random[0] + np.uint64(0x9E3779B97F4A7C15)
    random[0] = z
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@inner_njit
def _apart(a, i, b, k, dof):
    total = 0.0
    for j in range(dof):
        total += (a[i + j] - b[k + j]) ** 2
    return np.sqrt(total)


@inner_njit
def _to_go(roots, dof, first, last, q, at):
    """Return, in the AORRTC kernel, the distance from configuration q[at:] to the nearest root of a search
    tree. It is an estimate of the remaining cost.
    """
    least = 1e300
    for r in range(first, last):
        least = min(least, _apart(roots, r * dof, q, at, dof))
    return least


@inner_njit
def _in_ellipsoid(ask, dof, goal, q, at, axis):
    """Sample uniformly, in the AORRTC kernel, from the ellipsoid that contains all paths cheaper than the
    cost bound.
    """
    roots, bound, random = ask.roots, ask.bound, ask.random
    length = _apart(roots, 0, roots, goal * dof, dof)
    norm = 0.0
    for j in range(0, dof, 2):  # a direction from normal deviates (Box and Muller)
        r, angle = np.sqrt(-2.0 * np.log(1.0 - uniform(random))), 2 * np.pi * uniform(random)
        q[at + j] = r * np.cos(angle)
        norm += q[at + j] ** 2
        if j + 1 < dof:
            q[at + j + 1] = r * np.sin(angle)
            norm += q[at + j + 1] ** 2
    scale = uniform(random) ** (1.0 / dof) / np.sqrt(norm)
    across = 0.5 * np.sqrt(max(bound * bound - length * length, 0.0))
    dot = square = 0.0
    for j in range(dof):  # mirrored so that the first axis is along start - goal
        q[at + j] *= scale * (0.5 * bound if j == 0 else across)
        axis[j] = (roots[goal * dof + j] - roots[j]) / max(length, 1e-12) - (1.0 if j == 0 else 0.0)
        dot += axis[j] * q[at + j]
        square += axis[j] * axis[j]
    for j in range(dof):
        if square > 1e-12:
            q[at + j] -= 2.0 * dot / square * axis[j]
        q[at + j] += 0.5 * (roots[j] + roots[goal * dof + j])


@inner_njit
def _sample(ask, dof, q, at, axis):
    """Sample a configuration in the AORRTC kernel that lies on some path cheaper than the cost bound, and
    write it to q[at:].

    Return False if no sample was found.
    """
    roots, goals, lower, upper = ask.roots, ask.goals, ask.lower, ask.upper
    for k in range(2 * TRIES):
        if k < TRIES:
            for j in range(dof):
                q[at + j] = lower[j] + (upper[j] - lower[j]) * uniform(ask.random)
        else:
            _in_ellipsoid(ask, dof, 1 + int(uniform(ask.random) * goals), q, at, axis)
        inside = True
        for j in range(dof):
            inside = inside and lower[j] <= q[at + j] <= upper[j]
        if inside and _to_go(roots, dof, 0, 1, q, at) + _to_go(roots, dof, 1, 1 + goals, q, at) < ask.bound:
            return True
    return False


@inner_njit
def _search(k, ask, t, edge, axis, stop, max_iterations, found):
    """Run the compiled search of AORRTC on raw pointers.

    Nodes have dof + 1 coordinates; the last coordinate is the cost from their root.
    """
    roots, goals, bound, reach, random = ask.roots, ask.goals, ask.bound, ask.reach, ask.random
    dof = ints(k)[DOF]
    dims = dof + 1
    b, q = dims, 2 * dims  # in edge: its two ends, the sample; each with its cost
    n0, n1, tree = 1, goals, 1
    for iteration in range(1, max_iterations + 1):
        if stop[0] != 0 or n0 + 64 > t.capacity or n1 + 64 > t.capacity:
            break
        found[ITERATIONS], found[NODES] = iteration, n0 + n1
        tree = 1 - tree  # alternate: below a tight bound one of the trees may hardly grow at all
        mine, other = (n1, n0) if tree == 1 else (n0, n1)
        first, first_other = tree * t.capacity, (1 - tree) * t.capacity
        if not _sample(ask, dof, edge, q, axis):
            continue
        mine_a, mine_b = (0, 1) if tree == 0 else (1, 1 + goals)  # the roots of this tree, of the other one
        other_a, other_b = (1, 1 + goals) if tree == 0 else (0, 1)
        least = _to_go(roots, dof, mine_a, mine_b, edge, q)
        most = bound - _to_go(roots, dof, other_a, other_b, edge, q)
        i, cost, longest = -1, 0.0, 0.0
        for _ in range(PARTNERS):
            most = least + (most - least) * uniform(random)
            edge[q + dof] = most
            i = nearest_node(t, tree, mine, edge, q)
            get(t.nodes, dims, first + i, edge, 0)
            distance, longest = _apart(edge, 0, edge, q, dof), t.radii[first + i]
            f = min(1.0, longest / max(distance, 1e-9))  # learned: near obstacles most long edges fail
            for j in range(dof):
                edge[b + j] = edge[j] + f * (edge[q + j] - edge[j])
            cost = edge[dof] + f * distance
            if cost + _to_go(roots, dof, other_a, other_b, edge, b) < bound:
                break
            i = -1
        if i < 0:
            continue
        if not edge_free(k, edge, 0, b, ask.step):
            t.radii[first + i] = max(SHORTER * longest, SHORTEST * reach)
            continue
        t.radii[first + i] = min(longest / SHORTER, reach)
        # Another parent that makes the node cheaper: near in configuration, at a lower random cost.
        least = _to_go(roots, dof, mine_a, mine_b, edge, b)
        for _ in range(PARENTS):
            edge[b + dof] = least + (cost - least) * uniform(random)
            near = nearest_node(t, tree, mine, edge, b)
            if near == i:
                continue
            get(t.nodes, dims, first + near, edge, 0)
            cheaper = edge[dof] + _apart(edge, 0, edge, b, dof)
            if cheaper < cost - GAIN and edge_free(k, edge, 0, b, ask.step):
                i, cost = near, cheaper
        edge[b + dof] = cost
        add(t, first + mine, edge, b, i, longest)
        mine += 1
        n0, n1 = (mine, other) if tree == 0 else (other, mine)
        # Continue to a node of the other tree with which the path stays below the bound.
        least, most, near = _to_go(roots, dof, other_a, other_b, edge, b), bound - cost, -1
        distance = 0.0
        for _ in range(PARTNERS):
            most = least + (most - least) * uniform(random)
            edge[b + dof] = most
            near = nearest_node(t, 1 - tree, other, edge, b)
            get(t.nodes, dims, first_other + near, edge, q)
            distance = _apart(edge, b, edge, q, dof)
            if cost + distance + edge[q + dof] < bound:
                break
            near = -1
        if near < 0:
            continue
        count = max(int(np.ceil(distance / reach)), 1)
        reached = True
        for j in range(dof):
            edge[j] = edge[b + j]
            edge[q + j] -= edge[j]
        for c in range(count):
            for j in range(dof):
                edge[b + j] = edge[j] + edge[q + j] / count
            if stop[0] != 0 or not edge_free(k, edge, 0, b, ask.step):
                reached = False
                break
            if c < count - 1:
                edge[b + dof] = cost + distance * (c + 1) / count
                add(t, first + mine, edge, b, mine - 1, reach)
                mine += 1
            for j in range(dof):
                edge[j] = edge[b + j]
        n0, n1 = (mine, other) if tree == 0 else (other, mine)
        if reached:
            found[FROM], found[TO] = (mine - 1, near) if tree == 0 else (near, mine - 1)
            return True
    return False


@njit(cache=True, nogil=True)
def aorrtc(handle, ask, trees, space, found, stop, max_iterations, path):
    """Search by AORRTC, in a compiled kernel, for a path that is shorter than a bound, and write its
    waypoints (m, dof).

    Args:
        ask: see `Improvement`. trees: trees with dof + 1 coordinates (see `tree.new_trees`).
        space: float64 scratch, 4 (dof + 1). found: int64 scratch, see rrt_connect.FOUND.
        stop: see rrt_connect.
    Returns:
        Number of waypoints (0: none found), iterations, nodes.
    """
    dof, t, x = len(ask.lower), tree_pointers(trees), pointer(space)
    found[:] = 0
    for g in range(ask.goals + 1):
        for j in range(dof):
            space[j] = ask.roots[g, j]
        space[dof] = 0.0
        add(t, 0 if g == 0 else t.capacity + g - 1, x, 0, -1 if g == 0 else -g, ask.reach)
    remove_nodes(t)
    pointers = Improvement(
        pointer(ask.roots), ask.goals, pointer(ask.lower), pointer(ask.upper), ask.bound, ask.reach, ask.step,
        pointer(ask.random),
    )  # fmt: skip
    if not _search(
        pointer(handle), pointers, t, x, pointer(space[3 * (dof + 1) :]), pointer(stop), max_iterations,
        pointer(found),
    ):  # fmt: skip
        return 0, found[ITERATIONS], found[NODES]
    count, goal = trace(t, found[FROM], found[TO], dof, x, pointer(path), len(path))
    if count > 0:
        path[0] = ask.roots[0]
        path[count - 1] = ask.roots[1 + goal]
    return count, found[ITERATIONS], found[NODES]
