"""Replay of a recorded run in the browser: time slider, play and pause, jumps to stages."""

from __future__ import annotations

import bisect
from collections.abc import Iterable
from typing import Any

from armcell.core import Event
from armcell.records.reader import Record, scenes_of, stage_spans
from armcell.scene import PlanningScene
from armcell.viewer.motion_preview import Player
from armcell.viewer.viewer import CellViewer
from armcell.viewer.widgets import Callbacks, paragraph, without_callbacks

SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5")
NO_STAGE = "-"


class ReplayView:
    """Browser page at `url` that replays a recorded run. Use it in a `with` block.

    Args:
        scene: the cell at the start of the run.
        names: additional host names under which browsers may request the page.
    Raises:
        InputError: the host is not an address of this machine, or no port is free.
    """

    def __init__(
        self, record: Record, scene: PlanningScene, host: str = "127.0.0.1", port: int = 8080,
        names: Iterable[str] = (),
    ):  # fmt: skip
        self.record = record
        self._begin, self._end = record.states[0].time, record.states[-1].time
        self._scenes = scenes_of(record, scene)
        self._plans = [at for at, _ in record.trajectories]
        self._at_scene = self._at_plan = 0
        self._from = self._begin
        name = record.metadata.get("cell", record.file.parent.name)
        self.viewer = CellViewer(scene, host, port, f"{name}, recorded", names, starting=True)
        try:
            self._build()
        except BaseException:
            self.viewer.close()
            raise
        self._player = Player(self._show_played, lambda: self.loop.value, self._stopped)
        self.seek(self._begin)
        self.viewer.open()

    @property
    def url(self) -> str:
        return self.viewer.url

    def _build(self) -> None:
        gui = self.viewer.server.gui
        spans = stage_spans(self.record.events, self._end)
        self._stages = {f"{s.begin:.2f} s  {s.name}": s.begin for s in spans}
        with gui.add_folder("Replay", order=-1):
            self.time = gui.add_slider(
                "Time [s]", self._begin, max(self._end, self._begin + 0.01), 0.01, self._begin
            )
            self.play_button = gui.add_button("Play", color="green")
            self.speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1")
            self.loop = gui.add_checkbox("Again at the end", False)
            self.stage = gui.add_dropdown("Go to stage", (NO_STAGE, *self._stages), initial_value=NO_STAGE)
            self.note = gui.add_html(self._words())
        run = Callbacks(self._say, lambda: None)
        self.time.on_update(run.wrap(lambda: self.seek(float(self.time.value))))
        self.play_button.on_click(run.wrap(self.toggle))
        self.speed.on_update(run.wrap(self._speed_changed))
        self.stage.on_update(run.wrap(self._to_stage))

    def _words(self) -> str:
        result: Any = self.record.result or {}
        said = [f"cut off: {self.record.cut}"] if self.record.cut else []
        if result:
            said.append("success" if result.get("success") else f"failed: {result.get('message')}")
        said.append(f"{len(self.record.states)} states, {len(self.record.events)} events")
        return paragraph("\n".join(said))

    def _say(self, text: str) -> None:
        self.note.content = paragraph(text, "red")

    # --- time ---
    def seek(self, time: float) -> None:
        """Stop the replay and show the state of the recorded run at a time [s]."""
        self._stopped()
        self._player.stop()
        self.show(time)

    def toggle(self) -> None:
        """Pause the replay if it is playing; otherwise, continue from the time on the slider. At the end, the
        replay starts again from the beginning.
        """
        if self._player.playing:
            self.seek(float(self.time.value))
            return
        at = float(self.time.value)
        self._from = self._begin if at >= self._end - 0.01 else at
        self.play_button.label = "Pause"
        self._player.play(max((self._end - self._from) / float(self.speed.value), 1e-3))

    def _speed_changed(self) -> None:
        if self._player.playing:
            self.seek(float(self.time.value))
            self.toggle()

    def _to_stage(self) -> None:
        if self.stage.value in self._stages:
            self.seek(self._stages[self.stage.value])

    def _show_played(self, seconds: float) -> None:
        if seconds == 0.0 and self.loop.value:
            self._from = self._begin
        self.show(min(self._from + seconds * float(self.speed.value), self._end))

    def _stopped(self) -> None:
        self.play_button.label = "Play"

    def show(self, time: float) -> None:
        """Draw the replayed cell as it was at a time [s] of the record."""
        with without_callbacks():
            self.time.value = round(time, 2)
        at = max(bisect.bisect_right([t for t, _ in self._scenes], time + 1e-9) - 1, 0)
        if at != self._at_scene:
            self._at_scene = at
            self.viewer.show_scene(self._scenes[at][1])
        plan = bisect.bisect_right(self._plans, time + 1e-9)
        if plan != self._at_plan and plan > 0:
            self.viewer.on_trajectory(*self.record.trajectories[plan - 1])
        self._at_plan = plan
        for event in self._said_until(time):
            self.viewer.on_event(event)
        self.viewer.on_state(self.record.states[self.record.index_at(time + 1e-9)].sample())

    def _said_until(self, time: float) -> list[Event]:
        """Return the recorded events that the viewer shows at a time [s] of the replayed run: the latest
        stage event, and the latest event after it, if any.
        """
        before = [e for e in self.record.events if e.time <= time + 1e-9]
        stages = [e for e in before if e.kind == "stage"]
        return [*stages[-1:], *(e for e in before[-1:] if e.kind != "stage")]

    def close(self) -> None:
        self._player.close()
        self.viewer.close()

    def __enter__(self) -> ReplayView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
