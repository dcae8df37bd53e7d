"""Report of a campaign: summary.json, report.md and a self-contained report.html."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from armcell.campaigns import statistics
from armcell.campaigns.failure_frames import picture_file
from armcell.campaigns.store import Store, write_atomically
from armcell.campaigns.trial import replay_command
from armcell.records import html

SHOWN = 200  # maximum number of failures in the table
PLOTTED = 12  # maximum number of plotted parameters, most significant first
DRAWN = 8  # maximum number of drawn values shown per failure
MEASURED = {
    "task_time_s": ("task [s]", 1.0),
    "planning_s": ("planning [ms]", 1000.0),
    "placement_error_m": ("placed off [mm]", 1000.0),
    "slip_m": ("slip in hold [mm]", 1000.0),
    "min_clearance_m": ("least clearance [mm]", 1000.0),
}


def write_report(store: Store, stopped: str) -> Path:
    """Write the report of a campaign (summary.json, report.md and report.html) atomically and return the HTML
    file.

    Args:
        stopped: reason why the campaign ended, as text.
    Raises:
        InputError: the folder is not writable, or the disk is full.
    """
    data, rows = summary(store, stopped), _in_order(store)
    write_atomically(store.folder / "summary.json", (json.dumps(data, indent=2) + "\n").encode())
    write_atomically(store.folder / "report.md", _markdown(data, store.folder).encode())
    file = store.folder / "report.html"
    write_atomically(file, _html(data, rows, store.folder).encode())
    return file


def _in_order(store: Store) -> list[dict[str, Any]]:
    return [store.rows[number] for number in sorted(store.rows)]


def summary(store: Store, stopped: str) -> dict[str, Any]:
    """Return the contents of summary.json in a campaign's report as JSON-ready data."""
    spec, rows = store.spec, _in_order(store)
    wall = sum(row["wall_s"] for row in rows)
    return {
        "cell": spec.cell,
        "asked": spec.as_dict(),
        "hashes": store.hashes,
        "stopped": stopped,
        "trials": len(rows),
        "near_failures": sum(row["near_failure"] for row in rows),
        "success": statistics.success(rows).as_dict(),
        "unwanted_contacts": sum(row["unwanted_contacts"] for row in rows),
        "trials_per_hour_and_core": 3600 * len(rows) / wall if wall else None,
        "measured": {name: statistics.summary([row[name] for row in rows]) for name in MEASURED},
        "causes": [
            {
                "code": cause.code, "stage": cause.stage, "pair": cause.pair, "count": len(cause.trials),
                "message": cause.message, "trials": list(cause.trials),
                "replay": replay_command(spec.cell, store.rows[cause.trials[0]], spec.values),
            }
            for cause in statistics.causes(rows)
        ],
        "effects": [
            {"parameter": e.path, "auc": e.auc, "p_value": e.p_value, "words": e.words}
            for e in statistics.effects(rows)
        ],
        "failures": [
            {
                "trial": row["trial"], "seed": row["seed"], "code": row["error_name"], "stage": row["stage"],
                "message": row["message"], "values": row["values"],
                "drawn": statistics.drawn(row), "replay": replay_command(spec.cell, row, spec.values),
            }
            for row in rows
            if not row["success"]
        ],
    }  # fmt: skip


def _share(data: dict[str, Any]) -> str:
    share = data["success"]
    if not share["total"]:
        return "no trial finished"
    low, high = share["wilson"]
    return (
        f"{share['share']:.2%} of {share['total']} succeed (95 % interval {low:.2%} to {high:.2%}; "
        f"exact: {share['clopper_pearson'][0]:.2%} to {share['clopper_pearson'][1]:.2%})"
    )


def _markdown(data: dict[str, Any], folder: Path) -> str:
    lines = [
        f"# Campaign: {data['cell']}",
        "",
        f"**{_share(data)}**, {data['unwanted_contacts']} unwanted contacts",
        "",
        f"Ended because {data['stopped']}.",
    ]
    lines += ["", "| measured | median | 95th percentile | most |", "|---|---|---|---|"]
    for name, (title, scale) in MEASURED.items():
        if found := data["measured"][name]:
            values = (f"{scale * found[key]:.3g}" for key in ("median", "p95", "most"))
            lines.append(f"| {title} | {' | '.join(values)} |")
    if data["effects"]:
        lines += ["", "| parameter | effect | p (Holm) |", "|---|---|---|"]
        lines += [f"| `{e['parameter']}` | {e['words']} | {e['p_value']:.3g} |" for e in data["effects"]]
    if data["causes"]:
        lines += ["", "| failures | code | stage | pair | what | replay |", "|---|---|---|---|---|---|"]
        lines += [
            f"| {c['count']} | {c['code']} | {c['stage'] or '-'} | {c['pair'] or '-'} | "
            f"{c['message'].replace('|', '/')} | `{c['replay']}` |"
            for c in data["causes"]
        ]
    if data["failures"]:
        lines += ["", "| trial | seed | code | stage | what | replay |", "|---|---|---|---|---|---|"]
        lines += [
            f"| {f['trial']} | {f['seed']} | {f['code']} | {f['stage'] or '-'} | "
            f"{f['message'].replace('|', '/')} | `{f['replay']}` |"
            for f in data["failures"][:SHOWN]
        ]
    for failure in data["failures"]:
        file = picture_file(folder, failure["trial"])
        if os.path.exists(file):
            words = f"trial {failure['trial']}, seed {failure['seed']}: {failure['code']}"
            lines += ["", f"![{words}]({file.relative_to(folder).as_posix()})", "", words]
    return "\n".join(lines) + "\n"


