"""What a suggestion can change. Each takes and returns (scene, request) and leaves the given ones alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import SE3, CartesianRequest, Goal, JointState, PlanRequest, PoseGoal
from armcell.scene import PlanningScene

Request = PlanRequest | CartesianRequest
Both = tuple[PlanningScene, Request]


def change_request(scene: PlanningScene, request: Request, **fields: Any) -> Both:
    """Fields of the request replaced."""
    return scene, replace(request, **fields)


def change_start(scene: PlanningScene, request: Request, state: JointState) -> Both:
    """Some joints of the start elsewhere; the others stay where they are."""
    start = scene.state.updated(request.start) if request.start is not None else scene.state
    return scene, replace(request, start=start.updated(state))


def change_goal(scene: PlanningScene, request: PlanRequest, number: int, goal: Goal) -> Both:
    """One of the goals replaced; `number` of them: one more."""
    goals = list(request.goals)
    goals[number : number + 1] = [goal]
    return scene, replace(request, goals=tuple(goals))


def change_waypoints(scene: PlanningScene, request: CartesianRequest, waypoints: Sequence[SE3]) -> Both:
    return scene, replace(request, waypoints=tuple(waypoints))


def go_freely(scene: PlanningScene, request: CartesianRequest) -> Both:
    """A motion to the last waypoint that need not be straight."""
    goal = PoseGoal(request.waypoints[-1], request.link)
    return scene, PlanRequest(
        request.group, (goal,), start=request.start, velocity_scaling=request.velocity_scaling,
        acceleration_scaling=request.acceleration_scaling, path_constraints=request.path_constraints,
    )  # fmt: skip


def remove_objects(scene: PlanningScene, request: Request, names: Sequence[str]) -> Both:
    """Objects of the world taken away."""
    return without(scene, names), request


def move_object(scene: PlanningScene, request: Request, name: str, offset: ArrayLike) -> Both:
    """An object of the world moved by (3,) [m]."""
    return moved(scene, name, np.asarray(offset, dtype=float)), request


def change_padding(scene: PlanningScene, request: Request, padding: float) -> Both:
    """No link's padding larger than so many metres."""
    return padded(scene, padding), request


def allow_contact(scene: PlanningScene, request: Request, a: str, b: str) -> Both:
    """Two bodies may touch from now on."""
    return scene.with_allowed(a, b), request


def change_mass(scene: PlanningScene, request: Request, name: str, mass: float) -> Both:
    """A held object of another mass [kg]."""
    body = scene.attached[name]
    lighter = replace(body, object=replace(body.object, mass=mass))
    return replace(scene, attached={**scene.attached, name: lighter}), request


def reset_state(scene: PlanningScene, request: Request, state: JointState) -> Both:
    """Joints of the scene's own state set, whatever they were."""
    positions = np.array(scene.positions)
    positions[scene.model.columns(state.joint_names)] = state.positions
    return replace(scene, positions=positions), request


def without(scene: PlanningScene, names: Sequence[str]) -> PlanningScene:
    return replace(scene, objects={k: v for k, v in scene.objects.items() if k not in names})


def moved(scene: PlanningScene, name: str, offset: np.ndarray) -> PlanningScene:
    T = scene.objects[name].T_world_object
    return scene.with_object_pose(name, SE3(T.rotation, T.translation + offset))


def padded(scene: PlanningScene, most: float) -> PlanningScene:
    links = {link: min(value, most) for link, value in scene.link_padding.items()}
    return scene.with_padding(min(scene.padding, most), links)
