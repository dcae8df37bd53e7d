"""Generator of named states: home and ready for arms, open and close for grippers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from armcell.collision import ExactChecker
from armcell.collision.self_collision import HINDERING, adjacent_links, pairs_of_coarse_shapes
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

TRIED = 400  # random states from which home and ready are selected
FLAW = 0.95  # pairs in contact in this share of the states are mesh flaws and do not count
ROOM = 0.01  # [m] desired self-clearance: a UR's wrist passes its forearm at 15 to 19 mm
TURN = np.pi / 2  # [rad] largest offset of "ready" from the middle of a joint's range


def with_poses(model: RobotModel, seed: int = 0) -> RobotModel:
    """Return the robot model with generated poses as named states: open, close, home and ready.

    Home is the first candidate with enough self-clearance, else the candidate with the largest. Candidates:
    the zero state, the middle of the joint ranges, the zero state with one or two joints turned by a quarter
    turn, and random states, nearest to the middle first. Ready is bent: of random states near the middle of
    the ranges, with open grippers, the one with the highest manipulability and enough self-clearance, else
    home.
    """
    states = {group: dict(named) for group, named in model.named_states.items()}
    hands = _hands(model)
    for group in hands:
        states.setdefault(group, {}).update(_open_and_close(model, group))
    model = replace(model, named_states=states)
    arms = [g for g in model.groups.values() if g.joint_names and g.name not in hands]
    if not arms:
        return model
    poses = _home_and_ready(model, {n for g in arms for n in g.joint_names}, seed)
    for group in arms:
        columns = model.columns(group.joint_names)
        named = states.setdefault(group.name, {})
        for name, q in poses.items():
            named[name] = {n: round(float(q[c]), 6) for n, c in zip(group.joint_names, columns, strict=True)}
    return replace(model, named_states=states)


def _hands(model: RobotModel) -> list[str]:
    """Return the gripper groups that have joints. For these groups, `armcell setup` generates the poses
    "open" and "close".
    """
    hands = {e.group for e in model.end_effectors.values()}
    chains = any(g.tip_link for g in model.groups.values())
    return [g.name for g in model.groups.values() if g.joint_names and (g.name in hands or not chains)]


def _checker(model: RobotModel) -> ExactChecker:
    bare = replace(model, disabled_collisions=dict.fromkeys(adjacent_links(model), "Adjacent"))
    return ExactChecker(PlanningScene.of(bare))


def _open_and_close(model: RobotModel, group: str) -> dict[str, dict[str, float]]:
    """Generate the poses "open" and "close" of a gripper for `armcell setup`: those of a detected gripper, or
    opposite ends of the joints' ranges.

    Of the two ends, open is the one with the larger mean gap between the moving links. The result is empty if
    a joint of an undetected gripper has no limits.
    """
    names = model.groups[group].joint_names
    limits = [model.joints[n].limits for n in names]
    ends = [np.array([v.lower for v in limits]), np.array([v.upper for v in limits])]
    inside = np.ceil(ends[0] * 1e6) / 1e6, np.floor(ends[1] * 1e6) / 1e6  # six decimals within the limits
    known = next((g for g in model.grippers.values() if g.group == group and len(names) == 1), None)
    if known is not None:
        at = {"open": known.joint_position(known.max_width), "close": known.joint_position(0.0)}
        # Jaws that cannot close completely stop at their joint's limit.
        return {state: {names[0]: float(np.clip(round(q, 6), *inside)[0])} for state, q in at.items()}
    checker = _checker(model)
    moving = [n for n in model.groups[group].link_names if _moves(model, n, names)]
    solids = {n: [i for i, g in enumerate(checker.geometries) if g.body == n] for n in model.links}
    others = moving if len(moving) > 1 else list(model.groups[group].link_names)
    rigid = {link: i for i, links in enumerate(model.rigid_groups) for link in links}
    if not all(np.all(np.isfinite(end)) for end in ends):
        return {}  # a continuous joint has no end positions
    spread = []
    for end in ends:
        q = model.neutral()
        q[model.columns(names)] = end
        checker.set_configuration(q)
        gaps = [
            checker.pair_distance(i, j)
            for a in moving for b in others if rigid[a] != rigid[b]
            for i in solids[a] for j in solids[b]
        ]  # fmt: skip
        # Meshes may touch somewhere at both ends, so compare the mean gap between the fingers.
        spread.append((min(gaps, default=0.0), float(np.mean(gaps)) if gaps else 0.0))
    wide = ends[1] if spread[1][1] >= spread[0][1] else ends[0]
    narrow = ends[0] if wide is ends[1] else ends[1]
    return {
        state: {n: float(v) for n, v in zip(names, np.clip(end.round(6), *inside), strict=True)}
        for state, end in (("open", wide), ("close", narrow))
    }


def _moves(model: RobotModel, link: str, names: tuple[str, ...]) -> bool:
    """Return whether a link moves with any of the gripper joints for which `armcell setup` generates poses,
    or with a joint that mimics one of them.
    """
    tree = kinematic_tree(model)
    columns = set(model.columns(names))
    return any(int(tree.column[j]) in columns and tree.kind[j] != 0 for j in tree.path_to(link))


def _home_and_ready(model: RobotModel, joints: set[str], seed: int) -> dict[str, Array]:
    rng = np.random.default_rng(seed)
    columns = model.columns([n for n in model.joint_names if n in joints])
    rest = model.default_positions()  # grippers open
    # Limit ranges to one turn, so that the home of a joint with two turns is near its middle.
    low, high = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    middle = (low + high) / 2
    half = np.minimum((high - low) / 2, TURN)

    def drawn(low: Array, high: Array) -> Array:
        samples = np.tile(rest, (TRIED, 1))
        samples[:, columns] = rng.uniform(low, high, (TRIED, model.dof))[:, columns]
        return samples

    wide, bent = drawn(low, high), drawn(middle - half, middle + half)
    judge = _Judge(model, wide)
    zero, center = rest.copy(), rest.copy()
    zero[columns], center[columns] = model.neutral()[columns], middle[columns]
    simple = [zero, center, *_quarter_turns(zero, columns, low, high)]
    near_middle = sorted(
        (q for q in np.vstack([bent, wide]) if judge.is_free(q)),
        key=lambda q: float(np.sum((q - middle)[columns] ** 2)),
    )
    best, home = -np.inf, zero
    for q in (*simple, *near_middle):
        room = judge.room(q)
        if room > best:
            best, home = room, q
        if room >= ROOM:
            break
    tips = [g for g in model.groups.values() if g.tip_link and set(g.joint_names) <= joints]
    able = sorted((q for q in bent if judge.is_free(q)), key=lambda q: -_dexterity(model, q, tips))
    ready = next((q for q in able if judge.room(q) >= ROOM), home)
    return {"home": np.clip(home.round(4), low, high), "ready": np.clip(ready.round(2), low, high)}


def _quarter_turns(zero: Array, columns: list[int], low: Array, high: Array) -> Iterator[Array]:
    """Yield candidates for the home pose that `armcell setup` generates. In each, one or two joints are
    turned by a quarter turn from the zero state.
    """
    for count in (1, 2):
        for some in combinations(columns, count):
            for turns in product((-np.pi / 2, np.pi / 2), repeat=count):
                q = zero.copy()
                q[list(some)] += turns
                if np.all(q >= low) and np.all(q <= high):
                    yield q


class _Judge:
    """Evaluator for joint positions that may become a named pose of a robot. It checks whether they are
    collision-free and measures the distance between the closest links.
    """

    def __init__(self, model: RobotModel, samples: Array):
        checker = _checker(model)
        counts: Counter[frozenset[str]] = Counter()
        for q in samples:
            counts.update(checker.touching(q))
        # Contact in nearly all states is a mesh flaw and no reason to reject a state, as is contact of coarse
        # shapes only. Pairs that never touch do not count as clearance: they may always be close.
        flaws = {pair for pair, n in counts.items() if n >= FLAW * len(samples)}
        often = {pair for pair, n in counts.items() if n >= HINDERING * len(samples)}
        flaws |= pairs_of_coarse_shapes(model, often - flaws)
        self.checker = self._ignoring(checker, flaws)
        bodies = [n for n, link in model.links.items() if link.collisions]
        every = {frozenset((a, b)) for i, a in enumerate(bodies) for b in bodies[:i]}
        self.measured = self._ignoring(checker, [*flaws, *(every - set(counts))])

    @staticmethod
    def _ignoring(checker: ExactChecker, pairs: Iterable[frozenset[str]]) -> ExactChecker:
        disabled = {**checker.model.disabled_collisions, **dict.fromkeys(pairs, "")}
        return ExactChecker(PlanningScene.of(replace(checker.model, disabled_collisions=disabled)))

    def is_free(self, q: Array) -> bool:
        return self.checker.is_free(q)

    def room(self, q: Array) -> float:
        """Return the distance [m] between the closest two links in a candidate for a named pose that `armcell
        setup` generates. It is negative if links are in contact.

        Only pairs that can touch count. Distances above 1 m are not measured.
        """
        if not self.is_free(q):
            return -1.0
        near = self.measured.nearest(q, cutoff=1.0)
        return 1.0 if near is None else near.distance


def _dexterity(model: RobotModel, q: Array, groups: list) -> float:
    """Return the smallest manipulability sqrt(det(J J^T)) among several planning groups at the configuration
    q, a candidate for the pose "ready" that `armcell setup` generates.
    """
    tree = kinematic_tree(model)
    values = [1.0]
    for group in groups:
        singular = np.linalg.svd(tree.jacobian(q, group.tip_link, group.joint_names), compute_uv=False)
        values.append(float(np.prod(singular)))
    return min(values)
