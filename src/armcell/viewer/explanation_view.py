"""Drawing of a planning explanation: colliding bodies in red, a nearby valid state in green."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from armcell.core import SE3, Explanation, JointState
from armcell.kinematics import kinematic_tree
from armcell.scene import PlanningScene
from armcell.viewer.geometry import Color, add_object_shape, add_part, collision_part, node_name
from armcell.viewer.viewer import CellViewer

if TYPE_CHECKING:
    import viser

BLOCKING: Color = (0.85, 0.10, 0.10, 0.75)
GHOST: Color = (0.15, 0.65, 0.35, 0.30)
POINT_M = 0.012  # [m] radius of the ball at a contact


def show_explanation(viewer: CellViewer, scene: PlanningScene, explanation: Explanation) -> list[Any]:
    """Draw the explanation of a planning failure in the view and show its summary in the panel.

    Colliding bodies are red, at the state of the collision. A green ghost of the whole robot shows
    `explanation.nearest`.

    Returns:
        viser handles of everything that was added.
    """
    handles = draw_explanation(viewer.server, scene, explanation)
    lines = [f"**{explanation.code.name}**", explanation.summary]
    lines += [f"{n}. {s.text}" for n, s in enumerate(explanation.suggestions, 1)]
    with viewer.server.gui.add_folder("Why not"):
        handles.append(viewer.server.gui.add_markdown("\n\n".join(lines)))
    return handles


def draw_explanation(server: viser.ViserServer, scene: PlanningScene, explanation: Explanation) -> list[Any]:
    """Draw the explanation of a planning failure as 3D shapes, without text: the colliding bodies, the
    contact points and the nearest valid state.
    """
    api = server.scene
    handles: list[Any] = []
    bodies = list(dict.fromkeys(n for c in explanation.contacts for n in (c.body_a, c.body_b)))
    with server.atomic():
        there = _at(scene, explanation.state)
        for name in bodies:
            handles += _body(api, there, name, "blocking", BLOCKING)
        for number, contact in enumerate(explanation.contacts):
            handles.append(
                api.add_icosphere(
                    node_name("why", "contact", str(number)),
                    radius=POINT_M,
                    color=tuple(round(255 * c) for c in BLOCKING[:3]),  # pyright: ignore[reportArgumentType]
                    position=contact.position,
                )
            )
        if explanation.nearest is not None:
            ghost = _at(scene, explanation.nearest)
            for name in (*scene.model.links, *scene.attached):
                handles += _body(api, ghost, name, "ghost", GHOST)
    return handles


def _at(scene: PlanningScene, state: JointState | None) -> PlanningScene:
    """Return the scene in which the viewer shows why planning failed. Positions that are not finite are
    replaced by default positions.
    """
    positions = scene.state.updated(state).positions if state is not None else scene.positions
    usual = scene.model.default_positions()
    return replace(scene, positions=np.where(np.isfinite(positions), positions, usual))


def _body(api: Any, scene: PlanningScene, name: str, kind: str, color: Color) -> list[Any]:
    """Draw the shapes of a link or object in one color, to show why planning failed, and return the viser
    handles.
    """
    if name in scene.model.links:
        T = kinematic_tree(scene.model).link_pose(scene.positions, name)
        shapes = [(c.shape, T @ c.T_link_shape) for c in scene.model.links[name].collisions]
        return [
            add_part(api, node_name("why", kind, name, str(i)), replace(collision_part(s), color=color), at)
            for i, (s, at) in enumerate(shapes)
        ]
    item = scene.object(name)
    T_world: SE3 = item.T_world_object
    return [
        add_object_shape(api, node_name("why", kind, name, str(i)), shape, T_world @ T, color)
        for i, (shape, T) in enumerate(item.shapes)
    ]
