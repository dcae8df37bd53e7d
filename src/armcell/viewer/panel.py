"""The panel beside the view: the cell's name, time, stage, last event, grippers and what to show."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from armcell.core import Event, StateSample

if TYPE_CHECKING:
    from viser import GuiApi


class StatusPanel:
    """Read-only fields and the show/hide checkboxes.

    Args:
        gui: viser's.
        title: the cell's name.
        grippers: names, one field each.
        on_show: called with "collision" or "path" and whether it is to be seen.
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
        """Write what is new; a stage's name is its event's `data["name"]` or `["stage"]`, else its text."""
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
