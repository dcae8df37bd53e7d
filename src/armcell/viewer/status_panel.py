"""Status panel of the viewer: cell name, time, stage, last event, grippers, visibility."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from armcell.core import Event, StateSample

if TYPE_CHECKING:
    from viser import GuiApi


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
