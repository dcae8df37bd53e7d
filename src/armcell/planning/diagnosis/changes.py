"""Changes that could make a failed planning request succeed.

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
    """Change a failed planning request: replace some of its fields."""
    return scene, replace(request, **fields)


def change_start(scene: PlanningScene, request: Request, state: JointState) -> SceneAndRequest:
    """Change a failed planning request: move some joints of its start state to other positions."""
    start = scene.state.updated(request.start) if request.start is not None else scene.state
    return scene, replace(request, start=start.updated(state))


def change_goal(scene: PlanningScene, request: PlanRequest, number: int, goal: Goal) -> SceneAndRequest:
    """Change a failed planning request: replace the goal at index `number`. If the request has no goal at
    this index, append the new goal.
    """
    goals = list(request.goals)
    goals[number : number + 1] = [goal]
    return scene, replace(request, goals=tuple(goals))


def change_waypoints(
    scene: PlanningScene, request: CartesianRequest, waypoints: Sequence[SE3]
) -> SceneAndRequest:
    """Change a failed Cartesian request: replace its waypoints."""
    return scene, replace(request, waypoints=tuple(waypoints))


def replace_by_free_motion(scene: PlanningScene, request: CartesianRequest) -> SceneAndRequest:
    """Change a failed Cartesian request to a request for a free motion to its last waypoint."""
    goal = PoseGoal(request.waypoints[-1], request.link)
    return scene, PlanRequest(
        request.group, (goal,), start=request.start, velocity_scaling=request.velocity_scaling,
        acceleration_scaling=request.acceleration_scaling, path_constraints=request.path_constraints,
    )  # fmt: skip


def remove_objects(scene: PlanningScene, request: Request, names: Sequence[str]) -> SceneAndRequest:
    """Change the planning scene of a failed request: remove objects."""
    return without(scene, names), request


def move_object(scene: PlanningScene, request: Request, name: str, offset: ArrayLike) -> SceneAndRequest:
    """Change the planning scene of a failed request: move an object by an offset (3,) [m]."""
    return moved(scene, name, np.asarray(offset, dtype=float)), request


def change_padding(scene: PlanningScene, request: Request, padding: float) -> SceneAndRequest:
    """Change the planning scene of a failed request: limit the padding of every link to `padding` [m]."""
    return padded(scene, padding), request


def allow_contact(scene: PlanningScene, request: Request, a: str, b: str) -> SceneAndRequest:
    """Change the planning scene of a failed request: allow two bodies to touch each other."""
    return scene.with_allowed(a, b), request


def change_mass(scene: PlanningScene, request: Request, name: str, mass: float) -> SceneAndRequest:
    """Change the planning scene of a failed request: set the mass [kg] of an attached object."""
    body = scene.attached[name]
    lighter = replace(body, object=replace(body.object, mass=mass))
    return replace(scene, attached={**scene.attached, name: lighter}), request


def reset_state(scene: PlanningScene, request: Request, state: JointState) -> SceneAndRequest:
    """Change the planning scene of a failed request: set new joint positions in its robot state, because
    the previous positions may be invalid.
    """
    positions = np.array(scene.positions)
    positions[scene.model.columns(state.joint_names)] = state.positions
    return replace(scene, positions=positions), request


def without(scene: PlanningScene, names: Sequence[str]) -> PlanningScene:
    """Return a changed copy of a diagnosed scene, without the given objects."""
    return replace(scene, objects={k: v for k, v in scene.objects.items() if k not in names})


def moved(scene: PlanningScene, name: str, offset: np.ndarray) -> PlanningScene:
    """Return a changed copy of a diagnosed scene, in which an object is moved by an offset (3,) [m]."""
    T = scene.objects[name].T_world_object
    return scene.with_object_pose(name, SE3(T.rotation, T.translation + offset))


def padded(scene: PlanningScene, most: float) -> PlanningScene:
    """Return a changed copy of a diagnosed scene, whose paddings are at most `most` [m]."""
    links = {link: min(value, most) for link, value in scene.link_padding.items()}
    return scene.with_padding(min(scene.padding, most), links)
