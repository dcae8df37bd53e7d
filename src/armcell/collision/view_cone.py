"""Occlusion of a sensor's view by the robot: distances of links from a convex region."""

from __future__ import annotations

from collections.abc import Iterable

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.coal_shapes import convex_hull, solid
from armcell.core import SE3
from armcell.core.checks import float_array, is_number, require
from armcell.kinematics import kinematic_tree
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


def link_hull_distances(
    scene: PlanningScene, corners: Array, ignored: Iterable[str] = ()
) -> dict[str, float]:
    """Return the signed distances [m] between robot links and a view cone.
    The cone is the convex hull of points (k, 3).

    A negative value is the penetration depth. Attached objects and padding are not included.

    Args:
        scene: the scene with the robot's state.
        corners: (k, 3) points [m, world frame], at least 4.
        ignored: links to leave out.
    """
    corners = float_array(corners, (None, 3), "corners")
    require(len(corners) >= 4, f"the corners of a solid are at least 4, not {len(corners)}")
    hull, tree = convex_hull(corners), kinematic_tree(scene.model)
    Ts, here = tree.link_transforms(scene.positions), coal.Transform3s()
    request, result, found = coal.DistanceRequest(), coal.DistanceResult(), {}
    for link in scene.model.links.values():
        if link.name in ignored:
            continue
        T_world_link = SE3.from_matrix(Ts[tree.link_index[link.name]])
        for part in link.collisions:
            shape = solid(part.shape, scene.link_scale.get(link.name, 1.0))
            T = T_world_link @ part.T_link_shape
            result.clear()
            there = coal.Transform3s(T.rotation.matrix, T.translation)
            distance = float(coal.distance(shape.exact, there, hull, here, request, result))
            if distance > 0 and shape.holds(T.inverse().apply(corners[0])):
                distance = -distance  # the hull is completely inside a nonconvex mesh
            found[link.name] = min(found.get(link.name, np.inf), distance)
    return found


def links_in_hull(scene: PlanningScene, corners: Array, ignored: Iterable[str] = ()) -> dict[str, float]:
    """Return the robot links that intersect a view cone, with their depths [m].
    The cone is the convex hull of points (k, 3).
    """
    return {
        name: -apart for name, apart in link_hull_distances(scene, corners, ignored).items() if apart <= 0
    }
