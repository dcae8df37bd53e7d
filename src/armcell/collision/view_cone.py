"""Occlusion of a sensor's view by the robot: distances of links from a convex region."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache, partial
from typing import NamedTuple

import coal
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.collision.coal_shapes import CoalGeometry, convex_hull, solid
from armcell.core import SE3
from armcell.core.checks import float_array, is_number, require
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.scene import PlanningScene

Array = NDArray[np.float64]
MAX_SIDES = 1000  # largest number of polygon sides


def view_cone(origin: ArrayLike, T_world_disc: SE3, radius: float, sides: int) -> Array:
    """Return the corners (sides + 1, 3) [m] of a view cone: a pyramid from a sensor to a regular polygon.

    Args:
        origin: (3,) apex of the pyramid [m].
        T_world_disc: pose of the disc; the polygon's corners are on the disc's rim, in its xy plane.
        radius: radius of the disc [m].
        sides: number of polygon sides.
    """
    require(
        is_number(sides) and 3 <= sides <= MAX_SIDES, f"a polygon has 3 to {MAX_SIDES} sides, not {sides!r}"
    )
    require(is_number(radius), f"radius is {radius!r}, it must be a finite number")
    angles = 2 * np.pi * np.arange(sides) / sides
    rim = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros(sides)])
    return np.vstack([float_array(origin, (3,), "the origin"), T_world_disc.apply(rim)])


def links_by_distance(
    scene: PlanningScene, corners: Array, ignored: Iterable[str] = ()
) -> Iterator[tuple[str, float, Callable[[], float]]]:
    """Yield the collision shapes of robot links, sorted by a lower bound of the distance from a view cone.
    The cone is the convex hull of points (k, 3).

    Each shape comes as the link's name, the lower bound [m], and a function that computes the signed distance
    [m]. A negative distance is the penetration depth. A caller can stop at a bound beyond which no link
    matters. Attached objects and padding are not included.

    Args:
        scene: the scene with the robot's state.
        corners: (k, 3) points [m, world frame], at least 4.
        ignored: links to leave out.
    """
    corners = float_array(corners, (None, 3), "corners")
    require(len(corners) >= 4, f"the corners of a solid are at least 4, not {len(corners)}")
    robot = _robot_shapes(scene.model, tuple(scene.link_scale.items()))
    Ts = kinematic_tree(scene.model).link_transforms(scene.positions)[robot.links]
    hull, here = convex_hull(corners), coal.Transform3s()
    request, result = coal.DistanceRequest(), coal.DistanceResult()

    def distance(i: int) -> float:
        T, shape = Ts[i] @ robot.poses[i], robot.shapes[i]
        R, t = T[:3, :3], T[:3, 3]
        result.clear()
        found = float(coal.distance(shape.exact, coal.Transform3s(R, t), hull, here, request, result))
        if found > 0 and shape.hollow is not None and shape.holds(R.T @ (corners[0] - t)):
            return -found  # the hull is completely inside a nonconvex mesh
        return found

    bounds = _lower_bounds(robot.balls, Ts, corners)
    for i in bounds.argsort().tolist():
        if robot.names[i] not in ignored:
            yield robot.names[i], float(bounds[i]), partial(distance, i)


def links_in_hull(scene: PlanningScene, corners: Array, ignored: Iterable[str] = ()) -> dict[str, float]:
    """Return the robot links that intersect a view cone, with their depths [m]. The arguments are those of
    `links_by_distance`.
    """
    found: dict[str, float] = {}
    for link, bound, distance in links_by_distance(scene, corners, ignored):
        if bound > 0:
            break
        if (apart := distance()) <= 0:
            found[link] = max(found.get(link, 0.0), -apart)
    return found


class _RobotShapes(NamedTuple):
    """Collision shapes (m) of a robot: name and index of the link, pose in the link (4, 4), geometry, and the
    bounding ball (4,) [m, link frame].
    """

    names: list[str]
    links: NDArray[np.int64]
    poses: list[Array]
    shapes: list[CoalGeometry]
    balls: Array


@lru_cache(maxsize=32)
def _robot_shapes(model: RobotModel, scales: tuple[tuple[str, float], ...]) -> _RobotShapes:
    index, scale = kinematic_tree(model).link_index, dict(scales)
    parts = [(name, part) for name, link in model.links.items() for part in link.collisions]
    shapes = [solid(part.shape, scale.get(name, 1.0)) for name, part in parts]
    balls = [
        [*part.T_link_shape.apply(shape.center), float(np.linalg.norm(shape.half))]
        for (_, part), shape in zip(parts, shapes, strict=True)
    ]
    return _RobotShapes(
        [name for name, _ in parts], np.array([index[name] for name, _ in parts], np.int64),
        [part.T_link_shape.matrix for _, part in parts], shapes, np.array(balls).reshape(-1, 4),
    )  # fmt: skip


@njit(cache=True)
def _lower_bounds(balls: Array, Ts: Array, corners: Array) -> Array:
    """Return lower bounds (m,) [m] of the distances between a robot's shapes and a view cone.

    The bounds are the distances between the shapes' balls and the capsule around the cone, whose axis leads
    from the first corner to the center of the others.

    Args:
        balls: (m, 4) bounding balls of the shapes [m, link frames].
        Ts: (m, 4, 4) poses of the shapes' links.
        corners: (k, 3) corners of the cone [m, world frame].
    """
    count = len(corners)
    axis = np.zeros(3)
    for j in range(3):
        axis[j] = (corners[:, j].sum() - corners[0, j]) / (count - 1) - corners[0, j]
    length2 = max(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2, 1e-12)
    found, radius, way = np.empty(len(balls)), 0.0, np.empty(3)
    for k in range(count + len(balls)):  # first the corners, which give the capsule's radius
        i = k - count
        for j in range(3):
            way[j] = -corners[0, j]
            if i < 0:
                way[j] += corners[k, j]
            else:
                way[j] += Ts[i, j, 3]
                for m in range(3):
                    way[j] += Ts[i, j, m] * balls[i, m]
        along = way[0] * axis[0] + way[1] * axis[1] + way[2] * axis[2]
        share = min(max(along / length2, 0.0), 1.0)
        distance = 0.0
        for j in range(3):
            distance += (way[j] - share * axis[j]) ** 2
        distance = np.sqrt(distance)
        if i < 0:
            radius = max(radius, distance)
        else:
            found[i] = distance - balls[i, 3] - radius
    return found
