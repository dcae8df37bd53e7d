"""Changes of scene and request that a suggestion can make.

Each change is a function from (scene, request) to a changed copy of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import SE3, CartesianRequest, Goal, JointState, PlanRequest, PoseGoal
from armcell.scene import PlanningScene

Request = PlanRequest | CartesianRequest
SceneAndRequest = tuple[PlanningScene, Request]


def change_request(scene: PlanningScene, request: Request, **fields: Any) -> SceneAndRequest:
    """Apply a suggested change that replaces fields of a planning request."""
    return scene, replace(request, **fields)


def change_start(scene: PlanningScene, request: Request, state: JointState) -> SceneAndRequest:
    """Apply a suggested change that moves some joints in the start state of a request to other positions."""
    start = scene.state.updated(request.start) if request.start is not None else scene.state
    return scene, replace(request, start=start.updated(state))


def change_goal(scene: PlanningScene, request: PlanRequest, number: int, goal: Goal) -> SceneAndRequest:
    """Replace the goal at index `number` of a planning request, as a diagnosis suggests.
    If the request has no goal at this index, append the new goal.
    """
    goals = list(request.goals)
    goals[number : number + 1] = [goal]
    return scene, replace(request, goals=tuple(goals))


def change_waypoints(
    scene: PlanningScene, request: CartesianRequest, waypoints: Sequence[SE3]
) -> SceneAndRequest:
    """Apply a suggested change that replaces the waypoints of a Cartesian request."""
    return scene, replace(request, waypoints=tuple(waypoints))


def replace_by_free_motion(scene: PlanningScene, request: CartesianRequest) -> SceneAndRequest:
    """Apply a suggested change that replaces a motion on straight
    lines with a free motion to its last waypoint.
    """
    goal = PoseGoal(request.waypoints[-1], request.link)
    return scene, PlanRequest(
        request.group, (goal,), start=request.start, velocity_scaling=request.velocity_scaling,
        acceleration_scaling=request.acceleration_scaling, path_constraints=request.path_constraints,
    )  # fmt: skip


def remove_objects(scene: PlanningScene, request: Request, names: Sequence[str]) -> SceneAndRequest:
    """Apply a suggested change that removes objects from the planning scene."""
    return without(scene, names), request


def move_object(scene: PlanningScene, request: Request, name: str, offset: ArrayLike) -> SceneAndRequest:
    """Apply a suggested change that moves an object in the planning scene by an offset (3,) [m]."""
    return moved(scene, name, np.asarray(offset, dtype=float)), request


def change_padding(scene: PlanningScene, request: Request, padding: float) -> SceneAndRequest:
    """Apply a suggested change that reduces the padding of every link to at most `padding` [m]."""
    return padded(scene, padding), request


def allow_contact(scene: PlanningScene, request: Request, a: str, b: str) -> SceneAndRequest:
    """Apply a suggested change that allows two bodies to touch each other."""
    return scene.with_allowed(a, b), request


def change_mass(scene: PlanningScene, request: Request, name: str, mass: float) -> SceneAndRequest:
    """Apply a suggested change that sets the mass [kg] of an attached object."""
    body = scene.attached[name]
    lighter = replace(body, object=replace(body.object, mass=mass))
    return replace(scene, attached={**scene.attached, name: lighter}), request


def reset_state(scene: PlanningScene, request: Request, state: JointState) -> SceneAndRequest:
    """Apply a suggested change that sets joint positions in the robot state of the scene.
    The previous positions may be invalid.
    """
    positions = np.array(scene.positions)
    positions[scene.model.columns(state.joint_names)] = state.positions
    return replace(scene, positions=positions), request


def without(scene: PlanningScene, names: Sequence[str]) -> PlanningScene:
    """Return a copy of the scene without the given objects, for use in a suggested change."""
    return replace(scene, objects={k: v for k, v in scene.objects.items() if k not in names})


def moved(scene: PlanningScene, name: str, offset: np.ndarray) -> PlanningScene:
    """Return a copy of the scene in which an object is moved by an offset (3,) [m], for use in a suggested
    change.
    """
    T = scene.objects[name].T_world_object
    return scene.with_object_pose(name, SE3(T.rotation, T.translation + offset))


def padded(scene: PlanningScene, most: float) -> PlanningScene:
    """Return a copy of the scene whose paddings are at most `most` [m], for use in a suggested change."""
    links = {link: min(value, most) for link, value in scene.link_padding.items()}
    return scene.with_padding(min(scene.padding, most), links)
