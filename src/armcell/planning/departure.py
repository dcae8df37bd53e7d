"""Out of contact: from a start that touches to a free configuration, by a motion that the rule of
`collision.resting` proves.

Pairs in contact are pushed apart along the directions in which their distances grow, all at once, by least
squares over the group's joints, with as little turning of the bodies as possible. Where that leads nowhere, a
free state near the start is looked for by samples.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.exact import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting import RESTING, TOUCH, Pair, certify_from_rest, resting_pairs, touching
from armcell.core import Contact, ErrorCode, Outcome
from armcell.planning.constraints.description import Manifold
from armcell.planning.constraints.views import manifold_of
from armcell.planning.constraints.warm_up import warm_up_constraints
from armcell.planning.placed import positioned
from armcell.planning.problem import INDUSTRIAL, normalized_pipeline_id
from armcell.planning.question import Question

Array = NDArray[np.float64]

DISTANCES = (8e-3, 4e-3, 2e-3)  # [m] to which pairs in contact are taken apart: the first that is possible
PUSH = 1e-3  # [m] by which they are taken apart in one step
PUSHES = 40
DIFFERENCE = 1e-4  # [rad or m] of a joint, for how a distance changes with it
TURN = 0.1  # [m] by which a turn of a body counts as a motion of it
ASIDE = 0.2  # of what is missing to `CLEARANCE`, by which pairs that do not touch are moved apart in a step
DAMPING = 0.02  # [m/rad] of the least squares
LARGEST = 0.02  # [rad or m] of a joint in one step
STUCK = 1e-5  # [rad or m] a step that is smaller leads nowhere

REPAIR_RADII = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3)  # [rad or m] in which a free start is looked for
REPAIR_SAMPLES = 200  # in each
HALVINGS = 12  # that bring the free start nearer
CLEARANCE = 2e-3  # [m] beyond the padding that a sampled start keeps from objects


@dataclass(frozen=True, eq=False)
class Departure:
    """Where a start in contact (n,) can be left to.

    Attributes:
        points: (k, n) from the start to a free configuration.
        contacts: at the start.
        blocked: what the way there would touch or press into; None: the way is proven.
    """

    points: Array
    contacts: list[Contact]
    proven: bool = True
    blocked: Contact | None = None


def departure(
    checker: KernelChecker,
    start: Array,
    seed: int = 0,
    deepest: float = RESTING,
    keeps: Callable[[Array], bool] = lambda points: True,
) -> Departure | None:
    """The way out of contact at a start (n,), or None where no free configuration is near.

    Args:
        deepest: [m] of a contact that may be left.
        keeps: whether a way (k, n) keeps to what else is asked of the motion.
    """
    contacts = touching(checker, start)
    blocked: Contact | None = None
    for distance in DISTANCES:
        points = _pushed(checker, start, distance)
        if points is None:
            continue
        for way in (np.vstack([points[0], points[-1]]), points):
            proof = certify_from_rest(checker, way, deepest=deepest)
            if proof.free and keeps(way):
                return Departure(way, contacts)
            blocked = blocked or proof.contact
    roomy = KernelChecker(checker.scene.with_padding(checker.scene.padding + CLEARANCE), checker.joint_names)
    free = _nearest_free(roomy, start, np.random.default_rng(seed))
    if free is None:
        return None
    way = np.vstack([start, free])
    proof = certify_from_rest(checker, way, deepest=deepest)
    return Departure(way, contacts, proof.free and keeps(way), proof.contact or blocked)


def departed(question: Question, checker: KernelChecker) -> Question | Outcome:
    """The question from where its start in resting contact is left to, the way there as its `lead_in`; or why
    it cannot be left. `start_repaired` in the evidence says how far that is."""
    start = question.scene.positions[checker.columns]
    contacts = touching(checker, start)
    if (refusal := too_deep(contacts)) is not None:
        return refusal
    what = "; ".join(c.describe() for c in contacts[:3])
    found = departure(checker, start, question.request.seed, keeps=_kept(question))
    if found is None or not found.proven:
        return _refused(what, contacts, found)
    return leaving(question, found, begins_at="actual start")


def too_deep(contacts: list[Contact]) -> Outcome | None:
    """Why no motion may begin in contacts, if one of them is deeper than `RESTING`."""
    if all(c.distance >= -RESTING for c in contacts):
        return None
    what = "; ".join(c.describe() for c in contacts[:3])
    text = (
        f"start in collision: {what}; a motion may begin in contact up to {1000 * RESTING:.0f} mm deep: "
        "correct the poses, move what touches, or plan with the adapter 'fix_start_state_collision'"
    )
    return Outcome(ErrorCode.START_STATE_IN_COLLISION, text, {"contacts": contacts})


def _kept(question: Question) -> Callable[[Array], bool]:
    """Whether a way (k, n) keeps to the workspace and the path constraints of a request."""
    request, workspace = question.request, question.workspace
    told = normalized_pipeline_id(request.pipeline_id) == INDUSTRIAL  # its constraints are CIRC's point
    manifold: Manifold | None = None
    if request.path_constraints and not told:
        warm_up_constraints()
        manifold = manifold_of(question.scene, request.group, request.path_constraints)

    def keeps(points: Array) -> bool:
        if workspace is not None and workspace.left_at(points) is not None:
            return False
        if manifold is None or manifold.violations(points[0]):  # a start that violates them is said as such
            return True
        manifold.allow_edges([points[0], points[-1]])
        return not manifold.violations(points[-1]) and manifold.leaves(points) < 0

    return keeps


def leaving(question: Question, found: Departure, begins_at: str) -> Question:
    """The question with the end of a departure as its start."""
    start, free = found.points[0], found.points[-1]
    report = {
        "contacts": found.contacts,
        "from": start.copy(),
        "to": free,
        "distance": float(np.linalg.norm(free - start)),
        "begins_at": begins_at,
    }
    lead = None
    if begins_at == "actual start":
        # A start that was moved within limits before: the motion leads there from where the robot is.
        before = found.points[:0] if question.lead_in is None else question.lead_in[:1]
        lead = np.vstack([before, found.points])
    return replace(
        question,
        scene=positioned(question.scene, question.joint_names, free),
        lead_in=lead,
        evidence={**question.evidence, "start_repaired": report},
    )


def _refused(what: str, contacts: list[Contact], found: Departure | None) -> Outcome:
    evidence = {"contacts": contacts, "no_departure": True}
    if found is None:
        why = f"no free state within {REPAIR_RADII[-1]:g} rad was found"
    elif found.blocked is not None:
        why = f"no way out of this contact was found: on the nearest, {found.blocked.describe()}"
        evidence["blocked_by"] = [found.blocked]
    else:
        why = "the way out of this contact leaves the workspace or the path constraints"
    text = (
        f"start in collision: {what}; {why}. Open the gripper or attach the object if it is held, "
        "or move what touches"
    )
    return Outcome(ErrorCode.START_STATE_IN_COLLISION, text, evidence)


def _pushed(checker: KernelChecker, start: Array, distance: float) -> Array | None:
    """Configurations (k, n) from the start to one where all that touches is a distance [m] apart."""
    exact, model, columns = checker.exact, checker.model, checker.columns
    low = np.minimum(model.lower[columns], start)
    high = np.maximum(model.upper[columns], start)
    apart = set(resting_pairs(exact, start, TOUCH))
    if not apart:
        return None
    q, points = start, [start]
    for _ in range(PUSHES):
        near = resting_pairs(exact, q, distance)
        missing = [distance - c.distance for pair, c in near.items() if pair in apart]
        if max(missing, default=0.0) <= TOUCH and not checker.touches(q):
            return np.array(points)
        step = _push(exact, q, {p: near[p].distance for p in near}, apart, distance)
        new = np.clip(q + step, low, high)
        if np.max(np.abs(new - q), initial=0.0) < STUCK:
            return None
        q = new
        points.append(q)
    return None


def _push(
    exact: ExactChecker, q: Array, near: Mapping[Pair, float], apart: Collection[Pair], distance: float
) -> Array:
    """The joint step (n,) with which pairs that are too near come apart; others do not come nearer."""
    rows, wanted, turning = [], [], []
    bodies = list(near)
    rates = _rates(exact, q, bodies)
    for pair, rate in zip(bodies, rates, strict=True):
        if pair in apart:
            rows.append(rate)
            wanted.append(min(distance - near[pair], PUSH))
            turning.append(_turning(exact, q, pair))
        elif near[pair] < CLEARANCE:
            rows.append(rate)
            wanted.append(ASIDE * (CLEARANCE - near[pair]))
    J = np.vstack([*rows, *(TURN * t for t in turning), DAMPING * np.eye(len(q))])
    b = np.concatenate([wanted, np.zeros(len(J) - len(wanted))])
    step = np.asarray(np.linalg.lstsq(J, b, rcond=None)[0], dtype=np.float64)
    return step * min(1.0, LARGEST / max(float(np.max(np.abs(step))), 1e-12))


def _rates(exact: ExactChecker, q: Array, bodies: Sequence[Pair]) -> Array:
    """How the distance of each pair of bodies changes with each joint: (pairs, n) [m/rad], from both sides.

    Two faces that lie on each other come nearer whichever way one of them turns; what both sides have in
    common is what the pair's normal says.
    """
    rows = {pair: _rows(exact, pair) for pair in bodies}
    rates = np.empty((len(bodies), len(q)))
    for j in range(len(q)):
        ends = []
        for sign in (1.0, -1.0):
            moved = q.copy()
            moved[j] += sign * DIFFERENCE
            exact.place(moved)
            ends.append([min(exact.pair_distance(a, b) for a, b in rows[pair]) for pair in bodies])
        rates[:, j] = (np.array(ends[0]) - np.array(ends[1])) / (2 * DIFFERENCE)
    return rates


def _rows(exact: ExactChecker, pair: Pair) -> list[tuple[int, int]]:
    g = exact.geometries
    return [(int(a), int(b)) for a, b in exact.pairs if {g[a].body, g[b].body} == pair]


def _turning(exact: ExactChecker, q: Array, pair: Pair) -> Array:
    """How the bodies of a pair turn against each other with each joint: (3, n)."""
    a, b = _rows(exact, pair)[0]
    full, names = exact.full(q), exact.joint_names
    turn = np.zeros((3, len(q)))
    for i, sign in ((a, 1.0), (b, -1.0)):
        link = exact.geometries[i].link
        if link >= 0:
            turn += sign * exact.tree.jacobian(full, exact.tree.link_names[link], names)[3:]
    return turn


def _nearest_free(checker: KernelChecker, start: Array, rng: np.random.Generator) -> Array | None:
    """A free state (n,) near the start: the nearest sample of the smallest ball with one, brought nearer."""
    low, high = checker.model.lower[checker.columns], checker.model.upper[checker.columns]
    for radius in REPAIR_RADII:
        steps = rng.normal(size=(REPAIR_SAMPLES, len(start)))
        steps *= (
            radius / np.linalg.norm(steps, axis=1, keepdims=True) * rng.random((REPAIR_SAMPLES, 1)) ** 0.5
        )
        free = [q for q in np.clip(start + steps, low, high) if checker.is_free(q)]
        if free:
            best = min(free, key=lambda q: float(np.linalg.norm(q - start)))
            near, far = 0.0, 1.0  # of the way to `best`
            for _ in range(HALVINGS):
                middle = (near + far) / 2
                if checker.is_free(start + middle * (best - start)):
                    far = middle
                else:
                    near = middle
            return start + far * (best - start)
    return None


__all__ = ["Departure", "departed", "departure", "leaving", "too_deep"]
