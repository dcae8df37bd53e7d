"""Pushes that move the pieces of a heap away from walls, from a height map.

If no hand fits around a piece because it touches a wall, the closed fingers push the piece sideways near the
floor. Each candidate push is predicted; the best one gives the piece the most room on all sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, HeightMap, InputError
from armcell.core.checks import checked, require
from armcell.grasping import push_kernel
from armcell.grasping.grasp import Grasp
from armcell.grasping.hand import Hand

Array = NDArray[np.float64]

CLOSED = 0.002  # [m] opening of the hand while it pushes
MOST_OUTLINE = 120  # points on a piece's outline
PALM = 0.002  # [m] between the palm and the highest point of a piece, beyond the clearance
TOUCHING = 2.5  # [cells] from an obstacle
TOWARD = -0.2  # smallest cosine of a push with the direction away from the walls: others jam the piece


@dataclass(frozen=True)
@checked()
class PushSettings:
    """Settings for finding the pushes with which closed fingers move pieces of a heap away from walls;
    lengths in meters.
    """

    directions: int = 16  # over the whole circle
    spacing: float = 0.006  # between parallel pushes
    length: float = 0.09  # maximum, after the first contact
    before: float = 0.010  # between the fingers and the piece at the start
    room: float = 0.004  # free space on all sides of the fingers
    clearance: float = 0.005  # of the fingers above the floor
    friction: float = 0.5  # of the piece on the fingers
    least_gain: float = 0.002  # minimum gain of the mean distance from walls and other pieces
    kept: int = 20  # maximum number of candidates

    def __post_init__(self) -> None:
        require(self.directions >= 4, f"directions is {self.directions}, it must be at least 4")
        for name in ("spacing", "length", "before", "room", "friction", "least_gain"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")


@dataclass(frozen=True, eq=False)
class HeapPush(Grasp):
    """Push of one piece of a heap: the pose of the closed hand at the start, in the world frame, and the
    motion from there.

    The grasp's score is the predicted gain [m] of the piece's mean distance from walls and other pieces.
    """

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m, world]
    shift: tuple[float, float] = (0.0, 0.0)  # [m, world] predicted motion of the piece's center
    turn: float = 0.0  # [rad] predicted turn of the piece

    @property
    def angle(self) -> float:
        """Return the direction [rad] of a push, about the world's z axis."""
        return float(np.arctan2(self.offset[1], self.offset[0]))


def pushes_off_walls(
    seen: HeightMap,
    labels: NDArray[np.int64],
    where: NDArray[np.bool_],
    floor: float,
    hand: Hand,
    settings: PushSettings = PushSettings(),
    avoid: Sequence[tuple[float, float, float]] = (),
) -> list[HeapPush]:
    """Return pushes that move pieces away from walls, sorted by the predicted gain of room around the piece.

    Pieces that touch each other count as one.

    Args:
        labels: (nx, ny) piece number of each cell, -1 for none.
        where: (nx, ny) cells over which a piece may move; it cannot fall off them.
        floor: [m, world z] height of the surface below the heap.
        avoid: start x, y [m] and angle [rad] of earlier pushes; pushes near them come last.
    Raises:
        InputError: the sizes of map and labels differ.
    """
    from scipy.ndimage import distance_transform_edt

    s = settings
    fingers = np.concatenate([hand.left, hand.right])
    tip_z = float(fingers[:, 5].max())
    length = tip_z - float(hand.palm[:, 5].max())
    wide = np.abs(fingers[:, [0, 3]]).max(), np.abs(fingers[:, [1, 4]]).max() + CLOSED / 2
    palm = np.abs(hand.palm[:, [0, 3]]).max(), np.abs(hand.palm[:, [1, 4]]).max()
    tool = np.array([*wide, *palm, s.room])
    found: list[HeapPush] = []
    for k, piece in enumerate(touching_pieces(seen, labels, where)):
        outline, inward, middle, radius = outline_of(seen, piece)
        if len(outline) < 3:
            continue
        # near the floor, but the palm stays above the piece
        tip = max(floor, float(seen.heights[piece].max()) + PALM - length + s.clearance) + s.clearance
        limits = np.array([tip - 0.5 * s.clearance, tip + length - s.clearance])
        others = np.where(piece, floor, seen.heights)
        room = (
            np.asarray(distance_transform_edt((others <= floor + 0.5 * s.clearance) & where))
            * seen.resolution
        )
        away = away_from_obstacles(seen, room, outline)
        starts, alongs = _starts(outline, wide, s)
        free = alongs @ away > TOWARD
        starts, alongs = starts[free], alongs[free]
        rows = push_kernel.predict(
            seen.heights, others, room, *seen.origin, seen.resolution, outline, inward, middle, radius,
            starts, alongs, tool, limits, s.length, s.friction,
        )  # fmt: skip
        for i in np.flatnonzero(rows[:, 1] >= s.least_gain):
            (x, y), along, distance = starts[i], alongs[i], float(rows[i, 0])
            turn = float(np.arctan2(along[1], along[0]))
            name = f"push piece {k} by {1000 * distance:.0f} mm at {np.rad2deg(turn):.0f} deg"
            offset = (float(distance * along[0]), float(distance * along[1]), 0.0)
            tried = any(np.hypot(x - a, y - b) < 0.01 and np.cos(turn - angle) > 0.9 for a, b, angle in avoid)
            found.append(
                HeapPush(
                    f"{name} ({len(found)})", _facing(along, np.array([x, y, tip + tip_z])), CLOSED, CLOSED,
                    hand.gripper.max_force, float(rows[i, 1]) - tried, offset=offset,
                    shift=(float(rows[i, 2]), float(rows[i, 3])), turn=float(rows[i, 4]),
                )
            )  # fmt: skip
    found.sort(key=lambda push: -push.score)
    return found[: s.kept]


