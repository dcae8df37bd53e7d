"""`PlanningPanel`: motion planning in the browser, from the goal to the execution."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armcell.core import SE3, Explanation
from armcell.viewer.background_jobs import LatestTaskWorker
from armcell.viewer.explanation_view import draw_explanation
from armcell.viewer.motion_preview import AMBER, BLUE, GREEN, GREY, PALE_RED, Ghost, Player
from armcell.viewer.plan_tab import PlanTab, StatesTab
from armcell.viewer.planning_session import PlanningSession
from armcell.viewer.scene_tab import SceneTab
from armcell.viewer.viewer import CellViewer
from armcell.viewer.widgets import Callbacks

if TYPE_CHECKING:
    import viser

CONTROL_M = 0.22  # [m] size of the drag controls
STATUS_COLORS = {"free": GREEN, "collision": PALE_RED, "out of reach": GREY}


class PlanningPanel:
    """Browser user interface of a planning session. Use this panel in a `with` block.

    The panel connects widgets to the session and draws its state. It contains no planning logic.

    Args:
        session: the session to show; the panel closes it.
        folder: folder for saving and loading scenes.
        names: additional host names under which browsers may request the page.
    Raises:
        InputError: the host is not an address of this machine, or no port is free.
    """

    def __init__(
        self,
        session: PlanningSession,
        host: str = "127.0.0.1",
        port: int = 8080,
        title: str | None = None,
        folder: Path | None = None,
        names: Iterable[str] = (),
    ):
        self.session = session
        self.viewer = CellViewer(session.scene, host, port, title, names, starting=True)
        try:
            self._build(folder or Path.cwd())
            self.viewer.open()
        except BaseException:
            self.viewer.close()
            raise

    @property
    def url(self) -> str:
        return self.viewer.url

    def __enter__(self) -> PlanningPanel:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the planning panel and stop its session, its threads and the web server."""
        self.session.close()
        self._player.close()
        self._latest.close()
        self.viewer.close()

    def _build(self, folder: Path) -> None:
        session, server = self.session, self.viewer.server
        self._lock = threading.RLock()
        self._dragging = threading.local()
        self._shown: Explanation | None = None
        self._why: list[Any] = []
        self._result: Any = None
        self._drawn = session.scene
        self._latest = LatestTaskWorker()
        self.goal_ghost = Ghost(server, "goal", session.scene, GREEN)
        self.start_ghost = Ghost(server, "start", session.scene, BLUE)
        self.preview_ghost = Ghost(server, "preview", session.scene, AMBER)
        api = server.scene
        self.goal_control = api.add_transform_controls("/drag/goal", scale=CONTROL_M, depth_test=False)
        self.goal_control.on_update(lambda _: self._latest.submit("goal", self._goal_dragged))
        self.object_control = api.add_transform_controls(
            "/drag/object", scale=CONTROL_M, depth_test=False, visible=False
        )
        self.object_control.on_update(lambda _: self._latest.submit("object", self._object_dragged))
        self.label = api.add_label("/goal_label", "", visible=False)
        callbacks = self.callbacks = Callbacks(session.say, self.refresh)
        gui = server.gui
        tabs = gui.add_tab_group(order=-1)  # above the viewer's own folders
        with tabs.add_tab("Plan"):
            self.plan = PlanTab(gui, session, callbacks, self.play, self.seek)
        with tabs.add_tab("States"):
            self.states = StatesTab(gui, session, callbacks)
        with tabs.add_tab("Scene"):
            self.scene = SceneTab(gui, session, callbacks, folder)
        self._player = Player(self._show_motion, lambda: self.plan.loop.value, self.preview_ghost.hide)
        session.observers.append(self.viewer)
        session.add_listener(lambda _: self.refresh())
        self.refresh()

    # --- dragging: runs in the thread of `LatestTaskWorker`, so that only the newest pose is processed ---
    def _goal_dragged(self) -> None:
        T = _pose_of(self.goal_control)
        self._dragging.what = "goal"  # do not move the control while the user drags it
        try:
            self.callbacks.run(lambda: self.session.set_goal_pose(T))
        finally:
            self._dragging.what = ""

    def _object_dragged(self) -> None:
        name, T = self.scene.dragged, _pose_of(self.object_control)
        if name is None:
            return
        self._dragging.what = "object"
        try:
            self.callbacks.run(
                lambda: self.session.change_scene(lambda now: now.with_object_pose(name, T), f"moved {name}")
            )
        finally:
            self._dragging.what = ""

    # --- the preview ---
    def play(self) -> None:
        """Play the planned motion in the planning panel from the beginning."""
        result = self.session.result
        if result is not None and result.ok and result.trajectory is not None:
            self._player.play(max(result.trajectory.duration, 1e-3))

    def seek(self, t: float) -> None:
        """Show the robot in the planning panel at a time [s] of the planned motion."""
        self._player.seek(t)

    def _show_motion(self, t: float) -> None:
        """Draw the robot in the planning panel at a time [s] of the motion.
        Only the thread of the player may call this method.

        Calls from a second thread could draw an older time last.
        """
        session = self.session
        result = session.result
        if result is None or result.trajectory is None or session.busy == "executing":
            self._player.stop()
            return
        positions = session.positions_at(t)
        with self.viewer.server.atomic():
            self.preview_ghost.place(session.scene, positions)
            if self._player.playing:
                self.plan.show_time(t)
            if session.result is not result:
                self.preview_ghost.hide()

    # --- showing ---
    def refresh(self) -> None:
        """Draw the current state of the session in the planning panel. Any thread may call this method."""
        with self._lock, self.viewer.server.atomic():
            session = self.session
            self.plan.refresh()
            self.states.refresh()
            self.scene.refresh()
            if session.scene is not self._drawn:
                self._drawn = session.scene
                self.viewer.show_scene(session.scene)
            self._draw_states()
            self._place_controls()
            self._draw_result()

    def _draw_states(self) -> None:
        session, goal = self.session, self.session.goal
        for ghost in (self.goal_ghost, self.start_ghost, self.preview_ghost):
            ghost.of_group(session.group)
        if goal.status == "free" and np.allclose(goal.positions, session.scene.positions, atol=1e-3):
            self.goal_ghost.hide()  # the robot itself is at the goal
        else:
            self.goal_ghost.place(session.scene, goal.positions)
        touching = {name for c in goal.contacts for name in (c.body_a, c.body_b)}
        self.goal_ghost.paint(STATUS_COLORS[goal.status], touching)
        if session.start is None:
            self.start_ghost.hide()
        else:
            self.start_ghost.place(session.scene, session.start)
        at = goal.contacts[0].position if goal.contacts else None
        if at is None and goal.T_world_tip is not None:
            at = goal.T_world_tip.translation
        text = goal.contacts[0].describe() if goal.contacts else goal.text
        if self.label.text != text:
            self.label.text = text
        if at is not None:
            self.label.position = np.asarray(at)
        self.label.visible = goal.status != "free" and at is not None

    def _place_controls(self) -> None:
        dragging, session = getattr(self._dragging, "what", ""), self.session
        T = session.goal.T_world_tip
        self.goal_control.visible = T is not None
        if T is not None and dragging != "goal":
            _move(self.goal_control, T)
        name = self.scene.dragged
        self.object_control.visible = name is not None
        if name is not None and dragging != "object":
            _move(self.object_control, session.scene.object(name).T_world_object)

    def _draw_result(self) -> None:
        """Draw the result of planning in the planning panel: the tool path of a new plan, or the explanation
        of a failure.
        """
        session = self.session
        if session.result is not self._result:
            self._result = session.result
            self.preview_ghost.hide()
            self._player.stop()
            if session.result is not None and session.result.ok and session.result.trajectory is not None:
                self.viewer.on_trajectory(0.0, session.result.trajectory)
                self.play()
        if session.busy == "executing":
            self.preview_ghost.hide()
        if session.explanation is not self._shown:
            for handle in self._why:
                handle.remove()
            self._shown, self._why = session.explanation, []
            if session.explanation is not None:
                self._why = draw_explanation(self.viewer.server, session.scene, session.explanation)


def _pose_of(control: viser.TransformControlsHandle) -> SE3:
    return SE3.from_quat_wxyz(np.array(control.position), np.array(control.wxyz))  # copy viser's arrays


def _move(control: viser.TransformControlsHandle, T: SE3) -> None:
    if not _pose_of(control).isclose(T, 1e-6, 1e-6):
        control.wxyz, control.position = T.quat_wxyz, T.translation
