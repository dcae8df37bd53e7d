"""Grasps of pieces in a heap, from above or along a slanted approach, without knowledge of their shapes.

The fingers descend where the height map is lower than their tips and close on the piece between them. Hidden
cells count as filled, so fingers never enter space that no camera has seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, HeightMap, InputError
from armcell.core.checks import checked, require
from armcell.grasping import top_down_kernel
from armcell.grasping.grasp import Grasp
from armcell.grasping.hand import Hand
from armcell.grasping.tilted_map import slanted_views, tilted_map

Array = NDArray[np.float64]

FLAT = 0.3  # height between the fingers per width: the fingers squeeze flatter pieces out
WIDE = 0.4  # score lost by a grasp of the hand's full width: two pieces side by side, which burst out
MOVED = 0.10  # [m] by which a failed grasp may move the piece
SAME_WIDTH = 0.007  # [m] difference of the widths that a camera measures on the same sides of a piece
NOWHERE = -1e8  # [m] below everything
OTHER_PIECE, OTHER_KIND = 0.25, 0.5  # scores lost by grasps of a missed piece, and by similar ones


@dataclass(frozen=True)
@checked()
class TopDownGraspSettings:
    """Settings for grasps of pieces in a heap; lengths in meters."""

    turns: int = 16  # hand orientations over half a circle
    depths: tuple[float, ...] = (0.054, 0.040, 0.028, 0.018, 0.010)  # fingertip depths below the top
    room: float = 0.009  # free space on each side of the piece, for errors of the map and the arm
    clearance: float = 0.005  # of the fingers above the cells below them
    least_hold: float = 0.006  # minimum height of the piece above the fingertips
    least_grip: float = 0.2  # minimum height between the fingers per width, if the fingers could go deeper
    steepest: float = 0.45  # maximum tangent of a side's slant that friction holds
    least_touch: float = 0.3  # minimum fraction of the finger width in contact; less is a corner
    kept: int = 80  # maximum number of candidates
    apart: float = 0.008  # minimum distance of two candidates with the same orientation
    tilt: float = 0.0  # [rad] of the approach from the vertical, below pi / 2
    tilt_directions: int = 8  # directions in which a tilted hand may lean

    def __post_init__(self) -> None:
        require(self.turns >= 1, f"turns is {self.turns}, it must be at least 1")
        for name in ("room", "least_hold", "steepest", "apart"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        require(0 <= self.tilt < np.pi / 2, f"tilt is {self.tilt:g}, it must be from 0 to below pi / 2")
        least = f"tilt_directions is {self.tilt_directions}, it must be at least 1"
        require(self.tilt_directions >= 1, least)


@dataclass(frozen=True, eq=False)
class HeapGrasp(Grasp):
    """Grasp of one piece in a heap, with the tcp pose in the world frame."""

    piece: int = -1
    tip: float = 0.0  # [m, world z] height of the lower fingertip
    top: float = 0.0  # [m, world z] highest point of the piece, which may lean on a wall
    reach: float = 0.05  # [m] extent of the piece from the hand's center, seen from above


def top_down_grasps(
    seen: HeightMap,
    labels: NDArray[np.int64],
    floor: float,
    hand: Hand,
    force: float,
    settings: TopDownGraspSettings = TopDownGraspSettings(),
    avoid: Sequence[Grasp] = (),
) -> list[HeapGrasp]:
    """Return grasp candidates for the pieces of a heap, sorted from best to worst. The hand approaches each
    piece from above, or along the approaches that `settings.tilt` inclines.

    Args:
        labels: (nx, ny) piece number of each cell, -1 for none.
        floor: [m, world z] height of the surface below the heap.
        force: [N] per finger, because the weight is unknown.
        avoid: failed grasps. Each lowers the score of the candidates near it, most of those that would fail
            in the same manner.
    Raises:
        InputError: the sizes of map and labels differ.
    """
    if labels.shape != seen.heights.shape:
        raise InputError(f"labels of {labels.shape} cells for a map of {seen.heights.shape}")
    if not (labels >= 0).any():
        return []
    s, tops = settings, _tops(seen, labels)
    found: list[HeapGrasp] = []
    for T_world_view in slanted_views(seen, s.tilt, s.tilt_directions):
        view = (seen, labels) if s.tilt == 0.0 else tilted_map(seen, labels, T_world_view)
        found += _along(*view, T_world_view, floor, hand, force, s, avoid, tops)
    found.sort(key=lambda grasp: -grasp.score)
    return found[: s.kept]


def _along(
    seen: HeightMap, labels: NDArray[np.int64], T_world_view: SE3, floor: float, hand: Hand, force: float,
    settings: TopDownGraspSettings, avoid: Sequence[Grasp], tops: Array,
) -> list[HeapGrasp]:  # fmt: skip
    """Return the best candidates of one approach direction, from a map and labels in the frame of the view.

    Args:
        tops: (k,) [m, world z] highest points of the pieces.
    """
    s, gripper, is_slanted = settings, hand.gripper, settings.tilt > 0.0
    cells = np.argwhere(labels >= 0)
    cells = cells[(cells.sum(1) % 2) == 0]  # checkerboard subset: neighboring cells give similar grasps
    if not len(cells):
        return []
    fingers = np.concatenate([hand.left, hand.right])
    tip_z = float(fingers[:, 5].max())
    half = float(np.abs(fingers[:, [0, 3]]).max())
    thick = float(np.abs(fingers[:, [1, 4]]).max())
    length = tip_z - float(hand.palm[:, 5].max())
    palm = np.array([np.abs(hand.palm[:, [1, 4]]).max(), np.abs(hand.palm[:, [0, 3]]).max()])
    turns = np.pi * np.arange(s.turns) / s.turns
    depths = np.array([min(d, length - s.clearance) for d in s.depths])
    lowest = NOWHERE if is_slanted else floor + s.clearance  # a slanted floor bounds only by its own cells
    rows = top_down_kernel.search(
        seen.heights, *seen.origin, seen.resolution, cells, turns, depths, lowest,
        np.array([half, thick, length]), palm, gripper.max_width,
        np.array([s.room, s.clearance, s.least_hold]),
    )  # fmt: skip
    firm = (rows[:, 8] >= s.least_grip * rows[:, 4]) | (rows[:, 2] <= lowest)
    rows = rows[firm & (rows[:, 7] <= s.steepest) & (rows[:, 6] >= s.least_touch)]
    if not len(rows):
        return []
    middles, radii = _pieces(seen, labels)
    cell = cells[rows[:, 0].astype(int)]
    piece = labels[cell[:, 0], cell[:, 1]]
    turn = turns[rows[:, 1].astype(int)]
    along = np.column_stack([np.cos(turn), np.sin(turn)])
    at = seen.at(cell)[:, :2] + rows[:, 3, None] * along
    lever = np.linalg.norm(at - middles[piece], axis=1)
    in_world = T_world_view.apply(np.column_stack([at, rows[:, 9]]))
    score = (
        (0.3 + 0.7 * rows[:, 6])
        * (1 - (rows[:, 7] / s.steepest) ** 2)
        * (0.3 + 0.7 * np.minimum(rows[:, 8], 0.03) / 0.03)
        * np.minimum(rows[:, 8] / (FLAT * rows[:, 4]), 1.0)
        * (1 - WIDE * (rows[:, 4] / gripper.max_width) ** 2)
        / (1 + (lever / 0.03) ** 2)
        + 2.0 * (in_world[:, 2] - floor)  # topmost pieces first
    )
    closing = np.column_stack([along, np.zeros(len(along))]) @ T_world_view.rotation.matrix.T
    heading = np.arctan2(closing[:, 1], closing[:, 0])
    for failed in avoid:
        near, alike = _like(failed, in_world[:, :2], heading, rows[:, 4])
        score -= OTHER_PIECE * near + OTHER_KIND * (near & alike)
    found: list[HeapGrasp] = []
    taken = np.zeros((0, 4))
    for i in np.argsort(-score, kind="stable"):
        here = np.array([*at[i], rows[i, 2], 0.05 * rows[i, 1]])
        if len(taken) and np.any(np.linalg.norm(taken - here, axis=1) < s.apart):
            continue
        taken = np.vstack([taken, here])
        T = _down(at[i], float(rows[i, 2]) + tip_z, float(turn[i]))
        if not _only_pieces(seen, labels, T, float(rows[i, 4]), half, float(rows[i, 2])):
            continue
        k, T = int(piece[i]), T_world_view @ T
        across, closes, _ = np.abs(T.rotation.matrix[2])
        tip = float(T.apply((0.0, 0.0, tip_z))[2] - closes * (rows[i, 5] / 2 + thick) - across * half)
        slant = f" slanted by {np.rad2deg(s.tilt):.0f} deg" if is_slanted else ""
        name = f"piece {k} at {np.rad2deg(heading[i]):.0f} deg{slant}, tips {1000 * (tip - floor):.0f} mm up"
        found.append(
            HeapGrasp(
                f"{name} ({len(found)})", T, float(rows[i, 4]), float(rows[i, 5]), force, float(score[i]),
                piece=k, tip=tip, top=float(tops[k]), reach=float(lever[i] + radii[k]),
            )
        )  # fmt: skip
        if len(found) == s.kept:
            break
    return found


def _like(failed: Grasp, at: Array, turn: Array, width: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which top-down grasps (m,) of a heap are probably at the piece that a failed grasp missed, and
    which of them resemble the failed grasp: the piece may have moved, but not changed its width.
    """
    T = failed.T_object_tcp
    y = T.rotation.matrix[:, 1]
    away = np.linalg.norm(at - T.translation[:2], axis=1)
    beside = (away < 0.015) & (np.abs(np.sin(turn - np.arctan2(y[1], y[0]))) < 0.35)
    return away < MOVED, beside | (np.abs(width - failed.width) < SAME_WIDTH)


