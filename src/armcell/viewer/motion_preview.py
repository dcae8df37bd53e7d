"""Preview in the browser: translucent robot copy (`Ghost`), and player of a motion in real time."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
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
logger = logging.getLogger(__name__)
FRAME = 1 / 30  # [s]
PAUSE = 0.5  # [s] at the end, before the next repetition


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


class Player:
    """Player for a motion preview.
    It calls `show` in real time with times [s] from 0 to the duration of the motion.

    Args:
        show: draws the motion at a time [s]; called from the player's thread.
        loop: returns True to restart at the end.
        end: called at the end if the player does not restart.
    """

    def __init__(self, show: Callable[[float], None], loop: Callable[[], bool], end: Callable[[], None]):
        self._show, self._loop, self._end = show, loop, end
        self._wake = threading.Condition()
        self._duration: float | None = None
        self._at: float | None = None  # time [s] to show once
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="armcell-preview", daemon=True)
        self._thread.start()

    def play(self, duration: float) -> None:
        """Play the preview of a motion from the beginning. The motion takes `duration` [s]."""
        with self._wake:
            self._duration = duration
            self._wake.notify()

    def seek(self, t: float) -> None:
        """Stop the player of the preview and show the motion at a time [s]."""
        with self._wake:
            self._duration, self._at = None, t
            self._wake.notify()

    def stop(self) -> None:
        with self._wake:
            self._duration = None
            self._wake.notify()

    @property
    def playing(self) -> bool:
        return self._duration is not None

    def close(self) -> None:
        with self._wake:
            self._closing, self._duration = True, None
            self._wake.notify()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(
                    lambda: self._closing or self._duration is not None or self._at is not None
                )
                if self._closing:
                    return
                duration, at, self._at = self._duration, self._at, None
            try:
                if duration is not None:
                    self._once(duration)
                elif at is not None:
                    self._show(at)
            except Exception:
                logger.exception("could not show the motion")
                self.stop()

    def _once(self, duration: float) -> None:
        began = time.monotonic()
        while self._duration == duration:
            t = time.monotonic() - began
            if t >= duration:
                self._show(duration)
                self._pause(PAUSE, duration)
                if self._duration == duration and not self._loop():
                    self.stop()
                    self._end()
                return
            self._show(t)
            self._pause(FRAME, duration)

    def _pause(self, seconds: float, duration: float) -> None:
        with self._wake:
            self._wake.wait_for(lambda: self._duration != duration, timeout=seconds)
