"""The "Plan" and "States" tabs of the planning panel: request settings, goal and start state, result."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from armcell.core import Explanation, JointState, Suggestion
from armcell.core.results import TRIED
from armcell.planning import pipelines
from armcell.viewer.planning_session import PlanningSession
from armcell.viewer.session_goal import MOTIONS
from armcell.viewer.widgets import Callbacks, paragraph, without_callbacks

if TYPE_CHECKING:
    from viser import GuiApi


GOAL, START = "goal", "start"

NONE = "-"

WIDE = 2 * np.pi  # [rad] slider range, to each side, of a joint without limits

STEP = 0.1  # [deg or mm]


class StatesTab:
    """The tab "States" beside the "Plan" tab, with joint sliders that set the goal or the start state in
    degrees and millimeters.
    """

    def __init__(self, gui: GuiApi, session: PlanningSession, callbacks: Callbacks):
        self._gui, self._session, self._on = gui, session, callbacks.wrap
        on = callbacks.wrap
        self.of = gui.add_dropdown("Of the", (GOAL, START))
        self.of.on_update(on(self.refresh))
        names: list[str] = [NONE]
        self.named: Any = gui.add_dropdown("Named state", names)
        self.named.on_update(on(self._choose))
        self.random = gui.add_button("Random valid")
        self.random.on_click(on(lambda: session.set_random(self.is_start)))
        self.present = gui.add_button("Where the robot is")
        self.present.on_click(on(lambda: session.set_current_state(self.is_start)))
        self.folder = gui.add_folder("Joints")
        self.sliders: dict[str, Any] = {}
        self._group = ""
        self.refresh()

    @property
    def is_start(self) -> bool:
        return self.of.value == START

    def _choose(self) -> None:
        if self.named.value != NONE:
            self._session.set_named(self.named.value, self.is_start)

    def _slid(self, name: str) -> None:
        value = self.sliders[name].value / self._unit(name)[1]
        joint = self._session.scene.model.joint(name)
        value = float(np.clip(value, joint.limits.lower, joint.limits.upper))  # a slider step may exceed it
        self._session.set_positions(JointState((name,), np.array([value])), self.is_start)

    def _unit(self, name: str) -> tuple[str, float]:
        """Return the unit in which the tab "States" beside the "Plan" tab shows a joint, and the factor for
        converting radians or meters to that unit.
        """
        slides = self._session.scene.model.joint(name).type == "prismatic"
        return ("mm", 1000.0) if slides else ("deg", 180.0 / np.pi)

    def refresh(self) -> None:
        session = self._session
        with without_callbacks():
            if session.group != self._group:
                self._build()
            q = session.start_positions if self.is_start else session.goal.positions
            at = JointState(session.scene.model.joint_names, q)
            for name, slider in self.sliders.items():
                shown = round(at[name] * self._unit(name)[1], 1)
                value = float(np.clip(shown, slider.min, slider.max))
                if abs(slider.value - value) > STEP / 2:
                    slider.value = value
            self.named.value = next((n for n in session.state_names if self._stands(n, at)), NONE)

    def _stands(self, name: str, at: JointState) -> bool:
        state = self._session.scene.model.named_state(self._session.group, name)
        return bool(np.allclose(at.reindexed(state.joint_names).positions, state.positions, atol=1e-3))

    def _build(self) -> None:
        session, model = self._session, self._session.scene.model
        self._group = session.group
        self.named.options = (NONE, *session.state_names)
        for slider in self.sliders.values():
            slider.remove()
        self.sliders = {}
        with self.folder:
            for name in session.joint_names:
                unit, scale = self._unit(name)
                limits = model.joint(name).limits
                low = scale * (limits.lower if np.isfinite(limits.lower) else -WIDE)
                high = scale * (limits.upper if np.isfinite(limits.upper) else WIDE)
                low, high = np.ceil(low * 10) / 10, np.floor(high * 10) / 10  # whole steps
                slider = self._gui.add_slider(
                    f"{name} [{unit}]", float(low), float(high), STEP, float(np.clip(0.0, low, high))
                )
                slider.on_update(self._on(self._mover(name)))
                self.sliders[name] = slider

    def _mover(self, name: str) -> Callable[[], None]:
        return lambda: self._slid(name)


COLORS = {"free": "#2b8a3e", "collision": "#c92a2a", "out of reach": "#868e96"}

LABEL = 44  # characters of a suggestion on its button; the tooltip has the full text


class PlanTab:
    """Widgets of the "Plan" tab.
    They show the settings and the result of a planning session; `refresh` updates them.

    Args:
        play: starts the preview from the beginning.
        seek: shows the planned motion at a time [s].
    """

    def __init__(
        self,
        gui: GuiApi,
        session: PlanningSession,
        callbacks: Callbacks,
        play: Callable[[], None],
        seek: Callable[[float], None],
    ):
        self._gui, self._session, self._callbacks = gui, session, callbacks
        self._shown: Explanation | None = None
        s, on = session.settings, callbacks.wrap
        self.group = gui.add_dropdown("Group", session.groups, initial_value=session.group)
        self.group.on_update(on(lambda: session.set_group(self.group.value)))
        self.motion = gui.add_dropdown("Motion", MOTIONS, initial_value=s.motion)
        self.motion.on_update(on(lambda: session.change_settings(motion=self.motion.value)))
        self.goal = gui.add_html("")
        self.plan = gui.add_button("Plan", color="blue")
        self.plan.on_click(on(session.plan))
        self.execute = gui.add_button("Execute", color="green", disabled=True)
        self.execute.on_click(on(session.execute))
        self.stop = gui.add_button("Stop", color="red", disabled=True)
        self.stop.on_click(on(session.stop))
        self.result = gui.add_html("")
        self.help = gui.add_folder("What would help", visible=False)
        self.suggestions: list[Any] = []
        self.details_folder = gui.add_folder("Details", expand_by_default=False, visible=False)
        with self.details_folder:
            self.details = gui.add_html("")
        with gui.add_folder("Preview"):
            self.preview = gui.add_button("Preview", disabled=True)
            self.preview.on_click(on(play))
            self.loop = gui.add_checkbox("Loop", False)
            self.time = gui.add_slider("Time [s]", 0.0, 1.0, 0.01, 0.0, disabled=True)
            self.time.on_update(on(lambda: seek(self.time.value)))
        with gui.add_folder("Planner"):
            self._planner_widgets(gui, session, on)

    def _planner_widgets(self, gui: GuiApi, session: PlanningSession, on: Callable[..., Any]) -> None:
        s = session.settings
        self.pipeline = gui.add_dropdown("Pipeline", tuple(pipelines), initial_value=s.pipeline)
        self.pipeline.on_update(on(self._choose_pipeline))
        self.planner = gui.add_dropdown("Planner", tuple(pipelines[s.pipeline]), initial_value=s.planner)
        self.planner.on_update(on(lambda: session.change_settings(planner=self.planner.value)))
        self.planning_time = gui.add_number(
            "Planning time [s]", s.planning_time, min=0.1, max=300.0, step=0.1
        )
        self.planning_time.on_update(
            on(lambda: session.change_settings(planning_time=float(self.planning_time.value)))
        )
        self.attempts = gui.add_number("Attempts", s.attempts, min=1, max=64, step=1)
        self.attempts.on_update(on(lambda: session.change_settings(attempts=int(self.attempts.value))))
        self.velocity = gui.add_slider("Velocity", 0.01, 1.0, 0.01, s.velocity_scaling)
        self.velocity.on_update(on(lambda: session.change_settings(velocity_scaling=self.velocity.value)))
        self.acceleration = gui.add_slider("Acceleration", 0.01, 1.0, 0.01, s.acceleration_scaling)
        self.acceleration.on_update(
            on(lambda: session.change_settings(acceleration_scaling=self.acceleration.value))
        )

    def _choose_pipeline(self) -> None:
        """Select a planning pipeline in the "Plan" tab.
        The current planner stays selected if the new pipeline offers it.

        Otherwise select RRTConnect, or else the pipeline's first planner.
        """
        known = tuple(pipelines[self.pipeline.value])
        planner = next((p for p in (self._session.settings.planner, "RRTConnect") if p in known), known[0])
        self._session.change_settings(pipeline=self.pipeline.value, planner=planner)

    # --- showing ---
    def refresh(self) -> None:
        with without_callbacks():
            self._refresh_settings()
            self._refresh_result()

    def _refresh_settings(self) -> None:
        session, s = self._session, self._session.settings
        known = tuple(pipelines[s.pipeline])
        if self.planner.options != known:
            self.planner.options = known
        _set(self.group, session.group)
        _set(self.motion, s.motion)
        _set(self.pipeline, s.pipeline)
        _set(self.planner, s.planner)
        _set(self.planning_time, s.planning_time)
        _set(self.attempts, s.attempts)
        _set(self.velocity, s.velocity_scaling)
        _set(self.acceleration, s.acceleration_scaling)
        goal = session.goal
        words = goal.text if goal.status != "collision" else f"in collision: {goal.text}"
        _write(self.goal, paragraph(f"Goal {words}", COLORS[goal.status], bold=True))

    def _refresh_result(self) -> None:
        session, result = self._session, self._session.result
        moving = result is not None and result.ok and result.trajectory is not None
        busy = session.busy
        why = session.why_not_executable
        for widget, disabled in (
            (self.plan, busy in ("planning", "executing")),
            (self.execute, bool(why)),
            (self.stop, not busy),
            (self.preview, not moving),
            (self.time, not moving),
        ):
            if widget.disabled != disabled:
                widget.disabled = disabled
        if moving and result is not None and result.trajectory is not None:
            longest = math.ceil(max(result.trajectory.duration, 0.01) * 100) / 100  # whole slider steps
            if self.time.max != longest:
                self.time.value, self.time.max = 0.0, longest
        _write(self.result, self._words(why))
        self._show_explanation(session.explanation)

    def _words(self, why_not: str) -> str:
        session, result = self._session, self._session.result
        explanation = session.explanation
        if explanation is not None and not explanation.code.ok:
            return paragraph(explanation.code.name, COLORS["collision"], bold=True) + paragraph(
                explanation.summary
            )
        text = session.message
        if session.busy == "explaining":
            text += "\nlooking for what would help"
        if result is None or not result.ok or result.path is None or result.trajectory is None:
            return paragraph(text)
        numbers = (
            f"planned by {result.planner_id} in {result.planning_time * 1000:.0f} ms\n"
            f"duration {result.trajectory.duration:.2f} s, length {result.path.length:.2f} rad\n"
            f"clearance {result.min_clearance * 1000:.1f} mm, {len(result.path.waypoints)} waypoints"
        )
        said = "" if text == "planned" else text
        note = f"cannot be executed: {why_not}" if why_not and not session.busy else ""
        more = "\n".join(t for t in (said, note) if t)
        return paragraph("SUCCESS", COLORS["free"], bold=True) + paragraph(numbers) + paragraph(more)

    def _show_explanation(self, explanation: Explanation | None) -> None:
        """Offer each suggested change of a failed plan as a button in the "Plan" tab. A click applies the
        change and plans again.
        """
        if explanation is self._shown:
            return
        self._shown = explanation
        for button in self.suggestions:
            button.remove()
        self.suggestions = []
        offered = explanation.suggestions if explanation is not None else ()
        self.help.visible = bool(offered)
        details = explanation.details if explanation is not None else ()
        self.details_folder.visible = bool(details)
        _write(self.details, paragraph("\n".join(details)))
        with self.help:
            for suggestion in offered:
                text = suggestion.text + TRIED[suggestion.works]
                label = text if len(text) <= LABEL else text[: LABEL - 1] + "…"
                button = self._gui.add_button(label, hint=text, color="gray")
                button.on_click(self._callbacks.wrap(lambda s=suggestion: self._apply(s)))
                self.suggestions.append(button)

    def _apply(self, suggestion: Suggestion) -> None:
        self._session.apply(suggestion)
        self._session.plan()

    def show_time(self, t: float) -> None:
        """Move the time slider of the "Plan" tab to the time [s] that the preview shows,
        without triggering a seek.
        """
        with without_callbacks():
            self.time.value = min(round(t, 2), self.time.max)


def _write(widget: Any, content: str) -> None:
    if widget.content != content:
        widget.content = content


def _set(widget: Any, value: Any) -> None:
    if widget.value != value:
        widget.value = value