def _only_pieces(
    seen: HeightMap, labels: NDArray[np.int64], T: SE3, width: float, half: float, tip: float
) -> bool:
    """Return whether more than 90 % of the visible points between the fingers of a top-down grasp belong to
    objects, not to the bin's walls.
    """
    r = seen.resolution
    x, y = np.meshgrid(np.arange(-half, half + r, r), np.arange(r - width / 2, width / 2, r))
    at = T.apply(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))[:, :2]
    i, j = np.round((at - seen.origin) / r).astype(int).T
    inside = (i >= 0) & (j >= 0) & (i < labels.shape[0]) & (j < labels.shape[1])
    i, j = i[inside], j[inside]
    standing = seen.seen[i, j] & (seen.heights[i, j] > tip)
    return float(np.mean(labels[i, j][standing] >= 0)) > 0.9 if standing.any() else False


def _tops(seen: HeightMap, labels: NDArray[np.int64]) -> Array:
    """Return the highest points (k,) [m, world z] of the pieces in a heap."""
    tops, kept = np.full(int(labels.max()) + 1, -np.inf), labels >= 0
    np.maximum.at(tops, labels[kept], seen.heights[kept])
    return tops


def _pieces(seen: HeightMap, labels: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the centers (k, 2) and radii (k,) [m, frame of the map] of the pieces in a heap, seen along the
    approach.
    """
    index = np.argwhere(labels >= 0)
    number = labels[index[:, 0], index[:, 1]]
    xy, count = seen.at(index)[:, :2], int(number.max()) + 1
    size = np.maximum(np.bincount(number, minlength=count), 1)
    middles = np.column_stack([np.bincount(number, xy[:, k], count) / size for k in range(2)])
    radii = np.zeros(count)
    np.maximum.at(radii, number, np.linalg.norm(xy - middles[number], axis=1))
    return middles, radii


def _down(at: Array, z: float, turn: float) -> SE3:
    """Return the pose T_view_tcp of a grasp: the hand points down in the frame of the view, and is turned
    about its z axis by an angle.
    """
    y = np.array([np.cos(turn), np.sin(turn), 0.0])
    approach = np.array([0.0, 0.0, -1.0])
    return SE3(SO3(np.column_stack([np.cross(y, approach), y, approach])), np.array([at[0], at[1], z]))
