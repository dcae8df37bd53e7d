"""Camera target and view radius from which a viewer first shows a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.kinematics import kinematic_tree
from armcell.scene.scene import PlanningScene

LARGE = 2.0  # [m] an object that extends farther from its origin counts as surroundings


def extent(scene: PlanningScene) -> tuple[NDArray[np.float64], float]:
    """Return the extent of a scene for a viewer's initial view,
    as center (3,) [m, world frame] and radius [m].

    The view covers the origins of all links and of all objects that extend less than 2 m from their origin;
    larger objects count as surroundings.
    """
    points = [*kinematic_tree(scene.model).link_transforms(scene.positions)[:, :3, 3]]
    points += [
        item.T_world_object.translation for item in scene.objects.values() if item.bounds()[1].max() < LARGE
    ]
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    return (low + high) / 2, max(0.5, float(np.linalg.norm(high - low)) / 2)
