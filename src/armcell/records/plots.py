"""Plots of the run report as PNG, with Matplotlib's object API: no global state, no display."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from armcell.model import RobotModel
from armcell.records.reader import StageSpan
from armcell.records.recorder import Series

Array = NDArray[np.float64]

WIDTH_IN, DPI = 10.5, 110
# Fixed margins [in] align the time axes of all figures.
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN, GAP_IN, LEGEND_ROW_IN = 0.75, 0.55, 0.85, 0.48, 0.22, 0.22
_LEGEND_COLUMNS_IN = 1.3  # width of one legend entry [in]
# Okabe and Ito's colorblind-safe palette; gray replaces yellow, which is too faint on white.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")
_STYLES = ("-", "--", ":")  # line styles; the second is used from the ninth curve
_BANDS = ("#F1F4F8", "#FFFFFF")
_INK, _FAINT = "#374151", "#D5DAE1"
_LABEL_GAP_IN = 0.15  # [in] minimum distance of stage names
PANEL_COLUMNS, PANEL_IN = 3, 1.7  # panels of step responses; height [in]
MAX_OBJECTS = len(PALETTE)


def joint_plots(series: Series, model: RobotModel, stages: Sequence[StageSpan]) -> dict[str, bytes]:
    """Plot joint positions and velocities over time for the run report, as one PNG figure per arm.

    Returns:
        Image by name of the arm's group; "joints" for joints without an arm.
    """
    figures = {}
    for name, joints in _arms(model).items():
        columns = [series.joint_names.index(joint) for joint in joints]
        figure, (above, below) = _figure(2, 2.0, len(joints))
        _curves(above, series.times, {j: series.positions[:, c] for j, c in zip(joints, columns)})
        _curves(below, series.times, {j: series.velocities[:, c] for j, c in zip(joints, columns)})
        _finish(figure, (above, below), ("position [rad]", "velocity [rad/s]"), stages, series.times)
        figures[name] = _png(figure)
    return figures


def response_plot(times: Array, curves: Mapping[str, Array], title: str) -> bytes:
    """Plot step responses over time as PNG in the style of the run report, with one panel per joint.

    Args:
        times: (k,) [s].
        curves: panel title -> response as a fraction of the step (k,).
    """
    columns = min(PANEL_COLUMNS, len(curves))
    rows = math.ceil(len(curves) / columns)
    figure = Figure(figsize=(WIDTH_IN, PANEL_IN * rows + TOP_IN), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, color=_INK, fontsize=10)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for ax, (name, curve) in zip(panels, curves.items()):
        ax.axhline(1.0, color="#9AA3AF", linewidth=1.0, linestyle=":")
        ax.plot(times, curve, color=PALETTE[0], linewidth=1.2)
        ax.set_title(name, color=_INK, fontsize=7.5, loc="left")
        ax.tick_params(labelsize=7, colors=_INK)
        ax.grid(color=_FAINT, linewidth=0.5)
    for ax in panels[len(curves) :]:
        ax.set_visible(False)
    figure.supxlabel("time [s]", color=_INK, fontsize=8)
    figure.supylabel("share of the step", color=_INK, fontsize=8)
    return _png(figure)


def gripper_plot(series: Series, stages: Sequence[StageSpan]) -> bytes | None:
    """Plot the gripper's width and force over time as PNG for the run report; return None if neither was
    recorded.
    """
    rows = [
        ("width [mm]", {name: 1000 * v for name, v in series.gripper_width.items()}),
        ("force per finger [N]", dict(series.gripper_force)),
    ]
    rows = [(label, curves) for label, curves in rows if curves and _any_finite(curves)]
    if not rows:
        return None
    figure, axes = _figure(len(rows), 1.4, len(rows[0][1]))
    for ax, (_, curves) in zip(axes, rows):
        _curves(ax, series.times, curves)
        low, high = ax.get_ylim()
        ax.set_ylim(min(0.0, low), high + 0.05 * (high - low))
    _finish(figure, axes, [label for label, _ in rows], stages, series.times)
    return _png(figure)


def height_plot(series: Series, stages: Sequence[StageSpan]) -> bytes | None:
    """Plot the heights (world z) of the objects that move most, as PNG for the run report."""
    heights = {n: 1000 * z for n, z in series.object_heights.items() if np.isfinite(z).any()}
    if not heights:
        return None
    moved = sorted(heights, key=lambda n: -float(np.nanmax(heights[n]) - np.nanmin(heights[n])))[:MAX_OBJECTS]
    figure, axes = _figure(1, 1.8, len(moved))
    _curves(axes[0], series.times, {n: heights[n] for n in heights if n in moved})
    _finish(figure, axes, ["height of origin [mm]"], stages, series.times)
    return _png(figure)


def _arms(model: RobotModel) -> dict[str, list[str]]:
    """Group the revolute joints by arm, for the plots of the run report.

    Prismatic finger joints are excluded, because the gripper width shows them.
    """
    turning = [n for n in model.joint_names if model.joint(n).type != "prismatic"]
    arms: dict[str, list[str]] = {}
    for gripper in model.grippers.values():
        members = model.groups[gripper.arm_group].joint_names if gripper.arm_group in model.groups else ()
        arms[gripper.arm_group] = [n for n in turning if n in members]
    rest = [n for n in turning if not any(n in names for names in arms.values())]
    return {name: names for name, names in {**arms, "joints": rest}.items() if names}


# --- common style ---
def _figure(rows: int, row_in: float, entries: int) -> tuple[Figure, tuple[Axes, ...]]:
    """Create the figure for a plot of the run report: stacked axes, each `row_in` inches high, and space for
    the legend.
    """
    legend = math.ceil(entries / _legend_columns(entries)) * LEGEND_ROW_IN if entries else 0.0
    bottom = BOTTOM_IN + legend
    height = TOP_IN + rows * row_in + (rows - 1) * GAP_IN + bottom
    figure = Figure(figsize=(WIDTH_IN, height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    figure.subplots_adjust(
        left=LEFT_IN / WIDTH_IN,
        right=1 - RIGHT_IN / WIDTH_IN,
        top=1 - TOP_IN / height,
        bottom=bottom / height,
        hspace=GAP_IN / row_in,
    )
    return figure, tuple(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])


def _legend_columns(entries: int) -> int:
    return max(1, min(entries, int((WIDTH_IN - LEFT_IN - RIGHT_IN) / _LEGEND_COLUMNS_IN)))


def _curves(ax: Axes, times: Array, curves: Mapping[str, Array]) -> None:
    for i, (name, values) in enumerate(curves.items()):
        style = _STYLES[i // len(PALETTE) % len(_STYLES)]
        ax.plot(times, values, color=PALETTE[i % len(PALETTE)], linestyle=style, linewidth=1.5, label=name)


def _finish(
    figure: Figure, axes: Sequence[Axes], labels: Iterable[str], stages: Sequence[StageSpan], times: Array
) -> None:
    begin, end = (float(times[0]), float(times[-1])) if len(times) else (0.0, 1.0)
    end = max(end, begin + 1e-3)
    for ax, label in zip(axes, labels):
        ax.set_ylabel(label, color=_INK, fontsize=9)
        ax.set_xlim(begin, end)
        ax.grid(True, axis="y", color=_FAINT, linewidth=0.6)
        ax.set_axisbelow(True)
        ax.tick_params(colors=_INK, labelsize=8, length=3)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
        for side in ("left", "bottom"):
            ax.spines[side].set_color("#9AA3AF")
        for i, stage in enumerate(stages):
            ax.axvspan(stage.begin, stage.end, color=_BANDS[i % 2], zorder=0, linewidth=0)
            ax.axvline(stage.begin, color=_FAINT, linewidth=0.8, zorder=0.5)
    axes[-1].set_xlabel("cell time [s]", color=_INK, fontsize=9)
    handles, names = axes[0].get_legend_handles_labels()
    if names:
        columns = _legend_columns(len(names))
        figure.legend(
            handles, names, loc="lower center", ncols=columns, fontsize=8, frameon=False, labelcolor=_INK
        )
    _name_stages(axes[0], [s for s in stages if s.end > begin and s.begin < end], begin, end)


def _name_stages(ax: Axes, stages: Sequence[StageSpan], begin: float, end: float) -> None:
    """Write slanted stage names above the topmost axes of a plot for the run report.

    If two names would overlap, the name of the shorter stage is omitted.
    """
    gap = (end - begin) * _LABEL_GAP_IN / (0.8 * WIDTH_IN)
    named = list(stages)

    def middle(stage: StageSpan) -> float:
        return (max(stage.begin, begin) + min(stage.end, end)) / 2

    while True:
        close = [(a, b) for a, b in pairwise(named) if middle(b) - middle(a) < gap]
        if not close:
            break
        named.remove(min(close[0], key=lambda s: s.end - s.begin))
    top = ax.secondary_xaxis("top")
    top.set_xticks([middle(s) for s in named], [s.name for s in named])
    top.tick_params(axis="x", length=0, pad=1, labelsize=7.5, labelcolor=_INK, labelrotation=35)
    for label in top.get_xticklabels():
        label.set_horizontalalignment("left")
        label.set_rotation_mode("anchor")
    top.spines["top"].set_visible(False)


def _any_finite(curves: Mapping[str, Array]) -> bool:
    return any(np.isfinite(values).any() for values in curves.values())


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
