"""Plots of a campaign as PNG images, in the style of the run report."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from armcell.campaigns.statistics import Proportion, Row, drawn, without_adaptive_samples
from armcell.records.plots import DPI, PALETTE, WIDTH_IN

GOOD, INK = PALETTE[0], "#374151"
BINS = 10


def success_rate_plot(rows: Sequence[Row]) -> bytes:
    """Plot the success rate of a campaign against the number of trials,
    with its 95 % confidence interval, as PNG.
    """
    fair = sorted(without_adaptive_samples(rows), key=lambda row: row["trial"])
    figure, (ax,) = _figure(1, 1, 2.2)
    counts = np.unique(np.geomspace(1, max(len(fair), 1), 200).astype(int))
    good = np.cumsum([bool(row["success"]) for row in fair])
    shares = [Proportion(int(good[n - 1]), int(n)) for n in counts if n <= len(fair)]
    n = [share.total for share in shares]
    low, high = zip(*(share.wilson for share in shares)) if shares else ((), ())
    ax.fill_between(n, low, high, color=GOOD, alpha=0.2, linewidth=0, label="95 % interval")
    ax.plot(n, [share.value for share in shares], color=GOOD, label="success so far")
    ax.set_xlabel("trials", fontsize=9, color=INK)
    ax.set_ylim(max(0.0, min(low, default=0.0) - 0.02), 1.005)
    ax.legend(fontsize=8, frameon=False, loc="lower right")
    return _png(figure)


def parameter_plots(rows: Sequence[Row], paths: Sequence[str]) -> bytes | None:
    """Plot the success rate of a campaign for each tenth of a parameter's range,
    with confidence intervals, as PNG.

    Args:
        paths: parameter paths, as in `statistics.drawn`; without any, the result is None.
    """
    if not paths:
        return None
    columns = min(3, len(paths))
    figure, axes = _figure(-(-len(paths) // columns), columns, 2.3)
    for ax, path in zip(axes, paths):
        some_rows = [row for row in without_adaptive_samples(rows) if path in drawn(row)]
        values = [drawn(row)[path] for row in some_rows]
        if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
            edges = np.linspace(min(values), max(values), BINS + 1)
            where = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
            names = [(edges[k] + edges[k + 1]) / 2 for k in range(BINS)]
        else:
            kinds = sorted({str(v) for v in values})
            where, names = np.array([kinds.index(str(v)) for v in values]), list(range(len(kinds)))
            ax.set_xticks(names, kinds, fontsize=7)
        for k, at in enumerate(names):
            some = [row for row, w in zip(some_rows, where, strict=True) if w == k]
            if some:
                share = Proportion(sum(bool(row["success"]) for row in some), len(some))
                low, high = share.wilson
                ax.plot([at, at], [low, high], color=GOOD, alpha=0.4, linewidth=3)
                ax.plot([at], [share.value], "o", color=GOOD, markersize=4)
        ax.set_title(path, fontsize=8.5, color=INK)
        ax.set_ylim(-0.03, 1.03)
    for ax in axes[len(paths) :]:
        ax.set_visible(False)
    figure.tight_layout()
    return _png(figure)


def distribution_plots(rows: Sequence[Row], columns: dict[str, tuple[str, float]]) -> bytes | None:
    """Plot a histogram of each measured quantity of a campaign as PNG. Return None if no trial has a value.

    Args:
        columns: column of the rows -> (title with the unit, scale factor).
    """
    found = {
        title: [scale * row[name] for row in rows if row[name] is not None]
        for name, (title, scale) in columns.items()
    }
    found = {title: values for title, values in found.items() if values}
    if not found:
        return None
    figure, axes = _figure(1, len(found), 2.2)
    for ax, (title, values) in zip(axes, found.items()):
        ax.hist(values, bins=min(30, max(5, len(values) // 5)), color=GOOD)
        ax.set_title(title, fontsize=8.5, color=INK)
    figure.tight_layout()
    return _png(figure)


def _figure(rows: int, columns: int, row_in: float) -> tuple[Figure, tuple[Axes, ...]]:
    figure = Figure(figsize=(WIDTH_IN, rows * row_in + 0.3), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = tuple(figure.subplots(rows, columns, squeeze=False).ravel())
    for ax in axes:
        ax.tick_params(colors=INK, labelsize=8)
        ax.grid(True, axis="y", color="#D5DAE1", linewidth=0.6)
        ax.set_axisbelow(True)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    return figure, axes


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight")
    return buffer.getvalue()
