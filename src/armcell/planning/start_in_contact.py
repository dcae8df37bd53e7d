"""Leaving contact at the start: motions from a start state in contact to a free state.

The rule of `collision.resting` proves the motion. Least squares over the group's joints pushes all pairs in
contact apart at the same time, along the directions in which their distances grow, with as little rotation
of the bodies as possible. If this fails, random samples search for a free state near the start.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.exact_checker import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import (
    RESTING,
    TOUCH,
    Pair,
    certify_from_rest,
    resting_contacts,
    resting_pairs,
)
from armcell.core import Contact, ErrorCode, Outcome
from armcell.planning.constraints.manifold import ConstraintManifold
from armcell.planning.constraints.plan import warm_up_constraints
from armcell.planning.constraints.visibility_manifold import make_manifold
from armcell.planning.moved_frame import with_joint_positions
from armcell.planning.planners.registry import PILZ, normalized_pipeline_id
from armcell.planning.request import ValidatedRequest

Array = NDArray[np.float64]

DISTANCES = (8e-3, 4e-3, 2e-3)  # [m] target distances of pairs in contact; the first feasible one is used
PUSH = 1e-3  # [m] separation per step
PUSHES = 40
DIFFERENCE = 1e-4  # [rad or m] step of the numeric derivative of a distance by a joint
TURN = 0.1  # [m] weight of a body's rotation relative to its translation
ASIDE = 0.2  # share of the missing clearance that one step restores for pairs not in contact
DAMPING = 0.02  # [m/rad] damping of the least squares
LARGEST = 0.02  # [rad or m] largest joint motion per step
STUCK = 1e-5  # [rad or m] smaller steps end the attempt

REPAIR_RADII = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3)  # [rad or m] radii of the search for a free start
REPAIR_SAMPLES = 200  # samples per radius
HALVINGS = 12  # bisections toward the start
CLEARANCE = 2e-3  # [m] beyond the padding that a sampled start keeps from objects


@dataclass(frozen=True, eq=False)
class Departure:
    """Departure motion, which leads from a start state (n,) in contact to a collision-free state nearby.

    Attributes:
        points: (k, n) from the start to a free state.
        contacts: contacts at the start.
        proven: whether the motion is proven to leave the contact.
        blocked: the contact that prevents the proof, or None.
    """

    points: Array
    contacts: list[Contact]
    proven: bool = True
    blocked: Contact | None = None


def find_departure(
    checker: KernelChecker,
    start: Array,
    seed: int = 0,
    deepest: float = RESTING,
    keeps: Callable[[Array], bool] = lambda points: True,
) -> Departure | None:
    """Find a motion from a start (n,) in contact to a collision-free state nearby. Return None if there is no
    such state.

    Args:
        deepest: depth [m] of the deepest contact that may be left.
        keeps: returns whether a motion (k, n) satisfies the other requirements of the request.
    """
    contacts = resting_contacts(checker, start)
    blocked: Contact | None = None
    for distance in DISTANCES:
        points = _separate_bodies(checker, start, distance)
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


def leave_start_contact(validated: ValidatedRequest, checker: KernelChecker) -> ValidatedRequest | Outcome:
    """Plan a short motion from a start in resting contact to a start without contact, and store it as the
    plan's `lead_in`. Reject the start if no such motion exists.

    `start_repaired` in the evidence reports the distance between the old and the new start.
    """
    start = validated.scene.positions[checker.columns]
    contacts = resting_contacts(checker, start)
    if (refusal := reject_deep_contacts(contacts)) is not None:
        return refusal
    what = "; ".join(c.describe() for c in contacts[:3])
    found = find_departure(checker, start, validated.request.seed, keeps=_kept(validated))
    if found is None or not found.proven:
        return _refused(what, contacts, found)
    return start_from_departure(validated, found, begins_at="actual start")


def reject_deep_contacts(contacts: list[Contact]) -> Outcome | None:
    """Reject a start in deep contact: return the error START_STATE_IN_COLLISION if a contact is deeper than
    `RESTING`, else None.
    """
    if all(c.distance >= -RESTING for c in contacts):
        return None
    what = "; ".join(c.describe() for c in contacts[:3])
    text = (
        f"start in collision: {what}; a motion may begin in contact up to {1000 * RESTING:.0f} mm deep: "
        "correct the poses, move what touches, or plan with the adapter 'fix_start_state_collision'"
    )
    return Outcome(ErrorCode.START_STATE_IN_COLLISION, text, {"contacts": contacts})


def _kept(validated: ValidatedRequest) -> Callable[[Array], bool]:
    """Return a function that checks whether a motion (k, n) out of a start contact stays in the workspace and
    satisfies the path constraints.
    """
    request, workspace = validated.request, validated.workspace
    is_pilz = (
        normalized_pipeline_id(request.pipeline_id) == PILZ
    )  # path constraints define CIRC's auxiliary point
    manifold: ConstraintManifold | None = None
    if request.path_constraints and not is_pilz:
        warm_up_constraints()
        manifold = make_manifold(validated.scene, request.group, request.path_constraints)

    def keeps(points: Array) -> bool:
        if workspace is not None and workspace.first_outside(points) is not None:
            return False
        if manifold is None or manifold.violations(
            points[0]
        ):  # the pipeline reports a start that violates them
            return True
        manifold.relax_boundary([points[0], points[-1]])
        return not manifold.violations(points[-1]) and manifold.first_unproven_edge(points) < 0

    return keeps


def start_from_departure(validated: ValidatedRequest, found: Departure, begins_at: str) -> ValidatedRequest:
    """Let a request start at the end of its departure motion, where the robot has left the contact. Return a
    copy of the request.

    The departure motion leads from the original start, which is in contact, to a collision-free state.

    Args:
        validated: the request.
        found: the departure motion.
        begins_at: where the departure motion begins. "actual start" makes it the plan's lead-in.
    """
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
        # The start may have been moved within limits before: the motion begins at the robot's actual state.
        before = found.points[:0] if validated.lead_in is None else validated.lead_in[:1]
        lead = np.vstack([before, found.points])
    return replace(
        validated,
        scene=with_joint_positions(validated.scene, validated.joint_names, free),
        lead_in=lead,
        evidence={**validated.evidence, "start_repaired": report},
    )


def _refused(what: str, contacts: list[Contact], found: Departure | None) -> Outcome:
    evidence = {"contacts": contacts, "no_departure": True}
    if found is None:
        why = f"no free state within {REPAIR_RADII[-1]:g} rad was found"
    elif found.blocked is not None:
        why = f"no motion out of this contact was found: on the nearest one, {found.blocked.describe()}"
        evidence["blocked_by"] = [found.blocked]
    else:
        why = "the motion out of this contact leaves the workspace or the path constraints"
    text = (
        f"start in collision: {what}; {why}. Open the gripper or attach the object if it is held, "
        "or move what touches"
    )
    return Outcome(ErrorCode.START_STATE_IN_COLLISION, text, evidence)


def _separate_bodies(checker: KernelChecker, start: Array, distance: float) -> Array | None:
    """Compute a motion that separates bodies in contact at the start of a plan, until they are `distance` [m]
    apart.

    Return the configurations (k, n) of this motion, beginning with the start. Return None if no bodies touch
    or if they cannot be separated.
    """
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
    """Compute the joint step (n,) that separates the bodies touching at the
    start without bringing other bodies closer together.
    """
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
    """Compute how the distance of each given pair of bodies, such as bodies in contact at the start, changes
    with each joint at q (n,).

    The result is an array (pairs, n) [m/rad or m/m]. Two flat faces in contact come nearer for either
    direction of rotation; the central difference cancels this effect and leaves the motion along the pair's
    normal.
    """
    rows = {pair: _rows(exact, pair) for pair in bodies}
    rates = np.empty((len(bodies), len(q)))
    for j in range(len(q)):
        ends = []
        for sign in (1.0, -1.0):
            moved = q.copy()
            moved[j] += sign * DIFFERENCE
            exact.set_configuration(moved)
            ends.append([min(exact.pair_distance(a, b) for a, b in rows[pair]) for pair in bodies])
        rates[:, j] = (np.array(ends[0]) - np.array(ends[1])) / (2 * DIFFERENCE)
    return rates


def _rows(exact: ExactChecker, pair: Pair) -> list[tuple[int, int]]:
    g = exact.geometries
    return [(int(a), int(b)) for a, b in exact.pairs if {g[a].body, g[b].body} == pair]


def _turning(exact: ExactChecker, q: Array, pair: Pair) -> Array:
    """Return the Jacobian (3, n) of the relative rotation of two bodies that are in contact at the start of a
    plan.
    """
    a, b = _rows(exact, pair)[0]
    full, names = exact.full(q), exact.joint_names
    turn = np.zeros((3, len(q)))
    for i, sign in ((a, 1.0), (b, -1.0)):
        link = exact.geometries[i].link
        if link >= 0:
            turn += sign * exact.tree.jacobian(full, exact.tree.link_names[link], names)[3:]
    return turn


def _nearest_free(checker: KernelChecker, start: Array, rng: np.random.Generator) -> Array | None:
    """Search by random sampling for a collision-free state (n,) near a start that is in contact.

    Take the nearest free sample in the smallest ball that contains one, then bisect toward the start.
    """
    low, high = checker.model.lower[checker.columns], checker.model.upper[checker.columns]
    for radius in REPAIR_RADII:
        steps = rng.normal(size=(REPAIR_SAMPLES, len(start)))
        steps *= (
            radius / np.linalg.norm(steps, axis=1, keepdims=True) * rng.random((REPAIR_SAMPLES, 1)) ** 0.5
        )
        free = [q for q in np.clip(start + steps, low, high) if checker.is_free(q)]
        if free:
            best = min(free, key=lambda q: float(np.linalg.norm(q - start)))
            near, far = 0.0, 1.0  # shares of the line to `best`
            for _ in range(HALVINGS):
                middle = (near + far) / 2
                if checker.is_free(start + middle * (best - start)):
                    far = middle
                else:
                    near = middle
            return start + far * (best - start)
    return None