def touching_pieces(
    seen: HeightMap, labels: NDArray[np.int64], where: NDArray[np.bool_]
) -> list[NDArray[np.bool_]]:
    """Return the cells (nx, ny) of each piece, for pushes and drags. Pieces that touch count as one.

    Raises:
        InputError: the sizes of map, labels and `where` differ.
    """
    from scipy.ndimage import label

    for name, array in (("labels", labels), ("where", where)):
        if array.shape != seen.heights.shape:
            raise InputError(f"{name} of {array.shape} cells for a map of {seen.heights.shape}")
    groups, count = label(labels >= 0, np.ones((3, 3)))  # type: ignore[misc]
    return [groups == k for k in range(1, count + 1)]


def outline_of(seen: HeightMap, piece: NDArray[np.bool_]) -> tuple[Array, Array, Array, float]:
    """Return a piece's outline (k, 2) [m, world], its inward normals (k, 2), its center (2,) [m, world] and
    the radius [m] of its friction torque on the floor, for a uniform pressure.
    """
    from scipy.ndimage import binary_erosion, gaussian_filter

    index = np.argwhere(piece)
    at = seen.at(index)[:, :2]
    middle = at.mean(0)
    radius = float(np.linalg.norm(at - middle, axis=1).mean()) + seen.resolution
    edge = np.argwhere(piece & ~np.asarray(binary_erosion(piece), dtype=bool))
    edge = edge[:: int(np.ceil(len(edge) / MOST_OUTLINE))]
    smooth = np.asarray(gaussian_filter(piece.astype(float), 1.5))
    inward = np.column_stack(
        [np.asarray(np.gradient(smooth, axis=k))[edge[:, 0], edge[:, 1]] for k in (0, 1)]
    )
    size = np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-12)
    return seen.at(edge)[:, :2], inward / size, middle, radius


def away_from_obstacles(seen: HeightMap, room: Array, outline: Array) -> Array:
    """Return the mean direction (2,) that leads away from the obstacles at a piece's outline, to choose a
    push. If the outline touches no obstacle, return zeros.
    """
    i, j = np.round((outline - seen.origin) / seen.resolution).astype(int).T
    near = room[i, j] < TOUCHING * seen.resolution
    if not near.any():
        return np.zeros(2)
    away = np.array([np.asarray(np.gradient(room, axis=k))[i[near], j[near]].mean() for k in (0, 1)])
    return away / max(float(np.linalg.norm(away)), 1e-9)


def _starts(outline: Array, wide: tuple[float, float], s: PushSettings) -> tuple[Array, Array]:
    """Return start points (m, 2) [m] for pushes against the outline of a piece, and the directions (m, 2) of
    these pushes.
    """
    starts, alongs = [], []
    for angle in 2 * np.pi * np.arange(s.directions) / s.directions:
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        u, v = outline @ along, outline @ across
        most = v.max() + wide[1] - 0.003
        for aside in np.arange(v.min() - wide[1] + 0.003, most, s.spacing):
            near = np.abs(v - aside) <= wide[1] + s.room
            if near.any():
                starts.append((u[near].min() - wide[0] - s.before) * along + aside * across)
                alongs.append(along)
    return np.array(starts), np.array(alongs)


def _facing(along: Array, at: Array) -> SE3:
    """Return the pose T_world_tcp of a hand that points down for a push. A side of its fingers faces the
    direction of the push, so that the push does not open them.
    """
    x, approach = np.array([along[0], along[1], 0.0]), np.array([0.0, 0.0, -1.0])
    return SE3(SO3(np.column_stack([x, np.cross(approach, x), approach])), at)
