"""A run as a Markdown section and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from benchmarks.planning.bars import Line, lines, middle, solved, total_us, us

matplotlib.use("Agg")
from matplotlib import pyplot as plt

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
ROBOTS = {
    "panda": "Panda, 7 joints",
    "ur5": "UR5, 6 joints",
    "baxter": "Baxter, 14 joints",
    "fetch": "Fetch, 8 joints",
}
COLORS = ("#1f6f8b", "#d1495b", "#edae49", "#66a182", "#5b4b8a")
Row = dict[str, Any]


def write(results: dict[str, Any], document: Path, pictures: Path) -> None:
    """Put the tables between the marks of a Markdown file, and the plots into a folder.

    Raises:
        ValueError: the document lacks the marks.
    """
    text = document.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise ValueError(f"{document} needs the lines {BEGIN} and {END} once each")
    pictures.mkdir(parents=True, exist_ok=True)
    parts = [f"| machine and versions |\n| --- |\n| {results['machine']} |\n", _bars_table(lines(results))]
    for robot, title in ROBOTS.items():
        rows = [r for r in results.get("rows", []) if r["robot"] == robot]
        if not rows:
            continue
        parts.append(f"### {title}\n\n{_planners_table(rows)}")
        if solved(rows):
            name = f"planning_{robot}.png"
            _plot(rows, title, pictures / name)
            folder = pictures.relative_to(document.parent).as_posix()
            parts.append(f"![{title}: problems solved over time, and medians by family]({folder}/{name})\n")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    body = "\n".join(parts)
    document.write_text(f"{before}{BEGIN}\n\n{body}\n{END}{after}", encoding="utf-8")


def _markdown(titles: tuple[str, ...], cells: list[tuple[str, ...]]) -> str:
    table = [titles, tuple("---" for _ in titles), *cells]
    return "".join(f"| {' | '.join(row)} |\n" for row in table)


def _bars_table(judged: list[Line]) -> str:
    cells = [(line.what, line.bar, line.measured, line.verdict) for line in judged]
    return _markdown(("what", "bar", "measured", ""), cells)


def _by_planner(rows: list[Row]) -> dict[str, list[Row]]:
    return {
        name: [r for r in rows if r["planner"] == name and "touching" not in r]
        for name in dict.fromkeys(r["planner"] for r in rows)
    }


def _planners_table(rows: list[Row]) -> str:
    cells = []
    for name, some in _by_planner(rows).items():
        good = solved(some)
        looked = [r for r in good if "contact" in r]
        times = [us(t) for key in (lambda r: r["plan_us"], total_us) for t in middle([*map(key, good)])]
        length = f"{np.mean([r['length'] for r in good]):.2f} rad" if good else ""
        touching = f"{sum(bool(r['contact']) for r in looked)} of {len(looked)}"
        cells.append((name, f"{len(good)}/{len(some)}", *times, length, touching))
    titles = (
        "planner",
        "solved",
        "plan median",
        "p95",
        "+ shorten (+ prove)",
        "p95",
        "length",
        "paths touching",
    )
    return _markdown(titles, cells)


def _plot(rows: list[Row], title: str, file: Path) -> None:
    planners = _by_planner(rows)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for (name, some), color in zip(planners.items(), COLORS):
        ms = np.sort([total_us(r) / 1000 for r in solved(some)])
        if len(ms):
            share = 100 * np.arange(len(ms) + 1) / len(some)
            left.step([ms[0], *ms], share, where="post", label=name, color=color)
    left.set(xscale="log", xlabel="planned, shortened (armcell: and proven) within [ms CPU]",
             ylabel="problems [%]", title=title)  # fmt: skip
    left.set_ylim(0, 102)
    left.legend(fontsize=8)
    left.grid(alpha=0.3)
    families = list(dict.fromkeys(r["family"] for r in rows))
    width = 0.8 / len(planners)
    for i, ((name, some), color) in enumerate(zip(planners.items(), COLORS)):
        medians = [middle([total_us(r) for r in solved(some) if r["family"] == f])[0] for f in families]
        heights = [m / 1000 if np.isfinite(m) else 0.0 for m in medians]
        right.bar(np.arange(len(families)) + i * width, heights, width, label=name, color=color)
    right.set(yscale="log", ylabel="median [ms CPU]", title="by family")
    right.set_xticks(
        np.arange(len(families)) + 0.4 - width / 2, families, rotation=25, ha="right", fontsize=8
    )
    right.grid(alpha=0.3, axis="y")
    figure.savefig(file, dpi=90)
    plt.close(figure)
