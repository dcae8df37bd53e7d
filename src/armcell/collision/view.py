"""What of a robot is in the view of a sensor: its links against a convex body."""

from __future__ import annotations

from collections.abc import Iterable

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.shapes import convex_hull, solid
from armcell.core import SE3
from armcell.core.checks import float_array, is_number, require
from armcell.kinematics import kinematic_tree
from armcell.scene import PlanningScene

Array = NDArray[np.float64]
MAX_SIDES = 1000  # of a polygon


def cone(origin: ArrayLike, T_world_disc: SE3, radius: float, sides: int) -> Array:
    """Corners (sides + 1, 3) [m] of a pyramid: from a point (3,) to a polygon on a disc about its z axis."""
    require(
        is_number(sides) and 3 <= sides <= MAX_SIDES, f"a polygon has 3 to {MAX_SIDES} sides, not {sides!r}"
    )
    require(is_number(radius), f"radius is {radius!r}, it must be a finite number")
    angles = 2 * np.pi * np.arange(sides) / sides
    rim = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros(sides)])
    return np.vstack([float_array(origin, (3,), "the origin"), T_world_disc.apply(rim)])


def links_apart(scene: PlanningScene, corners: Array, ignored: Iterable[str] = ()) -> dict[str, float]:
    """How far [m] links of the robot are from the convex hull of points (k, 3); below zero: how deep in it.

    Args:
        ignored: links to leave out. What is attached is not looked at, nor is padding.
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
            if distance > 0 and shape.holds(T.inv().apply(corners[0])):
                distance = -distance  # wholly inside a mesh that is not convex
            found[link.name] = min(found.get(link.name, np.inf), distance)
    return found


def links_within(scene: PlanningScene, corners: Array, ignored: Iterable[str] = ()) -> dict[str, float]:
    """Links of the robot in the convex hull of points (k, 3), with how deep [m]; see `links_apart`."""
    return {name: -apart for name, apart in links_apart(scene, corners, ignored).items() if apart <= 0}
