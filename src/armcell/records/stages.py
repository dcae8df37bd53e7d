"""Time spans of a run's stages, derived from its events."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from armcell.core import Event

_ENDS = {"end", "ended", "done", "finished", "failed", "success"}


@dataclass(frozen=True)
class StageSpan:
    name: str
    begin: float  # [s]
    end: float  # [s]


def stage_name(event: Event) -> str:
    """Return a stage event's name: `data["name"]` or `data["stage"]`, else its text."""
    return str(event.data.get("name") or event.data.get("stage") or event.text)


def ends_stage(event: Event) -> bool:
    """Return True if a stage event marks the end of the stage.

    The phase is `data["phase"]`, by default "begin".
    """
    return str(event.data.get("phase", "begin")).lower() in _ENDS


def stage_spans(events: Iterable[Event], until: float) -> list[StageSpan]:
    """Return the time spans of the stages, in time order.

    A stage ends with its end event, the start of the next stage or `until` [s], whichever comes first. Empty
    spans are omitted.
    """
    spans: list[StageSpan] = []
    name, begin = None, 0.0
    for event in sorted((e for e in events if e.kind == "stage"), key=lambda e: e.time):
        if name is not None:
            spans.append(StageSpan(name, begin, event.time))
        name, begin = (None, 0.0) if ends_stage(event) else (stage_name(event), event.time)
    if name is not None:
        spans.append(StageSpan(name, begin, until))
    return [s for s in spans if s.end - s.begin > 1e-6]
