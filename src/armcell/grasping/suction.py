"""Checks of suction grasps: does a cup seal, and does the vacuum carry the load?

A cup seals if its lip, which reaches `stroke` beyond the ring, closes the gap to the surface all around the
ring. The vacuum F = pressure x area of the sealed cups must carry the load W = S m (g + a):

- pull and friction: W_normal + W_tangential / mu <= F. For a horizontal surface this is Schmalz' theoretical
  holding force m (g + a) S, for a vertical one m / mu (g + a) S. Schmalz' safety factor S is at least 1.5 for
  smooth and dense workpieces, and at least 2.0 for porous, rough, oiled or heterogeneous ones
  (https://www.schmalz.com, vacuum knowledge, "Theoretical Holding Force of a Suction Cup").
- tilting: the surface presses on the rings only. Its resultant F - W_normal must act inside the convex hull
  of the rings, or the object tilts over their edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import SE3, SO3
from armcell.grasping.grasp import APPROACH, LIFT_ACCELERATION, Grasp, PadContact, Rejection
from armcell.grasping.hand import Hand
from armcell.grasping.hand_fit_kernel import CLEARANCE, GAP
from armcell.grasping.surface import Surface
from armcell.model import SuctionGripper
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

RAYS, INNER = 16, 8  # rays around a ring, and on a circle of half its radius
BEFORE = 0.03  # [m] distance before the surface at which the rays start
RIM = 0.001  # [m] by which the tested ring is larger: tolerance of the pose
REACH = 0.6  # share of the stroke that a planned grasp uses
STANDOFF = 0.2  # distance from ring to surface before the vacuum is on, as a share of the stroke
BULGE = 0.0005  # [m] by which a surface may reach into a cup
HULL = 32  # directions in which the hull of the rings is tested
FAR_LEVER = 0.04  # [m] lever arm of the weight at which the score is halved
CORNER = np.cos(np.pi / 8)  # physics supports a ring at eight points


@dataclass(frozen=True, eq=False)
class SuctionCandidates:
    """Candidates for suction grasps, with the measured gap around each cup. These values do not depend on the
    object's mass or friction.
    """

    names: tuple[str, ...]
    poses: Array  # (k, 4, 4) T_object_tcp, at the standoff from the surface
    gaps: Array  # (k, c) [m] largest gap around each ring; infinite over an edge or a hole
    bulges: Array  # (k, c) [m] by which the surface reaches into each cup
    hits: Array  # (k,) [m] by which the hand is inside the object; 0: clear
    low: Array  # (k,) [m] by which the hand is inside the support; 0: clear
    surface: Surface


def find_seals(
    names: tuple[str, ...], poses: Sequence[Array], surface: Surface, hand: Hand, up: Array, on_support: bool
) -> SuctionCandidates:
    """Place suction grasps on a surface, and measure the gaps around their cups by ray casting, to check
    whether the cups seal.
    """
    gripper = hand.gripper
    assert isinstance(gripper, SuctionGripper)
    T, count = np.array(poses, dtype=float).reshape(-1, 4, 4), len(hand.cups)
    heights = _heights(T, surface, hand, gripper)
    ring = heights[:, :, :RAYS]
    touched = np.where(np.isfinite(ring), ring, np.inf).min((1, 2))  # the rings rest on the highest point
    plane = np.where(np.isfinite(touched), touched, 0.0)
    gaps = (heights[:, :, :RAYS] - plane[:, None, None]).max(2)
    gaps[~np.isfinite(heights).all(2)] = np.inf
    bulges = np.maximum(plane[:, None] - np.where(np.isfinite(heights), heights, np.inf).min(2), 0.0)
    standoff = STANDOFF * min(cup.stroke for cup in gripper.cups)
    T[:, :3, 3] += T[:, :3, 2] * (plane - standoff)[:, None]
    floor = float((surface.points @ up).min()) if on_support else -np.inf
    hits, low = np.zeros(len(T)), np.zeros(len(T))
    boxes = hand.boxes
    corners = np.array(
        [[box[[x, 1 + y, 2 + z]] for x in (0, 3) for y in (0, 3) for z in (0, 3)] for box in boxes]
    )
    for i, pose in enumerate(T):
        if not np.isfinite(gaps[i]).any():
            continue
        at = (surface.points - pose[:3, 3]) @ pose[:3, :3]
        for box in boxes:  # the whole approach: the box swept back along z
            aside = np.minimum(at[:, :2] - box[:2], box[3:5] - at[:, :2]).min(1) + GAP
            depth = np.minimum(aside, box[5] - at[:, 2])
            hits[i] = max(hits[i], float(depth[at[:, 2] > box[2] - APPROACH].max(initial=0.0)))
        lowest = float(((corners.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]) @ up).min())
        low[i] = max(floor + CLEARANCE - lowest, 0.0)
    return SuctionCandidates(names, T, gaps.reshape(-1, count), bulges, hits, low, surface)


def _heights(T: Array, surface: Surface, hand: Hand, gripper: SuctionGripper) -> Array:
    """Return the distances (k, c, RAYS + INNER + 1) [m] from suction cups to a surface, along rays parallel
    to the tcp's z axis. A distance is infinite if its ray does not hit the surface.

    The rays meet RAYS points around the ring of each cup, INNER points on a circle of half the cup's radius,
    and the cup's center.
    """
    angle = 2 * np.pi * np.arange(RAYS) / RAYS
    circle = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    inner = circle[:: RAYS // INNER]
    points = np.array([
        center + np.vstack([(cup.radius + RIM) * circle, cup.radius / 2 * inner, np.zeros((1, 3))])
        for center, cup in zip(hand.cups, gripper.cups, strict=True)
    ])  # fmt: skip
    local = points.reshape(-1, 3) - [0.0, 0.0, BEFORE]
    origins = np.einsum("kij,rj->kri", T[:, :3, :3], local) + T[:, None, :3, 3]
    origins = origins.reshape(len(T), *points.shape)
    radii = np.array([cup.radius + RIM for cup in gripper.cups])
    directions, triangles = np.ascontiguousarray(T[:, :3, 2]), np.ascontiguousarray(surface.triangles)
    middles = triangles.mean(1)
    reaches = np.linalg.norm(triangles - middles[:, None], axis=2).max(1, initial=0.0)
    heights = first_hits(origins, directions, radii, triangles, middles, reaches)
    return heights - BEFORE - points[None, :, :, 2]


@njit(cache=True)
def first_hits(origins, directions, radii, triangles, middles, reaches):
    """Return the distance [m] along each ray of the suction cups to the first triangle that it hits, as an
    array (k, c, r) for k directions, c cups and r rays per cup. The distance is inf if a ray hits none.

    Args:
        origins: (k, c, r, 3) start points of the rays of c cups; the last one is at the cup's center.
        directions: (k, 3) unit vectors.
        radii: (c,) largest distance [m] of a cup's rays from its center.
        triangles: (t, 3, 3).
        middles, reaches: (t, 3) and (t,) centers and radii of spheres around the triangles.
    """
    found = np.full(origins.shape[:3], np.inf)
    for k in range(len(origins)):
        dx, dy, dz = directions[k]
        for cup in range(origins.shape[1]):
            _cup_hits(origins[k, cup], dx, dy, dz, radii[cup], triangles, middles, reaches, found[k, cup])
    return found


@njit(cache=True)
def _cup_hits(origins, dx, dy, dz, radius, triangles, middles, reaches, found):
    """Intersect the rays of one suction cup with triangles, and write the distance [m] along each ray to its
    first hit to `found` (r,). The arguments are those of `first_hits`.
    """
    last = len(origins) - 1
    for t in range(len(triangles)):
        mx, my, mz = (
            middles[t, 0] - origins[last, 0],
            middles[t, 1] - origins[last, 1],
            middles[t, 2] - origins[last, 2],
        )
        along = mx * dx + my * dy + mz * dz
        if mx * mx + my * my + mz * mz - along * along > (reaches[t] + radius) ** 2:
            continue  # the triangle is beside all rays
        ax, ay, az = triangles[t, 0]
        e1x, e1y, e1z = triangles[t, 1, 0] - ax, triangles[t, 1, 1] - ay, triangles[t, 1, 2] - az
        e2x, e2y, e2z = triangles[t, 2, 0] - ax, triangles[t, 2, 1] - ay, triangles[t, 2, 2] - az
        px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
        det = e1x * px + e1y * py + e1z * pz
        if abs(det) < 1e-14:
            continue
        for r in range(len(origins)):
            sx, sy, sz = origins[r, 0] - ax, origins[r, 1] - ay, origins[r, 2] - az
            u = (sx * px + sy * py + sz * pz) / det
            if u < -1e-9 or u > 1.0 + 1e-9:
                continue
            qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
            v = (dx * qx + dy * qy + dz * qz) / det
            if v < -1e-9 or u + v > 1.0 + 1e-9:
                continue
            distance = (e2x * qx + e2y * qy + e2z * qz) / det
            if 0.0 < distance < found[r]:
                found[r] = distance


def evaluate_suction_grasps(
    item: CollisionObject, hand: Hand, seals: SuctionCandidates, up: Array
) -> tuple[list[Grasp], list[Rejection]]:
    """Check suction grasps for seal and holding force. Return the grasps that can carry the object, best
    first, and the rejected grasps with the reasons for rejection.
    """
    gripper = hand.gripper
    assert isinstance(gripper, SuctionGripper)
    stroke = np.array([cup.stroke for cup in gripper.cups])
    sealed = (seals.gaps <= REACH * stroke) & (seals.bulges <= BULGE)
    load = item.mass_kg * (9.81 + LIFT_ACCELERATION)
    friction = max(item.material.friction, 1e-3)
    found: list[Grasp] = []
    rejected: list[Rejection] = []
    for i, name in enumerate(seals.names):
        if not sealed[i].any():
            rejected.append(Rejection(name, *_leak(seals.gaps[i], seals.bulges[i], stroke)))
            continue
        if max(seals.hits[i], seals.low[i]) > 0:
            inside = "the object" if seals.hits[i] > 0 else "what the object stands on"
            by = float(seals.hits[i] or seals.low[i])
            rejected.append(Rejection(name, f"the hand would be {1000 * by:.0f} mm inside {inside}", 2, by))
            continue
        R, at = seals.poses[i, :3, :3], seals.poses[i, :3, 3]
        carried = _Carried(hand, gripper, sealed[i], R.T @ (seals.surface.center_of_mass - at), -R.T @ up)
        need, tilt = carried.strength(load, friction), carried.tilt(load * gripper.safety)
        if gripper.safety * need > carried.force:
            text = (
                f"needs {gripper.safety * need:.0f} N, {gripper.safety:g} times the load of {need:.0f} N; "
                f"the vacuum of {_cups(int(sealed[i].sum()))} pulls {carried.force:.0f} N"
            )
            rejected.append(Rejection(name, text, 4, gripper.safety * need / carried.force))
        elif tilt > 0:
            text = (
                f"tilts off: the load acts {1000 * carried.lever:.0f} mm beside the center of "
                f"{_cups(int(sealed[i].sum()))}, {1000 * tilt:.0f} mm too far"
            )
            rejected.append(Rejection(name, text, 3, tilt))
        else:
            pads = tuple(
                PadContact(center, np.array([0.0, 0.0, -1.0]), cup.radius)
                for center, cup, seal in zip(hand.cups, gripper.cups, sealed[i], strict=True)
                if seal
            )
            down = max(-float(R[:, 2] @ up), -1.0)
            strong = min(carried.force / (gripper.safety * need), 2.0) / 2
            near = 1 / (1 + (carried.lever / FAR_LEVER) ** 2)
            score = (1.0 if down > 0.95 else 0.5 + 0.4 * down) * strong * near
            pose, mean = SE3(SO3(R), at), carried.force / len(gripper.cups)
            found.append(Grasp(name, pose, 0.0, gripper.max_width, 0.9 * mean, score, contacts=pads))
    found.sort(key=lambda grasp: -grasp.score)
    return found, rejected


class _Carried:
    """Force and moment balance of an object that is held by the sealed suction cups of a hand, in the tcp
    frame.

    Attributes:
        force: vacuum force [N] of the sealed cups.
        lever: lever arm [m] of the weight about the center of the sealed cups.
    """

    def __init__(
        self, hand: Hand, gripper: SuctionGripper, sealed: NDArray[np.bool_], com: Array, down: Array
    ):
        forces = np.array([gripper.force(cup) for cup in gripper.cups])[sealed]
        self._at, self._com, self._down = hand.cups[sealed][:, :2], com, down
        self._radius = CORNER * np.array([cup.radius for cup in gripper.cups])[sealed]
        self.force = float(forces.sum())
        self._center = forces @ self._at / self.force
        self.lever = float(np.linalg.norm(np.cross(com - [*self._center, 0.0], down)))

    def strength(self, load: float, friction: float) -> float:
        """Return the vacuum force [N] that suction cups need to hold a load [N]: the load's pull normal to
        the cups plus the load's tangential component divided by the friction coefficient.
        """
        along = float(np.linalg.norm(self._down[:2]))
        return max(load * (max(float(self._down[2]), 0.0) + along / friction), 1e-9)

    def tilt(self, load: float) -> float:
        """Return how far [m] the center of pressure is outside the convex hull of the suction cups (negative:
        inside). If it is outside, the object tilts off the cups.
        """
        L = load * self._down
        moment = np.cross(self._com, L)
        press = self.force - float(L[2])
        if press <= 0:
            return np.inf
        at = (self.force * self._center + np.array([moment[1], -moment[0]])) / press
        angle = 2 * np.pi * np.arange(HULL) / HULL
        ways = np.column_stack([np.cos(angle), np.sin(angle)])
        hull = (ways @ self._at.T + self._radius).max(1)
        return float((ways @ at - hull).max())


def _leak(gaps: Array, bulges: Array, stroke: Array) -> tuple[str, int, float]:
    """Return the reason why no cup of a suction grasp seals, the number of checks that the grasp passed, and
    the distance [m] by which its best cup missed the next check's limit.
    """
    if not np.isfinite(gaps).any():
        return "every cup is over an edge or a hole of the surface", 0, np.inf
    open_by, bulge_by = gaps - REACH * stroke, bulges - BULGE
    k = int(np.argmin(np.maximum(open_by, bulge_by)))
    if bulge_by[k] > open_by[k]:
        return f"leaks: the surface reaches {1000 * bulges[k]:.1f} mm into the cup", 1, float(bulge_by[k])
    lip = f"the lip of the cup closes {1000 * REACH * stroke[k]:.1f} mm"
    text = f"leaks: the surface is up to {1000 * gaps[k]:.1f} mm off the ring, {lip}"
    return text, 1, float(open_by[k])


def _cups(count: int) -> str:
    return "1 cup" if count == 1 else f"{count} cups"
