"""Upper bound of how far a scene's bodies are displaced from the planned scene."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, Shape
from armcell.core.geometry import local_bounds
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.scene import PlanningScene

Array = NDArray[np.float64]
Solids = tuple[tuple[Shape, SE3], ...]


def displacement(planned: PlanningScene, scene: PlanningScene, joint_names: Iterable[str]) -> float:
    """Return an upper bound [m] on how much closer two bodies can be than planned,
    because objects or joints have been displaced.

    The result is an upper bound: a motion that keeps this distance from everything in the planned scene is
    collision-free in the other scene.

    Args:
        planned: the scene in which the motion was planned.
        scene: the current scene.
        joint_names: joints that the motion moves; their positions have no effect.
    Returns:
        Infinity if the planned scene has a different robot, lacks an object, or allows a contact that the
        other scene does not allow.
    """
    if planned.model is not scene.model or planned.link_scale or scene.link_scale:
        return math.inf
    if planned.attached.keys() != scene.attached.keys() or not planned.objects.keys() >= scene.objects.keys():
        return math.inf
    if not all(scene.is_allowed(*pair) for pair, yes in planned.allowed.items() if yes) or any(
        planned.is_allowed(*pair) for pair, yes in scene.allowed.items() if not yes
    ):
        return math.inf
    links = _links_moved(planned, scene, joint_names)
    robot = [float(links.max(initial=0.0))] * 2  # [m] displacements of two links, then of each held object
    objects = 0.0
    index = kinematic_tree(scene.model).link_index
    for name, held in scene.attached.items():
        known = planned.attached[name]
        if known.link != held.link or known.touch_links != held.touch_links:
            return math.inf
        if known.object.shapes is not held.object.shapes:
            return math.inf
        own = _moved(known.T_link_object, held.T_link_object, held.object.shapes)
        robot.append(own + float(links[index[held.link]]))
    for name, item in scene.objects.items():
        known = planned.objects[name]
        if known is item:
            continue
        if known.shapes is not item.shapes:
            return math.inf
        objects = max(objects, _moved(known.T_world_object, item.T_world_object, item.shapes))
    second, first = sorted(robot)[-2:]
    return first + max(second, objects)


def _links_moved(planned: PlanningScene, scene: PlanningScene, joint_names: Iterable[str]) -> Array:
    """Return upper bounds (links,) [m] on the displacement of each link
    that is caused by joints outside the planned motion.
    """
    model = scene.model
    q, columns = planned.positions.copy(), model.columns(joint_names)
    q[columns] = scene.positions[columns]
    radius = _link_radii(model)
    if np.array_equal(q, scene.positions):
        return np.zeros(len(radius))
    tree = kinematic_tree(model)
    off = tree.link_transforms(q) - tree.link_transforms(scene.positions)
    return np.linalg.norm(off[:, :3, :3], axis=(1, 2)) * radius + np.linalg.norm(off[:, :3, 3], axis=1)


def _moved(before: SE3, now: SE3, shapes: Solids) -> float:
    """Return an upper bound [m] on how far any point of an object moves when it is displaced from its planned
    to its present pose.
    """
    if before is now:
        return 0.0
    turned = (now.rotation.matrix - before.rotation.matrix).ravel().tolist()
    shift = math.dist(now.translation.tolist(), before.translation.tolist())
    return math.hypot(*turned) * _radius(shapes) + shift if any(turned) else shift


@lru_cache(maxsize=64)
def _link_radii(model: RobotModel) -> Array:
    """Return the distance (links,) [m] from each link's origin to its farthest point, which bounds the link's
    displacement.

    The order is that of the kinematic tree.
    """
    links = [model.links[name] for name in kinematic_tree(model).link_names]
    return np.array([_radius(tuple((c.shape, c.T_link_shape) for c in link.collisions)) for link in links])


@lru_cache(maxsize=256)
def _radius(shapes: Solids) -> float:
    """Return an upper bound on the distance [m] from the frame origin of an object or link to the points of
    its shapes, to bound their displacement.
    """
    reach = 0.0
    for shape, T in shapes:
        center, half = local_bounds(shape)
        reach = max(reach, float(np.linalg.norm(T.apply(center)) + np.linalg.norm(half)))
    return reach
