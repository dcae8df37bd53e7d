"""Grasp candidates for a gripper, best first, and reasons for rejected ones.

A generator proposes TCP poses. All proposals pass the same checks, cheap ones first: do the pads meet the
object, is the object narrow enough, is the hand clear of the object and its support
(`hand_fit_kernel`), do the contacts press against each other, is the gripper strong enough. Suction
grippers have their own checks (`suction.py`). Reachability and other obstacles are checked later for each
candidate (`tasks.stages.ChooseGrasp`).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, Box, Capsule, Cylinder, Registry, Sphere
from armcell.grasping import hand_fit_kernel
from armcell.grasping.grasp import (
    APPROACH,
    SAFETY,
    Grasp,
    PadContact,
    Rejection,
    firm_force,
    holding_factor,
    needed_force,
)
from armcell.grasping.hand import POSE_ERROR, Hand
from armcell.grasping.suction import SuctionCandidates, evaluate_suction_grasps, find_seals
from armcell.grasping.surface import Surface, surface_of
from armcell.model import Gripper, SuctionGripper
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

KEPT = 64  # cached sets of fitted candidates
SOFT_PATCH = 1.5e-3  # [m] patch radius that scores half as much as a large patch
EDGE = 1.7  # distance of a patch's edge, in radii of gyration
SLIPS = 3  # number of checks that a grasp passes before the check for slipping
ALIGNED = np.pi / 4  # [rad] angle up to which closing jaws turn a square back to its faces
LEFT = 0.5  # smallest share of a grasp's resistance to peeling that slanted contacts leave
PARTS = 5  # parts of this turn after which the width of the object is compared
FAR_LEVER = 0.04  # [m] lever arm of the weight at which the score is halved
MANY, GOOD = 100, 0.5  # candidates, and score of the best one, that end the sampling of an object's surface
INTOLERANT = 0.2  # share of the score that a grasp loses if a pose error makes the hand touch the object
CONVERGED = 0.02  # gain of the best score by a batch of proposals below which sampling ends


@dataclass
class Proposals:
    """Candidates from a grasp generator, with unique names and tcp poses in the object's frame."""

    names: list[str] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)  # (4, 4)
    covered: float = 1.0  # share of the surface that was tried with these proposals and all before them
    taken: dict[str, int] = field(default_factory=dict)  # number of uses by name

    def add(self, name: str, T_object_tcp: Array) -> None:
        """Add a grasp candidate with a tcp pose (4, 4). A number is appended if its name already exists."""
        count = self.taken[name] = self.taken.get(name, 0) + 1
        self.names.append(name if count == 1 else f"{name} ({count})")
        self.poses.append(T_object_tcp)


Generator = Callable[[CollisionObject, Surface, Hand, Array], Proposals | Iterator[Proposals]]
"""Grasp generator: function (object, its surface, hand, up direction (3,)) -> proposals.

The up direction is in the object's frame. A generator that samples yields its proposals in batches; armcell
takes batches until it has `MANY` candidates and the best score is good or converged.
"""

generators: Registry[Generator] = Registry("grasp generator", "armcell.grasp_generators")


def generator_for(item: CollisionObject, gripper: Gripper | None = None) -> str:
    """Return the default generator of grasp candidates for a gripper and for the kind of geometry that an
    object has.
    """
    if isinstance(gripper, SuctionGripper):
        return "suction"
    if item.has_cloud:
        return "cloud"
    if len(item.shapes) == 1 and isinstance(item.shapes[0][0], Box | Cylinder | Capsule | Sphere):
        return "primitive"
    return "antipodal"


def grasp_candidates(
    item: CollisionObject, hand: Hand, generator: str | None = None, on_support: bool = True,
    pose_error: float = POSE_ERROR,
) -> tuple[list[Grasp], list[Rejection]]:  # fmt: skip
    """Return the grasp candidates for an object, best first, and the rejected ones with reasons.

    Candidates that keep their distance from the object also at a pose error score higher.

    Args:
        generator: generator by name; default: by the object's geometry.
        on_support: the object rests on a support at its lowest point, which the hand must not touch.
        pose_error: [m] distance by which the object's true pose may differ from the believed one.
    Raises:
        UnknownNameError: no such generator.
        InputError: the object has no surface that can be gripped.
    """
    up = item.T_world_object.rotation.matrix[2]  # world z in the object's frame
    name = generator or generator_for(item, hand.gripper)
    fitted = _fitted(item, hand, name, up, on_support, pose_error)
    if isinstance(fitted, SuctionCandidates):
        return evaluate_suction_grasps(item, hand, fitted, up)
    return _judged(item, hand, fitted, up)


