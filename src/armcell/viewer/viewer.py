"""`CellViewer`: observer that shows a cell in the browser, with its status panel.

The panel shows the cell's name, time, stage, last event, grippers and visibility.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, Event, JointState, JointTrajectory, StateSample
from armcell.kinematics import kinematic_tree
from armcell.scene import CollisionObject, PlanningScene, extent
from armcell.viewer.geometry import add_link, add_object_shape, node_name
from armcell.viewer.server import start_page

if TYPE_CHECKING:
    import viser
    from viser import GuiApi

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)
UPDATE_HZ = 30.0
"""Update rate in wall time; samples between two updates are skipped, the last one is always shown."""
PATH_SAMPLES = 80
PATH_COLOR = (0, 114, 178)


class StatusPanel:
    """Status panel of the viewer.
    It has read-only fields, and checkboxes that show or hide parts of the view.

    Args:
        gui: viser's GUI API.
        title: name of the cell.
        grippers: gripper names; each gets one field.
        on_show: called with "collision" or "path" and with the new visibility.
    """

    def __init__(
        self, gui: GuiApi, title: str, grippers: Iterable[str], on_show: Callable[[str, bool], None]
    ):
        gui.set_panel_label(title)
        with gui.add_folder("Status"):
            self.cell = gui.add_text("Cell", title, disabled=True)
            self.time = gui.add_text("Time", "0.00 s", disabled=True)
            self.stage = gui.add_text("Stage", "-", disabled=True)
            self.event = gui.add_text("Last event", "-", disabled=True, multiline=True)
            self.grippers = {name: gui.add_text(f"Gripper {name}", "-", disabled=True) for name in grippers}
        with gui.add_folder("Show"):
            self._boxes = {
                "collision": gui.add_checkbox("Collision shapes", False),
                "path": gui.add_checkbox("Planned path", True),
            }
        for what, box in self._boxes.items():
            box.on_update(lambda _, what=what, box=box: on_show(what, box.value))

    def shows(self, what: str) -> bool:
        return self._boxes[what].value

    def update(self, sample: StateSample | None, events: list[Event]) -> None:
        """Show new events and the latest state of the cell in the status panel.

        The stage name comes from the event's `data["name"]` or `data["stage"]`, else from its text.
        """
        for event in events:
            if event.kind == "stage":
                self.stage.value = str(event.data.get("name") or event.data.get("stage") or event.text)
            self.event.value = f"{event.time:.2f} s  {event.kind}: {event.text}"
        if sample is None:
            return
        self.time.value = f"{sample.time:.2f} s"
        for name, field in self.grippers.items():
            width, force = sample.gripper_width.get(name), sample.gripper_force.get(name)
            known = [] if width is None else [f"{1000 * width:.1f} mm"]
            known += [] if force is None else [f"{force:.1f} N"]
            field.value = ", ".join(known) or "-"


class CellViewer:
    """Browser page that shows a cell: its robot, objects, planned tool paths and status.

    The page is served at `url`. The observer callbacks `on_...` only queue their data. The viewer's own
    thread computes the kinematics and sends the updates, so the thread that steps the physics never waits.

    Args:
        scene: robot and objects of the cell; its state is shown until the first sample arrives.
        host: address to listen on.
        port: first port to try; if it is in use, the next free port is taken (see `url`).
        title: title of the panel; the robot's name by default.
        names: additional host names under which browsers may request the page.
        starting: show a "starting" page until `open` is called, for pages that extend the view.
    Raises:
        InputError: the host is not an address of this machine, or no port is free.
    """

    def __init__(
        self, scene: PlanningScene, host: str = "127.0.0.1", port: int = 8080, title: str | None = None,
        names: Iterable[str] = (), starting: bool = False,
    ):  # fmt: skip
        self._scene = scene
        self._tree = kinematic_tree(scene.model)
        self._tips = _tool_links(scene)
        self._q = np.array(scene.positions)
        self.page = start_page(host, port, title or scene.model.name, names)
        self._server = self.page.viser
        if port not in (0, self.port):
            logger.warning("port %d is in use: the viewer is at port %d", port, self.port)

        self.link_frames: dict[str, viser.FrameHandle] = {}
        self.object_frames: dict[str, viser.FrameHandle] = {}
        self._collisions: list[Any] = []
        self._paths: list[Any] = []
        try:
            self._build()
        except BaseException:  # e.g. an unreadable visual mesh: stop the server before raising
            self.page.stop()
            raise
        self._panel = StatusPanel(
            self._server.gui, title or scene.model.name, scene.model.grippers, self._shown
        )

        self._wake = threading.Condition()
        self._sample: StateSample | None = None
        self._events: list[Event] = []
        self._trajectory: JointTrajectory | None = None
        self._closing = False
        self._worker = threading.Thread(target=self._run, name="armcell-viewer", daemon=True)
        self._worker.start()
        if not starting:
            self.open()

    @property
    def url(self) -> str:
        """Return the URL of the cell viewer, including the page's token, for a browser on this machine."""
        return self.page.url

    @property
    def port(self) -> int:
        return self.page.port

    def open(self) -> None:
        """Open the cell viewer: from now on, its page is served to browsers."""
        self.page.open()

    @property
    def server(self) -> viser.ViserServer:
        """Return the viser server of the cell viewer, with which
        nodes and widgets can be added to the page.
        """
        return self._server

    # --- Observer: called from the thread that steps the cell ---
    def on_state(self, sample: StateSample) -> None:
        with self._wake:
            self._sample = sample
            self._wake.notify()

    def on_event(self, event: Event) -> None:
        with self._wake:
            self._events.append(event)
            self._wake.notify()

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        with self._wake:
            self._trajectory = trajectory
            self._wake.notify()

    def close(self) -> None:
        """Close the cell viewer: stop its server and threads and free the port. Further calls have no
        effect.
        """
        with self._wake:
            if self._closing:
                return
            self._closing = True
            self._wake.notify()
        self._worker.join(timeout=5.0)
        self.page.stop()

    def __enter__(self) -> CellViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- building ---
    def _build(self) -> None:
        api, model = self._server.scene, self._scene.model
        api.set_up_direction("+z")
        for name, link in model.links.items():
            path = node_name("robot", name)
            self.link_frames[name] = api.add_frame(path, show_axes=False)
            self._collisions += add_link(api, path, link)[1]
        for name in (*self._scene.objects, *self._scene.attached):
            self._draw_object(self._scene.object(name))
        self._place_links()
        center, radius = extent(self._scene)
        camera = self._server.initial_camera
        camera.look_at = center
        camera.position = center + radius * np.array([2.0, 1.45, 1.05])
        camera.fov = float(np.deg2rad(45.0))

    def _draw_object(self, item: CollisionObject) -> None:
        api, path = self._server.scene, node_name("objects", item.name)
        self.object_frames[item.name] = api.add_frame(path, show_axes=False)
        for i, (shape, T) in enumerate(item.shapes):
            add_object_shape(api, f"{path}/{i}", shape, T, item.color)
        _place(self.object_frames[item.name], item.T_world_object)

    def show_scene(self, scene: PlanningScene) -> None:
        """Show a new scene with the same robot in the cell viewer,
        including the objects and the robot state.
        """
        with self._wake:  # discard samples of the old scene
            self._sample = None
            old, self._scene = self._scene, scene
        with self._server.atomic():
            now = {name: scene.object(name) for name in (*scene.objects, *scene.attached)}
            for name in [n for n in self.object_frames if n not in now]:
                self.object_frames.pop(name).remove()
            for name, item in now.items():
                before = old.object(name) if name in (*old.objects, *old.attached) else None
                if before is None or before.shapes is not item.shapes or before.color != item.color:
                    if name in self.object_frames:
                        self.object_frames.pop(name).remove()
                    self._draw_object(item)
                _place(self.object_frames[name], item.T_world_object)
            self._q = np.array(scene.positions)
            self._place_links()

    def _shown(self, what: str, visible: bool) -> None:
        """Handle a click on a checkbox that shows or hides a part of the view in the cell viewer."""
        for handle in tuple({"collision": self._collisions, "path": self._paths}[what]):
            handle.visible = visible

    # --- updating: runs in the viewer's own thread ---
    def _run(self) -> None:
        while True:
            with self._wake:
                while not (self._closing or self._sample or self._events or self._trajectory):
                    self._wake.wait()
                if self._closing:
                    return
                sample, events, trajectory = self._sample, self._events, self._trajectory
                self._sample, self._events, self._trajectory = None, [], None
            begin = time.monotonic()
            try:
                with self._server.atomic():
                    self._show(sample, events, trajectory)
            except Exception:  # an error in the view must not end the run
                logger.exception("the viewer could not show an update")
            rest = 1 / UPDATE_HZ - (time.monotonic() - begin)
            with self._wake:
                self._wake.wait_for(lambda: self._closing, timeout=max(0.0, rest))

    def _show(
        self, sample: StateSample | None, events: list[Event], trajectory: JointTrajectory | None
    ) -> None:
        if sample is not None:
            self._q = _merged(self._scene, self._q, sample.joints)
            self._place_links()
            for name, T in sample.object_poses.items():
                if name in self.object_frames:
                    _place(self.object_frames[name], T)
        if trajectory is not None:
            self._draw_path(trajectory)
        self._panel.update(sample, events)

    def _place_links(self) -> None:
        for name, T in zip(self._tree.link_names, self._tree.link_transforms(self._q), strict=True):
            _place(self.link_frames[name], SE3.from_matrix(T))
        for name, body in self._scene.attached.items():
            if name in self.object_frames:
                T = self._tree.link_pose(self._q, body.link) @ body.T_link_object
                _place(self.object_frames[name], T)

    def _draw_path(self, trajectory: JointTrajectory) -> None:
        """Draw the planned path of each moving tool in the cell viewer, as a line in the world frame.

        The new lines replace those of the previous plan.
        """
        for handle in self._paths:
            handle.remove()
        self._paths = []
        times = np.linspace(trajectory.times[0], trajectory.times[-1], PATH_SAMPLES)
        qs = [
            _merged(self._scene, self._q, JointState(trajectory.joint_names, trajectory.sample(t)[0]))
            for t in times
        ]
        Ts = np.array([self._tree.link_transforms(q) for q in qs])  # (samples, links, 4, 4)
        for tip in self._tips:
            points = Ts[:, self._tree.link_index[tip], :3, 3]
            if np.ptp(points, axis=0).max() < 1e-4:  # this tool does not move
                continue
            self._paths.append(
                self._server.scene.add_line_segments(
                    node_name("path", tip),
                    np.stack([points[:-1], points[1:]], axis=1),
                    PATH_COLOR,
                    thickness=0.004,
                    visible=self._panel.shows("path"),
                )
            )


def _merged(scene: PlanningScene, q: Array, joints: JointState) -> Array:
    """Return a copy of `q` (dof,) for the cell viewer,
    in which the actuated joints have the positions from `joints`.
    """
    q, at = q.copy(), {name: i for i, name in enumerate(scene.model.joint_names)}
    for name, value in zip(joints.joint_names, joints.positions, strict=True):
        if name in at:
            q[at[name]] = value
    return q


def _place(frame: Any, T_world_frame: SE3) -> None:
    frame.wxyz = T_world_frame.quat_wxyz
    frame.position = T_world_frame.translation


def _tool_links(scene: PlanningScene) -> tuple[str, ...]:
    """Return the links whose paths the cell viewer draws: the TCPs of the grippers, or the tip links of the
    chains if there are no grippers.
    """
    tips = [g.tcp_link for g in scene.model.grippers.values()]
    tips = tips or [g.tip_link for g in scene.model.groups.values() if g.tip_link]
    return tuple(dict.fromkeys(tips))
