"""The "States" tab of the planning panel: goal and start state by sliders or by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from armcell.core import JointState
from armcell.viewer.planning_session import PlanningSession
from armcell.viewer.widgets import Callbacks, without_callbacks

if TYPE_CHECKING:
    from viser import GuiApi

GOAL, START = "goal", "start"
NONE = "-"
WIDE = 2 * np.pi  # [rad] slider range, to each side, of a joint without limits
STEP = 0.1  # [deg or mm]


class StatesTab:
    """Joint sliders of the "States" tab, which set the goal or the start state in degrees and millimeters."""

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
        """Return the unit in which the "States" tab shows a joint,
        and the factor for converting radians or meters to that unit.
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
