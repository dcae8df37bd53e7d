"""Where a first look at a scene should go."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.kinematics import kinematic_tree
from armcell.scene.scene import PlanningScene

LARGE = 2.0  # [m] an object that reaches farther from its origin is the surroundings


def extent(scene: PlanningScene) -> tuple[NDArray[np.float64], float]:
    """Middle (3,) and radius [m] of what a first look should show: the origins of links and of objects that
    are not the surroundings."""
    points = [*kinematic_tree(scene.model).link_transforms(scene.positions)[:, :3, 3]]
    points += [
        item.T_world_object.translation for item in scene.objects.values() if item.bounds()[1].max() < LARGE
    ]
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    return (low + high) / 2, max(0.5, float(np.linalg.norm(high - low)) / 2)
