"""Translucent copy of the robot that shows a goal, a start state or a planned motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from armcell.core import SE3, Octree, PointCloud
from armcell.kinematics import kinematic_tree
from armcell.scene import PlanningScene
from armcell.viewer.geometry import Color, add_part, collision_part, node_name, shape_part

if TYPE_CHECKING:
    import viser

GREEN: Color = (0.15, 0.65, 0.35, 0.45)
RED: Color = (0.85, 0.10, 0.10, 0.85)
PALE_RED: Color = (0.90, 0.45, 0.40, 0.40)
GREY: Color = (0.45, 0.45, 0.45, 0.40)
BLUE: Color = (0.15, 0.40, 0.80, 0.35)
AMBER: Color = (0.95, 0.60, 0.05, 0.55)


class Ghost:
    """Translucent robot (ghost) that shows a state in the viewer, with its collision shapes and attached
    objects. It is hidden until the first call of `place`.

    Args:
        name: name of the ghost's node in viser's scene.
    """

    def __init__(self, server: viser.ViserServer, name: str, scene: PlanningScene, color: Color):
        self._server, self._name, self._model, self._color = server, name, scene.model, color
        self._tree = kinematic_tree(scene.model)
        self._frames: dict[str, Any] = {}
        self._parts: dict[str, list[Any]] = {}
        self._held: dict[str, Any] = {}  # attached bodies that are currently drawn
        self._moved = frozenset(scene.model.links)
        self.root = server.scene.add_frame(node_name(name), show_axes=False, visible=False)
        for link in scene.model.links.values():
            shapes = [(collision_part(c.shape), c.T_link_shape) for c in link.collisions]
            if shapes:
                self._draw(link.name, shapes)

    def _draw(self, body: str, shapes: list[Any]) -> None:
        path = node_name(self._name, body)
        self._frames[body] = self._server.scene.add_frame(path, show_axes=False)
        self._parts[body] = [
            add_part(self._server.scene, f"{path}/{i}", replace(part, color=self._color), T)
            for i, (part, T) in enumerate(shapes)
        ]

    def of_group(self, group: str) -> None:
        """Show only the links of the ghost robot that the planning group moves."""
        columns = set(self._model.columns(self._model.group(group).joint_names))
        tree = self._tree
        self._moved = frozenset(
            name
            for name in tree.link_names
            if any(tree.kind[j] != 0 and int(tree.column[j]) in columns for j in tree.path_to(name))
        )

    def place(self, scene: PlanningScene, positions: ArrayLike) -> None:
        """Show the ghost robot at joint positions (dof,), together with the objects that are attached in
        `scene`.
        """
        if dict(scene.attached) != self._held:
            self._draw_held(scene)
        Ts = self._tree.link_transforms(positions)
        for name, frame in self._frames.items():
            body = scene.attached.get(name)
            link = name if body is None else body.link
            T = SE3.from_matrix(Ts[self._tree.link_index[link]])
            if body is not None:
                T = T @ body.T_link_object
            frame.wxyz, frame.position = T.quat_wxyz, T.translation
            frame.visible = link in self._moved
        self.root.visible = True

    def _draw_held(self, scene: PlanningScene) -> None:
        for name in self._held:
            self._frames.pop(name).remove()
            self._parts.pop(name)
        self._held = dict(scene.attached)
        for name, body in self._held.items():
            solid = [(s, T) for s, T in body.object.shapes if not isinstance(s, (PointCloud, Octree))]
            self._draw(name, [(shape_part(shape, self._color), T) for shape, T in solid])

    def paint(self, color: Color, marked: Iterable[str] = (), mark: Color = RED) -> None:
        """Set the color of all bodies of the ghost robot, and a second color for the `marked` bodies."""
        self._color, marked = color, set(marked)
        for name, parts in self._parts.items():
            r, g, b, alpha = mark if name in marked else color
            for part in parts:
                part.color = (round(255 * r), round(255 * g), round(255 * b))
                part.opacity = alpha

    def hide(self) -> None:
        self.root.visible = False
