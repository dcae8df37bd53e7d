"""`write_report`: run report as one self-contained HTML file without network or scripts."""

from __future__ import annotations

import logging
import os
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from armcell.core import ErrorCode, Event
from armcell.records import html
from armcell.records.html import millimeters, number, seconds, text
from armcell.records.reader import stage_name, stage_spans
from armcell.records.recorder import RunRecorder

logger = logging.getLogger(__name__)

REPORT_FILE = "report.html"
MAX_EVENTS = 2000


def write_report(folder: Path, result: Mapping[str, Any], recorder: RunRecorder) -> Path:
    """Write the run report `report.html` into the run's folder, atomically.

    Args:
        folder: the run's folder; created if missing.
        result: the run's JSON: success, error_code, error_name, message, cell, task, mode, seed,
            stages [{name, planner, planning_time_s, motion_time_s, clearance_m, slip_m, error, ok}], slip_m,
            placement_error_m, unwanted_contacts, min_clearance_m, welds, versions, command. Missing
            entries are shown as a dash.
        recorder: recorder of the run; may be closed already.
    Returns:
        Path of the report.
    Raises:
        OSError: the file is not writable; no partial file remains.
    """
    parts = [
        _headline(result),
        html.section("Stages", _stages(result)),
        html.section("Key numbers", _key_numbers(result)),
        _pictures(recorder),
        html.section("Plots", _plots(recorder)),
        html.section("Unwanted contacts", _contacts(result)),
        html.section("Events", _events(recorder)),
        html.section("Repeat this run", _command(result)),
        _footer(recorder),
    ]
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / REPORT_FILE
    part = file.with_name(file.name + ".part")
    page = html.page(f"{result.get('cell', 'run')}: {_verdict(result)}", "\n".join(filter(None, parts)))
    try:
        part.write_text(page, encoding="utf-8")
        os.replace(part, file)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    return file


# --- headline ---
def _verdict(result: Mapping[str, Any]) -> str:
    return "success" if result.get("success") else "failure"


def _headline(result: Mapping[str, Any]) -> str:
    good = bool(result.get("success"))
    what = [text(result[k]) for k in ("cell", "task", "mode") if result.get(k)]
    seed = result.get("seed")
    what += [f"seed {text(seed)}"] if seed is not None else []
    heading = "✓ Success" if good else f"✗ Failed: {_error_words(result)}"
    message = result.get("message")
    lines = [
        f'<p class="what">{" · ".join(str(w) for w in what if w)}</p>',
        f"<h1>{text(heading)}</h1>",
        f"<p>{text(message)}</p>" if message else "",
    ]
    failed = [s.get("name") for s in _rows(result, "stages") if s.get("ok") is False]
    if not good and failed:
        lines.append(f"<p>Stage that failed: <b>{text(failed[-1])}</b></p>")
    return f'<header class="{"good" if good else "bad"}">{"".join(lines)}</header>'


def _error_words(result: Mapping[str, Any]) -> str:
    """Format an error code in words for the run report, for example "goal in collision (-12)"."""
    code, name = result.get("error_code"), result.get("error_name")
    if not name and isinstance(code, int):
        name = next((c.name for c in ErrorCode if c.value == code), None)
    words = str(name or "cause not recorded").replace("_", " ").lower()
    return f"{words} ({code})" if code is not None else words


def _footer(recorder: RunRecorder) -> str:
    run, mcap = text(recorder.folder.name), text(recorder.mcap_file.name)
    return f"<footer>armcell · {run} · {mcap} beside this file opens in Foxglove</footer>"


