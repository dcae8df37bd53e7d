"""Which stage ran when, from the events of a run."""

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
    """`data["name"]` or `data["stage"]` of a stage event, else its text."""
    return str(event.data.get("name") or event.data.get("stage") or event.text)


def ends_stage(event: Event) -> bool:
    """Whether a stage event tells of an end: by `data["phase"]`, which otherwise is "begin"."""
    return str(event.data.get("phase", "begin")).lower() in _ENDS


def stage_spans(events: Iterable[Event], until: float) -> list[StageSpan]:
    """The stages in time order. One begins with its event and ends with its end event, the next stage's
    beginning or `until` [s], whichever comes first; spans without length are left out.
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
