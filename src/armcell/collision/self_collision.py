"""Search for the link pairs whose collisions can be disabled (SRDF collision matrix), by samples and proofs.

Sampling alone reports "never in contact" for a pair that touches once in a million states. Pairs with
few joints between them are therefore proven apart (`kernel.near_groups`). For the other pairs, samples
in which the links are near are start states of a local search for contact.

`_check_arrays` of the kernel stops checking a lane at its first contact. The `PairSampler` checks every
pair separately, 16 configurations at a time: it changes a few numbers at the head of the pack, so that
the check sees only that pair.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.collision.coarse_shapes import with_visual_shapes
from armcell.collision.exact_checker import ExactChecker
from armcell.collision.kernel.block import EVERY, EXACT, PROVE, STILL, check_block, handle_of, ints, lanes_of
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.pack import GAP_GRID, GAP_TABLE, NEAR, PAIR, PAIRS
from armcell.collision.kernel.simd import L, pointer
from armcell.collision.kernel.workspace import workspace
from armcell.kinematics import KinematicTree, kinematic_tree
from armcell.model import RobotModel
from armcell.scene import PlanningScene

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.


F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Masks = NDArray[np.uint16]

CHUNK = 4096  # samples between two calls of `progress`
Array = NDArray[np.float64]
Progress = Callable[[int], None]
NEAR_DISTANCE = 0.03  # [m] samples with a smaller distance may be start states of the search for contact
NEARER = (0.01, 0.003, 0.001)  # [m] the search starts in the samples of the smallest distance first
COMPARED = 4096  # near samples of a pair that are compared by distance
RARE = 2000  # with more contact samples of the (larger) kernel solids, the meshes certainly touch, too
ALWAYS_SAMPLES = 2000  # samples in which the meshes must touch before a pair counts as always in contact
FIRST = 16384  # samples of all pairs; further samples are only for pairs that touch in few of these
OFTEN = 0.02  # fraction of contact samples above which more samples cannot change the result
MOSTLY = 0.95
"""Fraction of contact samples from which MoveIt treats a pair as always in collision. A pair that touches in
this many states, but not in all, indicates faulty meshes; checking the pair would leave hardly any
collision-free state."""


@njit(cache=True, nogil=True)
def _ask_pairs(handle, pairs, q, masks):
    """Test pairs of robot links for self-collision at sampled configurations. Set one bit in `masks` (pairs,
    blocks) for each configuration in which a pair is close.

    A block has 16 rows of q.
    """
    k = pointer(handle)
    I, w = ints(k), lanes_of(k)
    first_pair, first_near, first_table, first_grid = I[PAIR], I[NEAR], I[GAP_TABLE], I[GAP_GRID]
    dof = q.shape[1]
    I[PAIRS] = np.int32(1)
    for block in range(masks.shape[1]):
        for lane in range(L):
            row = min(block * L + lane, len(q) - 1)
            for j in range(dof):
                w[j * L + lane] = np.float32(q[row, j])
        # A proof over an interval of zero width checks the configuration itself, and continues to the end for
        # every lane.
        mode = np.int64(EXACT | PROVE)
        for p in range(len(pairs)):
            I[PAIR] = np.int32(first_pair + 2 * pairs[p])
            I[NEAR] = np.int32(first_near + pairs[p])
            I[GAP_TABLE] = np.int32(first_table + 5 * pairs[p])
            I[GAP_GRID] = np.int32(first_grid + 6 * pairs[p])
            masks[p, block] = np.uint16(check_block(k, EVERY, mode))
            mode |= np.int64(STILL)
    I[PAIR], I[NEAR] = np.int32(first_pair), np.int32(first_near)
    I[GAP_TABLE], I[GAP_GRID] = np.int32(first_table), np.int32(first_grid)


class PairSampler:
    """Sampler that finds the self-collisions of each pair of links in a very large number of configurations.

    Pairs that `near` proved apart are left out.

    Attributes:
        pairs: (k, 2) names of the bodies that may meet.
    """

    def __init__(self, checker: KernelChecker):
        I, F, D = checker.flat
        self._flat = (I.copy(), F, D)  # other checkers read the original
        self._work = workspace(self._flat)
        self._slack = np.zeros(max(len(checker.pack.frame), 1), np.float32)
        self._slack_pair = np.zeros(max(len(checker.pack.pairs), 1), np.float32)
        self._handle = handle_of((*self._flat, *self._work, self._slack, self._slack_pair))
        self._count = len(checker.pack.pairs)
        names = checker.names.bodies
        self.pairs = [(names[i], names[j]) for i, j in checker.pack.pairs]

    def contact_masks(
        self, numbers: I64, q: F64, within: float = 0.0, progress: Callable[[int], None] | None = None
    ) -> NDArray[np.bool_]:
        """Return for each given pair of links the sampled configurations in which the pair is in
        self-collision, as a boolean mask (pairs, samples).

        Args:
            numbers: indices in `pairs`.
            q: configurations (samples, dof) of all joints.
            within: [m] largest distance that counts as contact.
            progress: receives the number of finished samples.
        """
        self._slack[:] = self._slack_pair[:] = within  # the bodies' slack decides which pairs are skipped
        numbers = np.ascontiguousarray(numbers, dtype=np.int64)
        found = np.zeros((len(numbers), len(q)), bool)
        for start in range(0, len(q), CHUNK):
            part = np.ascontiguousarray(q[start : start + CHUNK], dtype=float)
            masks = np.zeros((len(numbers), -(-len(part) // L)), np.uint16)
            if len(numbers):
                _ask_pairs(self._handle, numbers, part, masks)
            bits = np.unpackbits(masks.view(np.uint8), axis=1, bitorder="little")
            found[:, start : start + len(part)] = bits[:, : len(part)]
            if progress:
                progress(min(start + CHUNK, len(q)))
        return found


STARTS, STEPS = 6, 120  # start states of the search per pair, and steps per start state
MORE = 48  # start states, as long as the search comes closer than CLOSE, and closer with every STARTS states
HINDERING = 0.3  # fraction of contact samples from which the visual meshes decide whether neighbors touch
NEIGHBORS = 2  # most joints between neighbors
PARALLEL = 0.999  # least cosine between the axes of a telescope's joints
CLOSE, CLOSER = 0.002, 0.95  # [m]; share of the last smallest distance


@dataclass(frozen=True)
class LinkPair:
    """Pair of links in the self-collision matrix, with its sampled contacts.
    If its check is disabled, the reason is given.

    `reason` has the SRDF's values: "Adjacent" (joined by a joint); "Always" and "Never" (in contact in all or
    none of the samples); "Default" (in contact in the default state, in a named state of the gripper that
    contains both links, or in nearly all samples). It is empty if the pair must be checked. It
    is also "Never" if only coarse collision shapes touch (`pairs_of_coarse_shapes`).
    """

    link_a: str
    link_b: str
    reason: str
    touching: int  # samples in contact
    samples: int  # a pair that touches often has fewer samples
    proven: bool = False  # whether the absence of contact is proven for all states, not only for the samples

    @property
    def share(self) -> float:
        """Return the fraction of the samples in which a pair of links is in self-collision."""
        return self.touching / self.samples

    @property
    def links(self) -> frozenset[str]:
        return frozenset((self.link_a, self.link_b))


def link_pairs(
    model: RobotModel, samples: int = 100_000, seed: int = 0, progress: Progress | None = None
) -> list[LinkPair]:
    """Return every pair of links that have collision geometry, in model order, for the self-collision matrix.

    Args:
        model: its default state and the named states of its end effectors determine the reason "Default".
            Pairs that the model already disables are evaluated like all others.
        samples: number of states, uniformly distributed within the joint limits.
        seed: seed of the random states.
        progress: callback that receives the number of finished samples.
    """
    pairs = _Survey(model, samples, seed).pairs(progress)
    often = [p.links for p in pairs if p.reason in ("", "Default") and p.share >= HINDERING]
    coarse = pairs_of_coarse_shapes(model, often, samples, seed)
    return [replace(pair, reason="Never") if pair.links in coarse else pair for pair in pairs]


def pairs_of_coarse_shapes(
    model: RobotModel, often: Iterable[frozenset[str]], samples: int = 10_000, seed: int = 0
) -> set[frozenset[str]]:
    """Return the link pairs that are in self-collision only because their collision shapes are coarse: the
    shapes touch, but the visual meshes of the links never do.

    Only neighbors can be among them: with more joints between two links, no sampled state may show that their
    meshes touch.

    Args:
        often: link pairs whose collision shapes touch in many states.
        samples: number of states, uniformly distributed within the joint limits.
        seed: seed of the random states.
    """
    tree = kinematic_tree(model)
    near = {pair for pair in often if len(_joints_between(tree, *pair)) <= NEIGHBORS}
    shown = with_visual_shapes(model, {link for pair in near for link in pair})
    near = {pair for pair in near if all(shown.links[link].collisions for link in pair)}
    if not near:
        return set()
    found = _Survey(shown, samples, seed).pairs(None)
    apart = ("Never", "Adjacent")  # two neighbors are adjacent if the link between them has no shapes now
    return {p.links for p in found if p.links in near and p.reason in apart and not p.touching}


def disabled_collision_pairs(
    model: RobotModel, samples: int = 10_000, seed: int = 0, progress: Progress | None = None
) -> dict[frozenset[str], str]:
    """Return the link pairs whose self-collision check can be disabled, each with the reason.

    The reasons are "Adjacent", "Default", "Always", and "Never". `link_pairs` also returns the sample counts.

    Args:
        samples: number of random states.
        seed: seed of the random states.
        progress: callback that receives the number of finished samples.
    """
    return {pair.links: pair.reason for pair in link_pairs(model, samples, seed, progress) if pair.reason}


def adjacent_links(model: RobotModel) -> set[frozenset[str]]:
    """Return the pairs of adjacent links, for the self-collision matrix: a joint, or a chain of joints
    through links without geometry, connects them. The stages of a telescope, which slide inside each other,
    are adjacent as well.
    """
    adjacent, solid_parent = set(), {}
    for joint in model.joints.values():
        parent = joint.parent
        if not model.links[parent].collisions and parent in solid_parent:
            parent = solid_parent[parent]
        solid_parent[joint.child] = parent
        if model.links[joint.child].collisions and model.links[parent].collisions:
            adjacent.add(frozenset((parent, joint.child)))
    solid = {name for name, link in model.links.items() if link.collisions}
    for a, b in _nested_stages(model):
        adjacent.update(frozenset((p, q)) for p in a & solid for q in b & solid)
    return adjacent


def _nested_stages(model: RobotModel) -> list[tuple[frozenset[str], frozenset[str]]]:
    """Return the pairs of stages that belong to the same telescope: a chain of two or more sliding joints
    with parallel axes. A stage is the set of its rigidly connected links.
    """
    T = {name: kinematic_tree(model).link_pose(model.neutral(), name) for name in model.links}
    stages = {link: frozenset(links) for links in model.rigid_groups for link in links}
    below: dict[frozenset[str], tuple[frozenset[str], Array]] = {}  # stage -> stage in which it slides, axis
    for joint in model.joints.values():
        if joint.type == "prismatic":
            axis = T[joint.child].rotation.matrix @ np.asarray(joint.axis, dtype=float)
            below[stages[joint.child]] = stages[joint.parent], axis / np.linalg.norm(axis)
    pairs = []
    for stage, (lower, axis) in below.items():
        inside = [lower]
        while lower in below and abs(below[lower][1] @ axis) > PARALLEL:
            lower = below[lower][0]
            inside.append(lower)
        if len(inside) > 1:
            pairs += [(stage, other) for other in inside]
            pairs += [(a, b) for i, a in enumerate(inside) for b in inside[i + 1 :]]
    return pairs


def random_states(model: RobotModel, count: int, rng: np.random.Generator) -> Array:
    """Sample random robot states (count, dof) uniformly within the joint limits,
    to find links that collide with each other.

    Joints without limits take values from -pi to pi.
    """
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    high = np.where(np.isfinite(model.upper), model.upper, np.pi)
    return rng.uniform(low, high, (count, model.dof))


class _Survey:
    def __init__(self, model: RobotModel, samples: int, seed: int):
        self.model, self.samples = model, samples
        self.rng = np.random.default_rng(seed)
        self.scene = PlanningScene.of(replace(model, disabled_collisions={}))
        self.exact = ExactChecker(self.scene)
        self.states = random_states(model, samples, self.rng)
        self.solids: dict[str, list[int]] = {}  # link -> its geometries in the exact checker
        for i, geometry in enumerate(self.exact.geometries):
            self.solids.setdefault(geometry.body, []).append(i)
        rigid = {link: i for i, links in enumerate(model.rigid_groups) for link in links}
        self.adjacent = adjacent_links(model)
        self.rigid = lambda a, b: rigid[a] == rigid[b]

    def pairs(self, progress: Progress | None) -> list[LinkPair]:
        bodies = [link.name for link in self.model.links.values() if link.collisions]
        every = [(a, b) for i, a in enumerate(bodies) for b in bodies[i + 1 :]]
        touching, unproven = self._count(progress)
        default = self._default(every)
        found = []
        for a, b in every:
            pair = frozenset((a, b))
            proven = pair not in unproven
            count, samples = touching.get(pair, (0, self.samples))
            if self.rigid(a, b):
                self.exact.set_configuration(self.model.neutral())
                count = samples if self._distance(a, b) <= 0 else 0
            if pair in self.adjacent:
                reason = "Adjacent"
            elif count == samples:
                reason = "Always"
            elif pair in default or count >= MOSTLY * samples:
                reason = "Default"
            elif count == 0 and (proven or not self._can_meet(a, b, unproven[pair])):
                reason = "Never"
            else:
                reason = ""
            found.append(LinkPair(a, b, reason, count, samples, proven))
        return found

    def _count(
        self, progress: Progress | None
    ) -> tuple[dict[frozenset[str], tuple[int, int]], dict[frozenset, Array]]:
        """Count the samples in which each link pair is in self-collision. For pairs that never collide, also
        collect the sampled states in which the two links are close.

        Returns:
            Number of contact samples and of all samples by pair, and start states (k, dof) of the search for
            contact by pair, nearest first; the second result leaves out pairs that are proven apart.
        """
        if self.model.dof == 0:
            return {}, {}
        sampler = PairSampler(KernelChecker(self.scene))
        if not sampler.pairs:
            return {}, {}
        numbers, names = np.arange(len(sampler.pairs)), [frozenset(pair) for pair in sampler.pairs]
        first = self.states[:FIRST]
        close = list(sampler.contact_masks(numbers, first, progress=progress))
        # More samples of adjacent links cannot change their reason.
        searched = np.array([name not in self.adjacent for name in names], dtype=bool)
        rare = np.array([rows.mean() <= OFTEN for rows in close], dtype=bool)
        further = numbers[searched & rare]
        tell = progress and (lambda done: progress(len(first) + done))
        for n, rows in zip(
            further, sampler.contact_masks(further, self.states[FIRST:], progress=tell), strict=True
        ):
            close[n] = np.concatenate([close[n], rows])
        counts = np.array([rows.sum() for rows in close], dtype=int)
        for n in numbers[searched].tolist():
            a, b = sampler.pairs[n]
            # The kernel's solids are slightly larger than the meshes, so the meshes decide.
            states = self.states[np.flatnonzero(close[n])]
            if 0 < counts[n] <= RARE and not any(self._touch(a, b, q) for q in states):
                counts[n] = 0
            elif counts[n] == len(close[n]):
                counts[n] -= not all(self._touch(a, b, q) for q in states[:ALWAYS_SAMPLES])
        unproven = dict.fromkeys(names, np.zeros((0, self.model.dof)))
        for n, near in self._near(sampler, numbers[searched & (counts == 0)]).items():
            unproven[names[n]] = self.states[self._nearest(sampler, n, near)]
        return {names[n]: (int(counts[n]), len(close[n])) for n in numbers}, unproven

    def _near(self, sampler: PairSampler, pairs: I64) -> dict[int, I64]:
        """Find sampled states in which the links of each given pair are nearer than `NEAR_DISTANCE`: at most
        the first `COMPARED` states, as indices in `states`. A pair is given as an index in the sampler's
        pairs.
        """
        near: dict[int, I64] = {n: np.zeros(0, np.int64) for n in pairs.tolist()}
        for start in range(0, len(self.states), FIRST):
            pairs = np.array([n for n in near if len(near[n]) < COMPARED], dtype=np.int64)
            masks = sampler.contact_masks(pairs, self.states[start : start + FIRST], NEAR_DISTANCE)
            for n, rows in zip(pairs.tolist(), masks, strict=True):
                near[n] = np.append(near[n], start + np.flatnonzero(rows))[:COMPARED]
        return near

    def _nearest(self, sampler: PairSampler, pair: int, near: I64) -> list[int]:
        """Return the start states of the search for a self-collision of a link pair, as indices in `states`,
        nearest first.

        Args:
            pair: index in the sampler's pairs.
            near: (k,) indices of the states in which the links are nearer than `NEAR_DISTANCE`.
        """
        levels = [near]
        for within in NEARER:
            if len(levels[-1]) > 1:
                rows = sampler.contact_masks(np.array([pair]), self.states[levels[-1]], within)[0]
                levels.append(levels[-1][rows])
        nearest = dict.fromkeys(i for level in reversed(levels) for i in level[:MORE].tolist())
        return list(nearest)[:MORE]

    def _default(self, every: Iterable[tuple[str, str]]) -> set[frozenset[str]]:
        """Return the link pairs that are in self-collision in the default state or in a named state of a
        single gripper.
        """
        model = self.model
        q = model.default_positions()
        found = {frozenset((c.body_a, c.body_b)) for c in self.exact.contacts(q)}
        for group in self._hands():
            links = set(model.groups[group].link_names)
            for state in model.named_states.get(group, {}):
                at = self.scene.with_state(model.named_state(group, state)).positions
                self.exact.set_configuration(at)
                found |= {
                    frozenset((a, b))
                    for a, b in every
                    if a in links and b in links and not self.rigid(a, b) and self._distance(a, b) <= 0
                }
        return found

    def _hands(self) -> set[str]:
        """Return the names of the groups that count as grippers in the search for link pairs whose
        self-collision check can be disabled.

        These are the groups of end effectors, and the groups that share no joint with a group that has a tip
        link.
        """
        model = self.model
        hands = {e.group for e in model.end_effectors.values()}
        driven = {n for g in model.groups.values() if g.tip_link for n in g.joint_names}
        return hands | {g.name for g in model.groups.values() if not driven & set(g.joint_names)}

    # --- on the meshes themselves ---
    def _distance(self, a: str, b: str) -> float:
        """Return the signed distance [m] between two links at the robot state
        that is set in the checker, to find self-collisions.
        """
        return min(self.exact.pair_distance(i, j) for i in self.solids[a] for j in self.solids[b])

    def _distance_below(self, a: str, b: str, most: float) -> float:
        """Return the signed distance [m] between two links if it is less than `most`, else `most`, to search
        for self-collisions. Cheap bounds avoid many distance computations between meshes.
        """
        pairs = self._solid_pairs(a, b)
        for i, j in pairs[self.exact.pair_gaps(pairs) < most].tolist():
            if self.exact.pair_distance(i, j, outer=True) < most:
                most = min(most, self.exact.pair_distance(i, j, below=most))
        return most

    def _touch(self, a: str, b: str, q: Array) -> bool:
        self.exact.set_configuration(q)
        pairs = self._solid_pairs(a, b)
        near = pairs[self.exact.pair_gaps(pairs) <= 0]
        return any(self.exact.pair_touches(i, j) for i, j in near.tolist())

    def _solid_pairs(self, a: str, b: str) -> NDArray[np.int64]:
        return np.array([(i, j) for i in self.solids[a] for j in self.solids[b]])

    def _can_meet(self, a: str, b: str, starts: Array) -> bool:
        """Search for a state in which two links are in self-collision, by a random local search.

        Args:
            starts: (k, dof) states in which the search starts.
        Returns:
            True if the search finds a contact.
        """
        columns = _joints_between(self.exact.tree, a, b)
        low, high = self.model.lower[columns], self.model.upper[columns]
        least = before = np.inf
        for number, start in enumerate(starts):
            if number and number % STARTS == 0:
                if least > min(CLOSE, CLOSER * before):
                    return False
                before = least
            q, step = start.copy(), 0.2
            self.exact.set_configuration(q)
            best = self._distance(a, b)
            for _ in range(STEPS):
                trial = q.copy()
                move = self.rng.normal(size=len(columns)) * (self.rng.random(len(columns)) < 0.6)
                trial[columns] = np.clip(q[columns] + step * move, low, high)
                self.exact.set_configuration(trial)
                distance = self._distance_below(a, b, best)
                if distance <= 0:
                    return True
                if distance < best:
                    q, best, step = trial, distance, min(step * 1.5, 0.5)
                else:
                    step = max(step * 0.85, 1e-3)
            least = min(least, best)
        return False


def _joints_between(tree: KinematicTree, a: str, b: str) -> list[int]:
    """Return the indices of the joints that move one link relative to another, to search for self-collisions
    of the two links.
    """
    apart = set(tree.path_to(a).tolist()) ^ set(tree.path_to(b).tolist())
    return sorted({int(tree.column[j]) for j in apart if tree.kind[j] != 0})