def surface_coverage(
    item: CollisionObject, hand: Hand, generator: str | None = None, on_support: bool = True,
    pose_error: float = POSE_ERROR,
) -> float:  # fmt: skip
    """Return the share of an object's surface, from 0 to 1, on which `grasp_candidates` tried grasps."""
    up = item.T_world_object.rotation.matrix[2]
    name = generator or generator_for(item, hand.gripper)
    fitted = _fitted(item, hand, name, up, on_support, pose_error)
    return 1.0 if isinstance(fitted, SuctionCandidates) else fitted.covered


def turned_grasp(item: CollisionObject, hand: Hand, grasp: Grasp, name: str, T_object_tcp: SE3,
                 angle: float, pose_error: float = POSE_ERROR) -> Grasp | Rejection:  # fmt: skip
    """Turn a grasp candidate to another TCP pose, and check whether it still holds the object there.

    The checks are those of `grasp_candidates`. They may shift the pose, for example to center the hand. If
    the pads touch the object only at slanted surfaces, closing jaws turn the object until it is as narrow as
    in the candidate's own pose (Goldberg, "Orienting polygonal parts without sensors", 1993). The grasp then
    holds like the candidate if the angle is at most `ALIGNED` and if the object's width decreases throughout
    the turn. A long box that is gripped near its diagonal turns the other way, to its narrow side.

    Args:
        name: name of the rotated grasp.
        angle: [rad] rotation of the hand from the candidate's own pose.
        pose_error: [m] distance by which the object's true pose may differ from the believed one.
    Returns:
        The grasp at the rotated pose, or the reason why it does not hold.
    """
    up = item.T_world_object.rotation.matrix[2]
    center = hand.gripper.grip_center(grasp.width, grasp.opening)
    proposals = Proposals([name], [(T_object_tcp @ center).matrix])
    fitted = _fit(proposals, surface_of(item), hand, up, True, pose_error)
    if isinstance(fitted, SuctionCandidates):
        found, rejected = evaluate_suction_grasps(item, hand, fitted, up)
        return found[0] if found else rejected[0]
    found, rejected = _judged(item, hand, fitted, up)
    slips = not found and rejected[0].passed == SLIPS and abs(angle) <= ALIGNED
    if not slips or not _narrows(surface_of(item), hand, up, fitted.poses[0], angle):
        return found[0] if found else rejected[0]
    opening = float(fitted.measures[0, 1])
    moved = SE3.from_matrix(fitted.poses[0]) @ hand.gripper.grip_center(grasp.width, opening).inverse()
    score = grasp.score * (1 - abs(angle) / ALIGNED)
    return replace(grasp, name=name, T_object_tcp=moved, opening=opening, score=score)


