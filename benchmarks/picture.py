"""A picture of what was measured, with its bar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt


def dots(file: Path, measured: Mapping[str, Sequence[float]], what: str, bar: float | None = None) -> None:
    """Every single value by name, with the medians as strokes and the bar as a line; a NaN is left out."""
    figure, axes = plt.subplots(figsize=(8, 1.2 + 0.35 * len(measured)), layout="constrained")
    rng = np.random.default_rng(0)  # those at the same place are set apart
    for row, values in enumerate(measured.values()):
        x = np.asarray(values, dtype=float)
        x = x[np.isfinite(x)]
        axes.plot(x, row + rng.uniform(-0.18, 0.18, len(x)), "o", ms=4, alpha=0.6, color="#1f6f8b")
        if len(x):
            axes.plot([np.median(x)] * 2, [row - 0.3, row + 0.3], color="#1f6f8b", lw=2)
    if bar is not None:
        axes.axvline(bar, color="#d1495b", label=f"bar: {bar:g}")
        axes.legend(fontsize=8)
    axes.set_yticks(range(len(measured)), list(measured))
    axes.set_xlim(left=0)
    axes.invert_yaxis()
    axes.set_xlabel(what)
    axes.grid(alpha=0.3, axis="x")
    figure.savefig(file, dpi=90)
    plt.close(figure)