def _html(data: dict[str, Any], rows: list[dict[str, Any]], folder: Path) -> str:
    share = data["success"]
    good = bool(share["total"]) and share["count"] == share["total"]
    body = [
        f'<header class="{"good" if good else "bad"}"><p class="what">Campaign {html.text(data["cell"])}</p>'
        f"<h1>{html.text(_share(data))}</h1><p>Ended because {html.text(data['stopped'])}.</p></header>"
    ]
    keys = [
        html.key("trials", str(data["trials"])),
        html.key("failures", str(len(data["failures"])), bad=bool(data["failures"])),
        html.key("unwanted contacts", str(data["unwanted_contacts"]), bad=data["unwanted_contacts"] > 0),
        html.key("trials per hour and core", f"{data['trials_per_hour_and_core'] or 0:,.0f}"),
    ]
    keys += [
        html.key(f"{title}, median", html.number(found["median"], scale=scale))
        for name, (title, scale) in MEASURED.items()
        if (found := data["measured"][name])
    ]
    body.append(html.section("Numbers", f'<div class="keys">{"".join(keys)}</div>'))
    from armcell.campaigns import plots  # imported late: workers of campaigns need no matplotlib

    if rows:
        picture = html.image(plots.success_rate_plot(rows), "success over trials")
        body.append(html.section("Success over trials", picture))
    if histograms := plots.distribution_plots(rows, MEASURED):
        body.append(html.section("What was measured", html.image(histograms, "histograms")))
    body.append(html.section("Which parameter matters", _effects(data, rows)))
    body.append(html.section("Failures by cause", _causes(data)))
    if moments := _moments(data, folder):
        body.append(html.section("The moment", moments))
    body.append(html.section("Failures", _failures(data, folder)))
    asked = json.dumps(data["asked"], indent=2)
    body.append(html.section("What was asked", f"<pre>{html.text(asked)}</pre>"))
    versions = html.text(", ".join(f"{k} {v}" for k, v in data["hashes"].items()))
    body.append(f"<footer>hashes: {versions}</footer>")
    return html.page(f"Campaign {data['cell']}", "\n".join(body))


def _effects(data: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    from armcell.campaigns import plots

    paths = [e["parameter"] for e in data["effects"]][:PLOTTED]
    if not paths:
        paths = sorted({path for row in rows for path in row["values"]})
        text = "All trials went alike: nothing can be said." if rows else "No trial."
        picture = plots.parameter_plots(rows, paths)
        return f'<p class="none">{text}</p>' + (
            html.image(picture, "success by parameter") if picture else ""
        )
    table = html.table(
        ["parameter", "effect", "p (Holm)"],
        [[html.text(e["parameter"]), html.text(e["words"]), f"{e['p_value']:.3g}"] for e in data["effects"]],
        numeric=[2],
    )
    picture = plots.parameter_plots(rows, paths)
    return table + (html.image(picture, "success by parameter") if picture else "")


def _causes(data: dict[str, Any]) -> str:
    if not data["causes"]:
        return '<p class="none">None.</p>'
    return html.table(
        ["count", "code", "stage", "pair", "what the first said", "replay the first"],
        [
            [
                str(c["count"]), html.name(c["code"]), html.name(c["stage"]), html.name(c["pair"]),
                html.text(c["message"]), f"<code>{html.text(c['replay'])}</code>",
            ]
            for c in data["causes"]
        ],
        numeric=[0],
    )  # fmt: skip


def _moments(data: dict[str, Any], folder: Path) -> str:
    """Return the pictures section of a campaign's HTML report. It shows each failed trial at its first
    contact or, without a contact, at its end.
    """
    figures = []
    for failure in data["failures"]:
        file, number = picture_file(folder, failure["trial"]), failure["trial"]
        if os.path.exists(file):
            words = f"trial {number}, seed {failure['seed']}: {failure['code']} {failure['message']}"
            shown = html.image(file.read_bytes(), f"trial {number}", "key-moment")
            figures.append(
                f'<figure id="trial_{number}">{shown}<figcaption>{html.text(words)}</figcaption></figure>'
            )
    return f'<div class="pictures">{"".join(figures)}</div>' if figures else ""


def _failures(data: dict[str, Any], folder: Path) -> str:
    if not data["failures"]:
        return '<p class="none">None.</p>'
    shown = data["failures"][:SHOWN]
    rows = [
        [
            _linked(f["trial"], folder), str(f["seed"]), html.name(f["code"]), html.name(f["stage"]),
            _drawn(f["drawn"]),
            html.text(f["message"]), f"<code>{html.text(f['replay'])}</code>",
        ]
        for f in shown
    ]  # fmt: skip
    more = len(data["failures"]) - len(shown)
    note = f'<p class="none">{more} more in summary.json</p>' if more else ""
    return html.table(["trial", "seed", "code", "stage", "values", "what", "replay"], rows, [0, 1]) + note


def _drawn(values: dict[str, Any]) -> str:
    lines = [f"{html.name(path)} {html.number(value, digits=4)}" for path, value in values.items()]
    more = len(lines) - DRAWN
    return "<br>".join(lines[:DRAWN]) + (f"<br>{more} more" if more > 0 else "")


def _linked(number: int, folder: Path) -> str:
    """Return a trial's number as HTML for a campaign report. The number links to a picture of the trial, if
    there is one.
    """
    there = os.path.exists(picture_file(folder, number))
    return f'<a href="#trial_{number}">{number}</a>' if there else str(number)
