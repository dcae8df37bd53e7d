"""Placement candidates of an object on a support, best first."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, InputError
from armcell.core.checks import checked, float_array, is_number, require, unit_vector
from armcell.core.geometry import extent
from armcell.grasping.grasp import pair_friction
from armcell.grasping.stability import resting_now, stable_poses
from armcell.grasping.support import LEVEL, support_surface, tilt_of
from armcell.grasping.surface import surface_of
from armcell.scene import CollisionObject
from armcell.scene.resting import StablePose, margin_of, polygon

RELEASE_GAP = 0.001  # [m] above the support when the fingers open
STABILITY_MARGIN = 0.004  # [m] margin of the base to the support's edge, and of the mass to the base's edge
FREE_PLACES = 24  # number of placements in addition to the grid
OVERHANG = 0.4  # fraction of its margin that an object must keep if its base extends over an edge
ROLLS = 0.05  # score penalty for resting on a round side
UPRIGHT = 0.99  # minimum cosine between the direction that must be up and the surface normal
FRICTION_MARGIN = 1.5  # required ratio of available to needed friction on a tilted support

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
@checked()
class Placement:
    """Placement candidate: a pose T_world_object at which an object rests on a support.

    `normal` (3,) is the unit normal of the support surface in the world frame.
    """

    name: str
    T_world_object: SE3
    score: float = 0.0
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def above(self, distance: float) -> SE3:
        """Return the object pose that is a given distance [m] above its placement,
        along the normal of the support surface.
        """
        x, y, z = (distance * n for n in self.normal)
        return self.T_world_object.shifted(x, y, z)


def surface_for(item: CollisionObject, support: CollisionObject) -> tuple[SE3, float, float]:
    """Return the surface of a support on which to place an object. The surface is level enough for friction
    to hold the object, with a safety margin.

    The result is that of `support_surface`.

    Raises:
        InputError: no such surface exists; the text states the surface's tilt and the maximum tilt.
    """
    return support_surface(support, float(np.arctan(pair_friction(item, support) / FRICTION_MARGIN)))


def place_candidates(
    item: CollisionObject,
    support: CollisionObject,
    at: tuple[float, float] | None = None,
    step: float = 0.02,
    other_sides: bool = False,
    up: tuple[float, float, float] | None = None,
) -> list[Placement]:
    """Return poses at which an object can be placed on a support: first a 3 x 3 grid, then the whole surface.

    The grid is around a point.

    The object is aligned with the support's axes or keeps its orientation; it rests on the side that is
    nearest to its present orientation.

    Its base may extend over an edge without a wall if the center of mass is above the supported part.

    A tilted support is allowed up to the angle at which friction holds the object with factor
    `FRICTION_MARGIN`. The object is then tilted with the surface, and the vertical through its center of mass
    must be well inside its base.

    Args:
        item: the object at its present pose.
        at: point on the surface [m] from its center; default: the center, then the whole surface.
        step: grid spacing [m].
        other_sides: also place the object on its other sides, after the present one.
        up: direction in the object's frame that must align with the surface normal; without a matching
            resting side there are no candidates.
    Raises:
        InputError: there is no flat surface or it is too steep, the object does not fit on it, or the object
            is not stable on any side.
    """
    cx, cy = (0.0, 0.0) if at is None else float_array(at, (2,), "at").tolist()
    require(is_number(step) and step > 0, f"step is {step!r}, it must be a positive number [m]")
    frame, size_x, size_y = surface_for(item, support)
    if abs(cx) > size_x / 2 or abs(cy) > size_y / 2:
        raise InputError(
            f"place {at} m is beside {support.name!r}: {size_x:.2f} x {size_y:.2f} m from its center on"
        )
    normal = frame.rotation.matrix[:, 2]
    open_edges = _highest(support, normal) < float(frame.translation @ normal) + 1e-3
    now = resting_now(item)
    if now is None:
        raise InputError(f"object {item.name!r} does not stand on any side", hint="give it a flat side")
    sides = [now]
    if other_sides or up is not None:
        sides += [r for r in stable_poses(item) if r is not now and r.margin >= STABILITY_MARGIN]
    if up is not None:
        unit = unit_vector(up, "up")
        sides = [r for r in sides if r.up @ unit > UPRIGHT]
        if not sides:
            return []
    places = [(cx + dx, cy + dy, float(np.hypot(dx, dy)) * 10, dx == dy == 0)
              for dx in (0.0, -step, step) for dy in (0.0, -step, step)]  # fmt: skip
    if at is None:  # also the whole surface, evenly (two irrational steps)
        k = np.arange(1, FREE_PLACES + 1)
        spread = np.stack([k * 0.7548776662466927 % 1 - 0.5, k * 0.5698402909980532 % 1 - 0.5], 1)
        places += [(x * size_x, y * size_y, 2.0 + np.hypot(x, y), False) for x, y in spread.tolist()]
    tilt = tilt_of(frame)
    if tilt > LEVEL and (most := max(_stands_to(item, side, frame) for side in sides)) < tilt:
        raise InputError(
            f"object {item.name!r} would topple on {support.name!r}, which leans by "
            f"{np.degrees(tilt):.1f} degrees: it stands up to {np.degrees(most):.1f}, with "
            f"{STABILITY_MARGIN * 1000:.0f} mm to spare",
            hint="level the support, or put the object on a broader side",
        )
    found = []
    for n, side in enumerate(sides):
        found += _on_side(item, side, n, frame, (size_x, size_y), places, open_edges)
    if not found:
        raise InputError(
            f"object {item.name!r} does not fit on {support.name!r}: "
            f"its surface is {size_x * 1000:.0f} x {size_y * 1000:.0f} mm"
        )
    found.sort(key=lambda p: -p.score)
    return found


def rotated_placement(
    item: CollisionObject, support: CollisionObject, placement: Placement, angle: float
) -> Placement | None:
    """Return a placement turned by an angle [rad] about the surface normal through its center, or None if the
    object would then not be entirely on the support.
    """
    frame, size_x, size_y = surface_for(item, support)
    axis = placement_axis(item, placement)
    turn = SE3(SO3.exp((0.0, 0.0, angle)), np.zeros(3))
    T_world_object = axis @ turn @ axis.inverse() @ placement.T_world_object
    at = frame.inverse().apply(T_world_object.apply(_corners(item)))[:, :2]
    if np.any(np.abs(at) > np.array([size_x, size_y]) / 2 - STABILITY_MARGIN):
        return None
    return replace(
        placement, name=f"{placement.name}, turned {np.rad2deg(angle):.0f} deg", T_world_object=T_world_object
    )


def lowest_point(item: CollisionObject, T_world_object: SE3, placement: Placement) -> float:
    """Return the height [m] of an object's lowest point above the support surface of a placement, along the
    surface normal.
    """
    normal = np.array(placement.normal)
    low, rest = ((T.apply(_corners(item)) @ normal).min() for T in (T_world_object, placement.T_world_object))
    return float(low - rest)


def placement_axis(item: CollisionObject, placement: Placement) -> SE3:
    """Return T_world_axis of a placement: a frame at the placed object's center whose z axis is the normal of
    the support surface.
    """
    up = SO3.between((0.0, 0.0, 1.0), placement.normal)
    along = placement.T_world_object.apply(_corners(item)) @ up.matrix
    return SE3(up, up.matrix @ (along.min(0) + along.max(0)) / 2)


def _corners(item: CollisionObject) -> Array:
    """Return the vertices of an object's triangles, or the points of its cloud, (n, 3) [m] in the object's
    frame. Placements compute the object's extent from them.
    """
    surface = surface_of(item)
    return surface.triangles.reshape(-1, 3) if len(surface.triangles) else surface.points


def _highest(support: CollisionObject, normal: Array) -> float:
    """For placements on a support, return the highest coordinate [m] of the support along a world direction
    (3,).
    """
    up = support.T_world_object.rotation.matrix.T @ normal
    tops = [extent(s, T.rotation.matrix.T @ up)[1] + float(T.translation @ up) for s, T in support.shapes]
    return max(tops) + float(support.T_world_object.translation @ normal)


def _mass_height(item: CollisionObject, side: StablePose) -> float:
    """Return how high [m] the center of mass of a placed object is above its base."""
    return float(surface_of(item).center_of_mass @ side.up) + side.height


def _turns(item: CollisionObject, side: StablePose, frame: SE3) -> list[tuple[float, SO3]]:
    """Return the rotations about the surface normal that are possible for placing an object, preferred ones
    first.

    The results are (angle, rotation of the object in the world) pairs.

    First come alignments with the surface's edges, the nearest to the present orientation first, then the
    present orientation.
    """
    upright = SO3.between(side.up, (0.0, 0.0, 1.0))
    lean = SO3.between((0.0, 0.0, 1.0), frame.rotation.matrix[:, 2])
    yaw_now = _yaw(item.T_world_object.rotation, upright)
    yaw_frame = _yaw(lean.inverse() @ frame.rotation, SO3.identity())
    quarter = [yaw_frame + k * np.pi / 2 for k in range(4)]
    quarter.sort(key=lambda yaw: abs(_wrap(yaw - yaw_now)))
    return [(yaw, lean @ SO3.exp((0.0, 0.0, yaw)) @ upright) for yaw in [*quarter, yaw_now]]


def _slope(frame: SE3) -> Array:
    """Return the slope (2,) of a tilted surface for placements, in its x and y axes: how far a point's
    vertical projection onto the surface is from its projection along the normal, per meter of height.

    The vertical through a point at height h above the surface meets the surface at h * slope from the
    point's projection along the normal, in the x and y axes of the surface.
    """
    return -frame.rotation.matrix[2, :2] / frame.rotation.matrix[2, 2]


def _stands_to(item: CollisionObject, side: StablePose, frame: SE3) -> float:
    """Return how far [rad] the support surface of a placement may tilt before the placed object tips over.

    The surface tilts in its present tilt direction.
    """
    into = frame.rotation.inverse()
    return max(_tilt_held(item, side, (into @ R).matrix, frame) for _, R in _turns(item, side, frame))


def _tilt_held(item: CollisionObject, side: StablePose, turned: Array, frame: SE3) -> float:
    """Return how far [rad] the support surface of a placement may tilt before an object that is placed with a
    given rotation tips over.

    Args:
        turned: (3, 3) rotation of the object in the surface's frame.
    """
    steepness = float(np.linalg.norm(_slope(frame)))
    if steepness < 1e-9:
        return np.pi / 2
    down = _slope(frame) / steepness
    ring = (side.foot @ turned.T)[:, :2]
    mass = (turned @ surface_of(item).center_of_mass)[:2]
    edges = np.roll(ring, -1, axis=0) - ring
    inwards = np.column_stack([-edges[:, 1], edges[:, 0]])
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-12)
    spare = np.einsum("ij,ij->i", inwards, mass - ring) - STABILITY_MARGIN
    if len(ring) < 3 or spare.min() < 0:
        return 0.0
    towards = -inwards @ down
    reach = (spare[towards > 1e-9] / towards[towards > 1e-9]).min()
    return float(np.arctan2(reach, _mass_height(item, side)))


def _on_side(
    item: CollisionObject,
    side: StablePose,
    number: int,
    frame: SE3,
    size: tuple[float, float],
    places: list[tuple[float, float, float, bool]],
    open_edges: bool,
) -> list[Placement]:
    """Return poses that place an object on one of its sides, at given points of the support.

    Args:
        places: points of the support (x, y [m], cost, whether the point is the center).
    """
    tilt, slope, normal = tilt_of(frame), _slope(frame), frame.rotation.matrix[:, 2]
    surface, height = surface_of(item), _mass_height(item, side)
    corners = _corners(item)
    half = np.asarray(size) / 2 - STABILITY_MARGIN
    found = []
    for i, (yaw, R) in enumerate(_turns(item, side, frame)):
        turned = (frame.rotation.inverse() @ R).matrix
        if tilt > LEVEL and _tilt_held(item, side, turned, frame) < tilt:
            continue
        whole = (corners @ turned.T)[:, :2]
        low, high = whole.min(0), whole.max(0)
        middle, foot = (low + high) / 2, (high - low) / 2
        plumb = (turned @ surface.center_of_mass)[:2] + slope * height
        room_x, room_y = (half - foot).tolist()
        for x, y, cost, central in places:
            if abs(x) > room_x or abs(y) > room_y:
                stands = (side.foot @ turned.T)[:, :2] - middle + (x, y)
                mass = plumb - middle + (x, y)
                if not (open_edges and central and _stands_on(stands, mass, half, side.margin)):
                    continue
            # Put the object's center at (x, y), independent of its origin.
            origin = np.array([x - middle[0], y - middle[1], side.height])
            score = -cost - 0.1 * i - 10.0 * number - (ROLLS if side.margin < 1e-3 else 0.0)
            found.append(
                Placement(
                    f"({x * 1000:+.0f}, {y * 1000:+.0f}) mm, {np.rad2deg(yaw):.0f} deg"
                    + (f", side {number}" if number else ""),
                    SE3(R, frame.apply(origin)),
                    score,
                    (float(normal[0]), float(normal[1]), float(normal[2])),
                )
            )
    return found


def _stands_on(foot: Array, mass: Array, half: Array, whole: float) -> bool:
    """Return whether the center of mass (2,) of a placed object is well inside its supported base (n, 2).

    Args:
        half: (2,) [m] half size of the support's rectangle.
        whole: [m] margin on the whole base, of which a fraction must remain.
    """
    for axis in range(2):
        for sign in (1.0, -1.0):
            foot = _clipped(foot, axis, sign, float(half[axis]))
            if len(foot) < 3:
                return False
    flat = np.column_stack([foot, np.zeros(len(foot))])
    up = np.array([0.0, 0.0, 1.0])
    return margin_of(polygon(flat, up), up, np.array([*mass, 0.0])) >= max(STABILITY_MARGIN, OVERHANG * whole)


def _clipped(ring: Array, axis: int, sign: float, limit: float) -> Array:
    """Clip the base polygon (n, 2) of a placed object at one edge of the support surface. The part whose
    coordinate on `axis`, multiplied by `sign`, is at most `limit` [m] remains.

    Sutherland and Hodgman's algorithm.
    """
    kept = []
    for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        in_a, in_b = limit - sign * a[axis], limit - sign * b[axis]
        if in_a >= 0:
            kept.append(a)
        if (in_a >= 0) != (in_b >= 0):
            kept.append(a + (b - a) * in_a / (in_a - in_b))
    return np.array(kept).reshape(-1, 2)


def _yaw(R: SO3, upright: SO3) -> float:
    """Return the yaw angle [rad] of the rotation that turns a placed object from the orientation `upright` to
    the orientation R.
    """
    return float((R @ upright.inverse()).rpy[2])


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