def _narrows(surface: Surface, hand: Hand, up: Array, pose: Array, angle: float) -> bool:
    """Return whether the width of an object between the pads decreases steadily while the hand turns from a
    rotated pose back to the pose of a grasp candidate.

    Args:
        pose: (4, 4) [m] T_object_tcp of the turned hand, at the center between the pads.
        angle: [rad] turn about the direction `up` (3,) from the candidate's pose.
    """
    back = [SE3(SO3.exp(-share * angle * up), np.zeros(3)).matrix for share in np.linspace(0, 1, PARTS + 1)]
    at = SE3(SO3.identity(), pose[:3, 3]).matrix
    poses = [at @ turn @ np.linalg.inv(at) @ pose for turn in back]
    fitted = _fit(Proposals([str(k) for k in range(len(poses))], poses), surface, hand, up, on_support=True)
    if isinstance(fitted, SuctionCandidates) or np.any(fitted.verdict != hand_fit_kernel.FREE):
        return False
    return bool(np.all(np.diff(fitted.measures[:, 0]) < 0))


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Grasp candidates for an object, with the result of the geometric checks for each candidate.

    They are cached per object, gripper and up direction. Mass and friction decide how many are sampled.
    """

    names: tuple[str, ...]
    poses: Array  # (k, 4, 4)
    verdict: NDArray[np.int64]
    measures: Array  # (k, 5): see hand_fit_kernel.fit
    contacts: Array  # (k, 2, 9)
    surface: Surface
    covered: float  # share of the surface that was tried

    def joined(self, more: _Fitted) -> _Fitted:
        both = np.concatenate
        return _Fitted(
            self.names + more.names,
            both([self.poses, more.poses]),
            both([self.verdict, more.verdict]),
            both([self.measures, more.measures]),
            both([self.contacts, more.contacts]),
            self.surface,
            more.covered,
        )


_kept: OrderedDict[tuple, _Fitted | SuctionCandidates] = OrderedDict()


def _fitted(
    item: CollisionObject, hand: Hand, generator: str, up: Array, on_support: bool, pose_error: float
) -> _Fitted | SuctionCandidates:
    make = generators[generator]
    surface = surface_of(item)
    load = (item.mass_kg, item.material.friction, item.material.torsional_friction, item.thread)
    key = (surface.key, id(hand), generator, (up.round(3) + 0.0).tobytes(), on_support, pose_error, load)
    if key not in _kept:
        made = make(item, surface, hand, up)
        batches = (made,) if isinstance(made, Proposals) else made
        _kept[key] = _sampled(batches, item, surface, hand, up, on_support, pose_error)
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
    _kept.move_to_end(key)
    return _kept[key]


def _sampled(
    batches: Iterable[Proposals], item: CollisionObject, surface: Surface, hand: Hand, up: Array,
    on_support: bool, pose_error: float,
) -> _Fitted | SuctionCandidates:  # fmt: skip
    """Check for batches of grasp candidates whether the hand fits the object, until there are enough good
    candidates or the generator has no more proposals.
    """
    found, best = None, -np.inf
    for proposals in batches:
        fitted = _fit(proposals, surface, hand, up, on_support, pose_error)
        if isinstance(fitted, SuctionCandidates):
            return fitted
        found = fitted if found is None else found.joined(fitted)
        loads = _Loads(item, hand, found, up)
        holds = loads.holds()
        before, best = best, float(loads.score[holds].max(initial=-np.inf))
        if holds.sum() >= MANY and (best > GOOD or best < before + CONVERGED):
            break
    return found if found is not None else _fit(Proposals(), surface, hand, up, on_support)


def _fit(
    proposals: Proposals, surface: Surface, hand: Hand, up: Array, on_support: bool, pose_error: float = 0.0
) -> _Fitted | SuctionCandidates:
    if isinstance(hand.gripper, SuctionGripper):
        return find_seals(tuple(proposals.names), proposals.poses, surface, hand, up, on_support)
    poses = np.array(proposals.poses, dtype=float).reshape(-1, 4, 4)
    floor = float((surface.points @ up).min()) if on_support else -np.inf

    def fit(names: tuple[str, ...], poses: Array, deep: bool) -> _Fitted:
        found = hand_fit_kernel.fit_hand(
            poses, surface.points, surface.normals, hand.palm, hand.left, hand.right, hand.pad,
            hand.thinnest, hand.gripper.max_width, np.ascontiguousarray(up), floor, APPROACH, pose_error,
            deep,
        )  # fmt: skip
        verdict, measures, contacts = found
        return _Fitted(names, poses, verdict, measures, contacts, surface, proposals.covered)

    found = fit(tuple(proposals.names), poses.copy(), False)
    # A hand that is farther from the object may hold worse: propose the deeper grasp too.
    farther = np.flatnonzero((found.verdict == hand_fit_kernel.FREE) & (found.measures[:, 4] > 0))
    if len(farther):
        names = tuple(f"{found.names[k]}, deeper" for k in farther)
        found = found.joined(fit(names, poses[farther], True))
    return found


class _Loads:
    """Grip forces, contact angles and scores of the grasp candidates that passed the geometric checks, one
    row per candidate.

    Attributes:
        good: (k,) indices of the candidates.
        force: [N] minimum force per finger at the center of mass.
        slanted: (k,) tan of the larger angle between a pad's force and the normal of its contact.
        least, needed: (k,) [N] minimum force per finger for the hand at rest, and in motion.
        beside: (k,) [m] distance of the weight from the contacts, with the hand at rest.
        score: (k,) higher scores are tried first.
    """

    def __init__(self, item: CollisionObject, hand: Hand, fitted: _Fitted, up: Array):
        self.friction, self.gripper = max(item.material.friction, 1e-3), hand.gripper
        friction, force = self.friction, needed_force(item)
        good = np.flatnonzero(fitted.verdict == hand_fit_kernel.FREE)
        R, at = fitted.poses[good, :3, :3], fitted.poses[good, :3, 3]
        contacts, width = fitted.contacts[good], fitted.measures[good, 0]
        # Each pad's force must be within the friction cone, or the pads squeeze the object out.
        inwards = np.stack([contacts[:, 0, 4], -contacts[:, 1, 4]], 1).clip(-1.0, 1.0)
        slope = (np.sqrt(1 - inwards**2) / np.maximum(inwards, 1e-6)).max(1)
        # Lever arm of the weight about the line through both contacts, held by the pads' torsional friction.
        a = contacts[:, 0, :3]
        axis = contacts[:, 1, :3] - a
        apart = np.maximum(np.linalg.norm(axis, axis=1), 1e-9)
        axis /= apart[:, None]
        twist = np.sqrt(1 - axis[:, 1] ** 2) / np.maximum(np.abs(axis[:, 1]), 1e-6)
        up_tcp = R.transpose(0, 2, 1) @ up
        mass_at = np.einsum("kji,kj->ki", R, fitted.surface.center_of_mass - at) - a
        arm = np.cross(mass_at, axis)
        tilting = np.abs(np.einsum("ki,ki->k", arm, up_tcp))  # hand at rest
        lever = np.hypot(tilting, 0.5 * np.linalg.norm(arm, axis=1))  # in motion, for any orientation
        patch, rub = contacts[:, :, 7].min(1), item.material.torsional_friction
        # A weight far outside the pads (a tray held by its rim) pries them off. Friction and uneven pressure
        # over the height of the contact resist; slanted contacts have used up a part of the friction.
        along = np.einsum("ki,ki->k", mass_at, axis)
        beyond = np.maximum(np.maximum(-along, along - apart), 0.0)
        level = np.sqrt(1 - np.einsum("ki,ki->k", axis, up_tcp).clip(-1, 1) ** 2)
        slanted = np.maximum(slope, twist)
        height = 2 * EDGE * _extent_along(contacts[:, :, 7:], up_tcp) + hand_fit_kernel.INSET
        resists = (friction * apart + height) * (1 - slanted / friction).clip(LEFT, 1.0)
        peeling = 2 * friction * force * beyond * level / resists
        least = force * holding_factor(friction, rub, tilting, patch) + peeling
        needed = force * holding_factor(friction, rub, lever, patch) + peeling
        # friction of the pads resists at half the width and across the contact patches
        if item.thread is not None:
            twisting = item.thread.torque / (friction * width + 2 * patch)
            least, needed = np.maximum(least, twisting), np.maximum(needed, twisting)
        quality = (
            np.clip(1 - (slanted / friction) ** 2, 0, 1)
            * np.clip(self.gripper.max_force / np.maximum(SAFETY * needed, 1e-9), 0.05, 1)
            * (0.3 + 0.7 * patch / (patch + SOFT_PATCH))
            / (1 + (lever / FAR_LEVER) ** 2)
        )
        down = -(R[:, :, 2] @ up)
        from_above = np.where(down > 0.95, 1.0, 0.5 + 0.4 * down.clip(-1, 1))
        preferred = 0.1 * width / self.gripper.max_width + 1e-3 * (R[:, 0, 1] < -1e-6)
        self.good, self.force, self.slanted, self.least, self.needed = good, force, slanted, least, needed
        tolerant = 1 - INTOLERANT * (1 - fitted.measures[good, 3])
        self.beside, self.score = tilting + beyond, quality * from_above * tolerant - preferred

    def holds(self) -> NDArray[np.bool_]:
        """Return a mask (k,) of the grasp candidates for which gripper force and friction suffice."""
        strong = self.force <= self.gripper.max_force
        return strong & (self.slanted <= self.friction) & (self.least <= self.gripper.max_force)


def _extent_along(spread: Array, up_tcp: Array) -> Array:
    """Return the radius of gyration (k,) [m] of the smaller contact patch along the vertical, in the plane of
    the pads.

    Args:
        spread: (k, 2, 2) [m] radii of gyration of both patches about their normals, and along z of the tcp.
        up_tcp: (k, 3) vertical in the tcp frame.
    """
    across, along = up_tcp[:, 0, None] ** 2, up_tcp[:, 2, None] ** 2
    total, z = spread[:, :, 0] ** 2, spread[:, :, 1] ** 2
    squares = (across * (total - z).clip(0.0) + along * z) / np.maximum(across + along, 1e-12)
    return np.sqrt(squares.min(1))


def _judged(
    item: CollisionObject, hand: Hand, fitted: _Fitted, up: Array
) -> tuple[list[Grasp], list[Rejection]]:
    gripper, loads = hand.gripper, _Loads(item, hand, fitted, up)
    rejected = [
        Rejection(fitted.names[i], *_why(int(fitted.verdict[i]), fitted.measures[i], hand))
        for i in np.flatnonzero(fitted.verdict != hand_fit_kernel.FREE)
    ]
    found: list[Grasp] = []
    for i in np.argsort(-loads.score, kind="stable"):
        k = loads.good[i]
        name, slanted, least = fitted.names[k], float(loads.slanted[i]), float(loads.least[i])
        if loads.force > gripper.max_force:
            text = f"needs {loads.force:.0f} N per finger, the gripper has {gripper.max_force:.0f} N"
            rejected.append(Rejection(name, text, 4, loads.force / gripper.max_force))
        elif slanted > loads.friction:
            has, holds = np.degrees(np.arctan((slanted, loads.friction)))
            text = f"slips off: the surface is {has:.0f} deg slanted, friction holds {holds:.0f} deg"
            rejected.append(Rejection(name, text, SLIPS, float(np.radians(has - holds))))
        elif least > gripper.max_force:
            beside = 1000 * float(loads.beside[i])
            text = f"needs {least:.0f} N per finger, {beside:.0f} mm beside the middle, the gripper has"
            excess = least / gripper.max_force
            rejected.append(Rejection(name, f"{text} {gripper.max_force:.0f} N", 4, excess))
        else:
            width, opening = fitted.measures[k, :2].tolist()
            pose = SE3(SO3(fitted.poses[k, :3, :3]), fitted.poses[k, :3, 3])
            pose = pose @ gripper.grip_center(width, opening).inverse()
            pads = (PadContact.of(fitted.contacts[k, 0]), PadContact.of(fitted.contacts[k, 1]))
            hold = firm_force(float(loads.needed[i]), gripper)
            found.append(Grasp(name, pose, width, opening, hold, float(loads.score[i]), contacts=pads))
    return found, rejected


def _why(verdict: int, measures: Array, hand: Hand) -> tuple[str, int, float]:
    """Describe why a grasp candidate was rejected. Return the reason, the number of checks that it passed,
    and by how much [m] the failed check was violated.
    """
    by, opens = float(measures[2]), hand.gripper.max_width
    mm = 1000 * by
    match verdict:
        case hand_fit_kernel.TOO_WIDE:
            return f"{mm:.0f} mm wide, the gripper opens {opens * 1000:.0f} mm", 1, by - opens
        case hand_fit_kernel.HAND_HITS:
            return f"the hand would be {mm:.0f} mm inside the object", 2, by
        case hand_fit_kernel.SUPPORT_HIT:
            return f"the hand would be {mm:.0f} mm inside what the object stands on", 2, by
        case hand_fit_kernel.TOO_FLAT:
            return f"too flat: {mm:.0f} mm off, to keep the hand clear, the pads miss it", 2, by
    return "nothing is between the pads", 0, np.inf
