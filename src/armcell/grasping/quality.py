"""Grasp quality: force closure, Ferrari-Canny epsilon and volume, robustness against noise.

A pad is a soft finger: it transmits a normal force, friction along the surface and torsion about the normal.
The wrenches of unit normal forces span a hull in (force, torque / object size); epsilon is the smallest
disturbance wrench that the grasp cannot resist, per newton of grip force (Ferrari and Canny 1992).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3
from armcell.core.checks import checked, float_array, is_number, require
from armcell.grasping import hand_fit_kernel
from armcell.grasping.grasp import LIFT_ACCELERATION, Grasp, PadContact, holding_factor
from armcell.grasping.hand import Hand
from armcell.grasping.surface import surface_of
from armcell.model import SuctionGripper
from armcell.scene import CollisionObject, Material

Array = NDArray[np.float64]

EDGES = 8  # edges of the pyramid that approximates a friction cone
CLOSED = 1e-6  # minimum epsilon for force closure
MOST_SAMPLES = 100_000  # of a noise


@dataclass(frozen=True)
class Quality:
    """Measures of the quality of one grasp. Without force closure, epsilon and volume are 0."""

    force_closure: bool
    epsilon: float  # [N per N of grip]
    volume: float  # volume of the 6D wrench hull


@dataclass(frozen=True)
@checked()
class Noise:
    """Standard deviations of uncertain quantities, used to evaluate how robust the quality of a grasp is."""

    position: float = 0.002  # [m] object position along each axis
    rotation: float = 0.035  # [rad] about each axis
    friction: float = 0.15  # relative
    mass: float = 0.1  # relative

    def poses(self, count: int, rng: np.random.Generator) -> list[SE3]:
        """Sample small displacements of an object, to evaluate how robust a grasp's quality is. The first is
        the identity.
        """
        shifts = self.position * _strata(count, 3, rng)
        turns = self.rotation * _strata(count, 3, rng)
        return [SE3(SO3.exp(t), s) for s, t in zip(shifts, turns, strict=True)]

    def materials(self, item: CollisionObject, count: int, rng: np.random.Generator) -> list[CollisionObject]:
        """Sample objects with varied friction and mass, to evaluate how robust a grasp's quality is. The
        first is the given object.
        """
        shares = np.exp(_strata(count, 2, rng) * [self.friction, self.mass])
        m = item.material
        return [
            replace(
                item,
                mass=item.mass_kg * float(heavy),
                material=m.scaled(float(rough)),
            )
            for rough, heavy in shares
        ]


def _strata(count: int, size: int, rng: np.random.Generator) -> Array:
    """Return `count` standard normal samples (count, size): the first is zero, the others are a Latin
    hypercube.

    With a few independent samples for all grasps of an object, their mean would bias all estimates alike.

    Raises:
        InputError: `count` is not a whole number from 1 to `MOST_SAMPLES`.
    """
    from scipy.special import ndtri

    is_whole = is_number(count) and count == int(count)
    require(is_whole and 1 <= count <= MOST_SAMPLES, f"count is {count!r}, not 1 to {MOST_SAMPLES} samples")
    count = int(count)
    strata = rng.permuted(np.tile(np.arange(count - 1), (size, 1)), axis=1).T
    return np.vstack([np.zeros(size), ndtri((strata + rng.random(strata.shape)) / max(count - 1, 1))])


def contact_wrenches(
    contacts: tuple[PadContact, ...], about: Array, size: float, material: Material, edges: int = EDGES
) -> Array:
    """Return the wrenches (n, 6) that the friction cones of a grasp can produce per newton of contact force,
    to evaluate the quality of the grasp.

    The contacts are soft fingers.

    Args:
        about: (3,) reference point of the torques, in the contacts' frame.
        size: [m] torques are divided by this length to be comparable with forces.
    """
    mu, found = material.friction, []
    angle = 2 * np.pi * np.arange(edges) / edges
    for contact in contacts:
        push = -contact.normal
        t1 = np.cross(push, np.eye(3)[int(np.argmin(np.abs(push)))])
        t1 /= np.linalg.norm(t1)
        t2 = np.cross(push, t1)
        forces = push + mu * (np.cos(angle)[:, None] * t1 + np.sin(angle)[:, None] * t2)
        torques = np.cross(contact.point - about, forces)
        torsion = mu * contact.radius + material.torsional_friction
        spin = np.cross(contact.point - about, push) + np.array([[torsion], [-torsion]]) * push
        found += [np.hstack([forces, torques / size]), np.hstack([np.tile(push, (2, 1)), spin / size])]
    return np.vstack(found)


def hull_quality(wrenches: Array) -> Quality:
    """Return the quality measures of a grasp from the convex hull of its contact wrenches (n, 6).

    Force closure holds if the hull contains the origin; epsilon is the origin's depth inside the hull.
    """
    from scipy.spatial import ConvexHull, QhullError

    wrenches = float_array(wrenches, (None, 6), "wrenches")
    for options in ("Qt", "QJ"):  # cocircular points may need joggled input (QJ, 1e-10)
        try:
            hull = ConvexHull(wrenches, qhull_options=options)
        except (QhullError, ValueError):
            continue
        epsilon = float(-hull.equations[:, -1].max())
        if epsilon < CLOSED:
            break
        return Quality(True, epsilon, float(hull.volume))
    return Quality(False, 0.0, 0.0)  # a flat hull: some wrench cannot be resisted


def grasp_quality(item: CollisionObject, grasp: Grasp) -> Quality:
    """Return the quality of a grasp relative to the object's center of mass:
    force closure, epsilon and volume.
    """
    surface = surface_of(item)
    about = grasp.T_object_tcp.inverse().apply(surface.center_of_mass)
    low, high = surface.bounds
    size = float(np.linalg.norm(high - low)) / 2
    return hull_quality(contact_wrenches(grasp.contacts, about, size, item.material))


def approach_depth(item: CollisionObject, hand: Hand, grasp: Grasp, T_object_tcp: SE3) -> float:
    """Return how deep [m] the open fingers of a grasp enter an object on their straight approach.

    The palm does not count: if it touches the object just before the grasp, a pick closes the hand.

    Args:
        T_object_tcp: pose of the hand at the end of the approach, which may differ from the grasp's own pose.
    """
    if isinstance(hand.gripper, SuctionGripper):
        return 0.0
    T = T_object_tcp @ hand.gripper.grip_center(grasp.width, grasp.opening)
    points = np.ascontiguousarray(T.inverse().apply(surface_of(item).points))
    return float(
        hand_fit_kernel.depth_on_approach(
            points, hand.palm[:0], hand.left, hand.right, grasp.approach, grasp.opening, 0.0
        )
    )


def robustness(
    item: CollisionObject, hand: Hand, grasp: Grasp, noise: Noise = Noise(), trials: int = 40, seed: int = 0
) -> float:
    """Return the quality of a grasp as its robustness: the fraction (0 to 1) of random trials, with varied
    pose, friction and mass of the object, in which it holds.

    A trial counts if the hand fits, the pads oppose each other within friction, and the force holds the
    weight.
    """
    rng, surface = np.random.default_rng(seed), surface_of(item)
    moved = noise.poses(trials, rng)
    poses = np.array([(T.inverse() @ grasp.T_object_tcp).matrix for T in moved])
    up = np.ascontiguousarray(item.T_world_object.rotation.matrix[2])
    verdict, _, contacts = hand_fit_kernel.fit_hand(
        poses, surface.points, surface.normals, hand.palm, hand.left, hand.right, hand.pad,
        hand.thinnest, hand.gripper.max_width, up, -np.inf, grasp.shortest_approach,
        0.0, False,
    )  # fmt: skip
    holds = 0
    for i, other in enumerate(noise.materials(item, trials, rng)):
        if verdict[i] != hand_fit_kernel.FREE:
            continue
        a, b = (PadContact.of(row) for row in contacts[i])
        friction = other.material.friction
        inwards = min(float(a.normal[1]), float(-b.normal[1]))
        if inwards <= 0 or np.sqrt(1 - min(inwards, 1.0) ** 2) / inwards > friction:
            continue
        axis = (b.point - a.point) / max(float(np.linalg.norm(b.point - a.point)), 1e-9)
        T_tcp_object = np.linalg.inv(poses[i])
        mass_at = T_tcp_object[:3, :3] @ surface.center_of_mass + T_tcp_object[:3, 3]
        lever = float(np.linalg.norm(np.cross(mass_at - a.point, axis)))
        factor = holding_factor(
            friction,
            other.material.torsional_friction,
            np.array([lever]),
            np.array([min(a.radius, b.radius)]),
        )[0]
        needed = other.mass_kg * (9.81 + LIFT_ACCELERATION) / (2 * max(friction, 0.05)) * factor
        holds += needed <= grasp.force
    return holds / trials