# --- tables ---
def _rows(result: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    """Read the entries under a key of a run's result for the report. All entries are returned as mappings;
    any other entry becomes {"what": entry}.
    """
    value = result.get(key) or []
    if not isinstance(value, list | tuple):
        value = [value]
    return [v if isinstance(v, Mapping) else {"what": v} for v in value]


def _stages(result: Mapping[str, Any]) -> str:
    stages = _rows(result, "stages")
    if not stages:
        return '<p class="none">No stage was run.</p>'
    head = [
        "#",
        "Stage",
        "Planned by",
        "Planning time",
        "Motion time",
        "Clearance",
        "Slip",
        "Error",
        "Outcome",
    ]
    rows = []
    for i, stage in enumerate(stages, 1):
        ok = stage.get("ok")
        outcome = text(None) if ok is None else html.tag(bool(ok), "done" if ok else "failed")
        rows.append(
            [
                str(i),
                text(stage.get("name", stage.get("what"))),
                text(stage.get("planner")),
                number(stage.get("planning_time_s"), "ms", 1000.0, 1),
                seconds(stage.get("motion_time_s")),
                millimeters(stage.get("clearance_m"), 1),
                millimeters(stage.get("slip_m"), 3),
                millimeters(stage["error_m"], 3) if "error_m" in stage else text(stage.get("error")),
                outcome,
            ]
        )
    times = [
        sum(v for s in stages if isinstance(v := s.get(k), int | float))
        for k in ("planning_time_s", "motion_time_s")
    ]
    rows.append(
        ["", "<b>total</b>", "", number(times[0], "ms", 1000.0, 1), seconds(times[1]), "", "", "", ""]
    )
    failed = [i for i, stage in enumerate(stages) if stage.get("ok") is False]
    return html.table(head, rows, numeric=(0, 3, 4, 5, 6), bad=failed)


def _key_numbers(result: Mapping[str, Any]) -> str:
    contacts, welds = result.get("unwanted_contacts"), result.get("welds")
    cards = [
        html.key("slip during hold", millimeters(result.get("slip_m"), 3)),
        html.key("placement error", millimeters(result.get("placement_error_m"))),
        html.key("smallest clearance", millimeters(result.get("min_clearance_m"))),
        html.key("unwanted contacts", _count(contacts), bad=bool(contacts)),
        html.key("welds", _count(welds), bad=bool(welds)),
        html.key("seed", text(result.get("seed"))),
    ]
    out = f'<div class="keys">{"".join(cards)}</div>'
    versions = result.get("versions")
    if isinstance(versions, Mapping) and versions:
        chips = "".join(f'<span class="chip">{text(n)} <b>{text(v)}</b></span>' for n, v in versions.items())
        out += f'<h3>Versions</h3><div class="chips">{chips}</div>'
    elif versions:
        out += f"<h3>Versions</h3><p>{text(versions)}</p>"
    return out


def _count(value: Any) -> str:
    if value is None or isinstance(value, bool | int | float | str):
        return text(value)
    return str(len(value))


def _contacts(result: Mapping[str, Any]) -> str:
    contacts = _rows(result, "unwanted_contacts")
    if not contacts:
        known = result.get("unwanted_contacts") is not None
        return f'<p class="none">{"None." if known else "Not recorded."}</p>'
    columns = list(dict.fromkeys(key for contact in contacts for key in contact))
    rows = [[_contact_cell(key, contact.get(key)) for key in columns] for contact in contacts]
    return html.table([_column_title(c) for c in columns], rows)


def _column_title(key: str) -> str:
    """Convert a JSON key to a heading with a unit for the run report.
    For example, `force_n` becomes "force [N]".
    """
    stem, _, unit = key.rpartition("_")
    known = {"s": "s", "n": "N", "m": "mm", "rad": "rad"}
    return f"{stem.replace('_', ' ')} [{known[unit]}]" if stem and unit in known else key.replace("_", " ")


def _contact_cell(key: str, value: Any) -> str:
    if isinstance(value, list | tuple):
        return text(", ".join(f"{v:.4g}" if isinstance(v, float) else str(v) for v in value))
    return number(value, scale=1000.0) if key.endswith("_m") else text(value)


def _events(recorder: RunRecorder) -> str:
    events = recorder.events
    if not events:
        return '<p class="none">No event was recorded.</p>'
    bad = {"error", "contact", "stop"}
    rows = [
        [
            number(e.time, "s", digits=3),
            text(e.kind),
            text(_event_words(e)),
        ]
        for e in events[:MAX_EVENTS]
    ]
    more = len(events) - MAX_EVENTS
    note = f'<p class="none">{more} more are in {text(recorder.mcap_file.name)}.</p>' if more > 0 else ""
    marked = [i for i, e in enumerate(events[:MAX_EVENTS]) if e.kind in bad]
    return (
        f'<div class="log">{html.table(["Time", "Kind", "What"], rows, numeric=(0,), bad=marked)}</div>{note}'
    )


def _event_words(event: Event) -> str:
    """Return the text of an event for the run report.
    For a stage event, add its name, phase and error if the text lacks them.
    """
    if event.kind != "stage":
        return event.text
    words = event.text if stage_name(event) in event.text else f"{stage_name(event)}: {event.text}"
    phase, error = str(event.data.get("phase") or ""), event.data.get("error")
    if phase and phase not in words:
        words += f" {phase}s" if phase in ("begin", "end") else f" {phase}"
    return f"{words}: {error}" if error else words


def _command(result: Mapping[str, Any]) -> str:
    command = result.get("command")
    if isinstance(command, list | tuple):
        command = shlex.join(str(c) for c in command)
    return f"<pre>{text(command)}</pre>"


# --- pictures ---
def _pictures(recorder: RunRecorder) -> str:
    if not recorder.pictures:
        return ""
    figures = [
        f"<figure>{html.image(html.picture_png(p.rgb), p.title, 'key-moment')}"
        f"<figcaption><b>{text(p.title)}</b>, {p.time:.2f} s</figcaption></figure>"
        for p in recorder.pictures
    ]
    return html.section("Key moments", f'<div class="pictures">{"".join(figures)}</div>')


def _plots(recorder: RunRecorder) -> str:
    from armcell.records import plots

    series = recorder.series()
    if len(series.times) < 2:
        return '<p class="none">Too few states were recorded to plot.</p>'
    spans = stage_spans(recorder.events, float(series.times[-1]))
    out = []
    try:
        for name, png in plots.joint_plots(series, recorder.scene.model, spans).items():
            out.append(f"<h3>Joints: {text(name)}</h3>{html.image(png, f'joints of {name} over time')}")
        gripper = plots.gripper_plot(series, spans)
        if gripper:
            out.append(f"<h3>Gripper</h3>{html.image(gripper, 'gripper width and force over time')}")
        height = plots.height_plot(series, spans)
        if height:
            out.append(f"<h3>Object height</h3>{html.image(height, 'object height over time')}")
    except Exception:  # a failing plot must not suppress the numbers
        logger.exception("a plot of the report failed")
        out.append('<p class="none">A plot could not be drawn; see the log.</p>')
    return "\n".join(out) or '<p class="none">Nothing to plot.</p>'
