"""Drags that pull the pieces of a heap away from walls, from a height map.

No finger fits between a wall and a piece that touches this wall. If the top of the piece is curved, one
fingertip presses on the slope that faces the wall, and then moves away from the wall. A ball or a can rolls,
and a piece with a rounded back slides. A piece with a flat top does not move: the friction of the floor is at
least as large as that of the fingertip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, HeightMap
from armcell.core.checks import checked, require
from armcell.grasping.grasp import Grasp
from armcell.grasping.hand import Hand
from armcell.grasping.pushes import away_from_obstacles, outline_of, touching_pieces

Array = NDArray[np.float64]

NEAR_FLOOR = 0.012  # [m] height above the floor below which a fingertip finds no slope
NOISE = 0.001  # [m] of the heights
LONGEST = 0.09  # [m] largest half length of a piece
FEWEST = 20  # cells, for a median of heights
TRIES = 2  # drags of a piece, which may roll back when the hand rises
SAME_PIECE = 0.06  # [m] distance of a drag from an earlier one that did not free the piece


@dataclass(frozen=True)
@checked()
class DragSettings:
    """Settings for finding the drags with which one fingertip pulls pieces of a heap away from walls; lengths
    in meters.
    """

    directions: int = 16  # over the whole circle
    toward: float = 0.5  # smallest cosine of a drag with the direction away from the walls
    length: float = 0.06  # maximum
    room: float = 0.002  # free space between the fingertip and the walls
    above: float = 0.010  # of the fingertip above the piece at the start
    press: float = 0.012  # maximum descent below the visible surface
    clearance: float = 0.005  # of the hand above everything below its path
    least_rise: float = 0.003  # minimum rise of a piece in front of the fingertip, if it does not roll
    flat: float = 0.004  # height below the top down to which a piece counts as flat there
    roll: float = 0.7  # maximum share of the flat part of a piece that rolls, along the drag
    kept: int = 12  # maximum number of candidates

    def __post_init__(self) -> None:
        require(self.directions >= 4, f"directions is {self.directions}, it must be at least 4")
        for name in ("length", "room", "above", "press", "least_rise"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")


@dataclass(frozen=True, eq=False)
class HeapDrag(Grasp):
    """Drag of one piece of a heap: the pose of the open hand above the piece, in the world frame, the descent
    until one fingertip presses on the piece, and the pull that follows.

    The grasp's score is the predicted gain [m] of the piece's mean distance from walls and other pieces.
    """

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m, world] longest descent
    pull: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m, world] after the descent

    @property
    def angle(self) -> float:
        """Return the direction [rad] of a drag's pull, about the world's z axis."""
        return float(np.arctan2(self.pull[1], self.pull[0]))

    @property
    def contact(self) -> tuple[float, float]:
        """Return x and y [m, world] of the front edge of the fingertip that drags the piece."""
        back = 0.5 * self.opening * self.T_object_tcp.rotation.matrix[:2, 1]
        x, y = self.T_object_tcp.translation[:2] - back
        return float(x), float(y)


def drags_off_walls(
    seen: HeightMap,
    labels: NDArray[np.int64],
    where: NDArray[np.bool_],
    floor: float,
    hand: Hand,
    settings: DragSettings = DragSettings(),
    avoid: Sequence[tuple[float, float]] = (),
) -> list[HeapDrag]:
    """Return drags that move pieces away from walls, sorted by the predicted gain of room around the piece.

    Pieces that touch each other count as one. The prediction moves the piece with the fingertip, without a
    turn.

    Args:
        labels: (nx, ny) piece number of each cell, -1 for none.
        where: (nx, ny) cells over which a piece may move; it cannot fall off them.
        floor: [m, world z] height of the surface below the heap.
        avoid: x, y [m] of the contacts of earlier drags. Drags near `TRIES` of them are left out.
    Raises:
        InputError: the sizes of map and labels differ.
    """
    from scipy.ndimage import distance_transform_edt

    s = settings
    hidden = where & ~seen.seen  # mostly gaps between a piece and a wall
    found: list[HeapDrag] = []
    for piece in touching_pieces(seen, labels, where):
        outline, _, middle, _ = outline_of(seen, piece)
        others = np.where(piece | hidden, floor, seen.heights)
        free = (others <= floor + 0.5 * s.clearance) & where
        room = np.asarray(distance_transform_edt(free)) * seen.resolution
        away = away_from_obstacles(seen, room, outline)
        if not away.any():
            continue
        for angle in 2 * np.pi * np.arange(s.directions) / s.directions:
            along = np.array([np.cos(angle), np.sin(angle)])
            if along @ away < s.toward:
                continue
            drag = _Search(seen, piece, others, room, floor, hand, s).best(along, outline, middle)
            if drag is not None and _tries(drag, avoid) < TRIES:
                found.append(drag)
    found.sort(key=lambda drag: -drag.score)
    return found[: s.kept]


def _tries(drag: HeapDrag, earlier: Sequence[tuple[float, float]]) -> int:
    """Return how many earlier drags touched probably the same piece, by their contacts x, y [m]."""
    return sum(bool(np.hypot(*np.subtract(drag.contact, at)) <= SAME_PIECE) for at in earlier)


class _Search:
    """Search for the best drag of one piece in a given direction."""

    def __init__(
        self, seen: HeightMap, piece: NDArray[np.bool_], others: Array, room: Array, floor: float, hand: Hand,
        settings: DragSettings,
    ):  # fmt: skip
        self._seen, self._piece, self._others, self._room = seen, piece, others, room
        self._floor, self._hand, self._settings = floor, hand, settings
        fingers = np.concatenate([hand.left, hand.right])
        self._tip_z = float(fingers[:, 5].max())
        self._half = float(np.abs(fingers[:, [0, 3]]).max())
        self._thick = float(np.abs(fingers[:, [1, 4]]).max())
        self._palm = np.abs(hand.palm[:, [1, 4]]).max(), np.abs(hand.palm[:, [0, 3]]).max()
        self._length = self._tip_z - float(hand.palm[:, 5].max())

    def best(self, along: Array, outline: Array, middle: Array) -> HeapDrag | None:
        """Return the best drag in the direction `along`, or None if there is none."""
        s, step = self._settings, self._seen.resolution
        shift, gain = self._gain(along, outline)
        if gain <= 0:
            return None
        across = np.array([-along[1], along[0]])
        at = self._seen.at(np.argwhere(self._piece))[:, :2]
        u, v = (at - middle) @ along, (at - middle) @ across
        best: tuple[float, Array, float] | None = None
        for aside in np.arange(-0.5 * v.std(), 0.5 * v.std() + 1e-9, step):
            for front in np.arange(u.min() + step, u.max() + self._thick, step):
                edge = middle + front * along + aside * across
                fits = self._surface(edge, along, across)
                if fits is None:
                    continue
                surface, rise = fits
                value = min(rise, 0.008) - 0.1 * abs(aside)
                if best is not None and value <= best[0]:
                    continue
                if self._is_free(edge, along, across, surface, shift):
                    best = value, edge, surface
        if best is None:
            return None
        _, edge, surface = best
        turn = float(np.arctan2(along[1], along[0]))
        center = edge + 0.5 * self._hand.gripper.max_width * along
        z = surface + s.above + self._tip_z
        y, approach = np.array([along[0], along[1], 0.0]), np.array([0.0, 0.0, -1.0])
        T = SE3(SO3(np.column_stack([np.cross(y, approach), y, approach])), np.array([*center, z]))
        width, force = self._hand.gripper.max_width, self._hand.gripper.max_force
        return HeapDrag(
            f"drag by {1000 * shift:.0f} mm at {np.rad2deg(turn):.0f} deg", T, width, width, force, gain,
            offset=(0.0, 0.0, -s.above - s.press),
            pull=(float(shift * along[0]), float(shift * along[1]), 0.0),
        )  # fmt: skip

    def _gain(self, along: Array, outline: Array) -> tuple[float, float]:
        """Return the shift [m] of a piece at which it has the most room, and the gain of room [m]."""
        s, seen = self._settings, self._seen
        before, best = self._mean_room(outline), (0.0, 0.0)
        for shift in np.arange(seen.resolution, s.length + 1e-9, seen.resolution):
            moved = outline + shift * along
            i, j = self._cells(moved)
            if np.count_nonzero(self._room[i, j] <= 0) > np.count_nonzero(self._room_at(outline) <= 0):
                break
            if (gain := self._mean_room(moved) - before) > best[1]:
                best = float(shift), float(gain)
        return best

    def _room_at(self, points: Array) -> Array:
        i, j = self._cells(points)
        return self._room[i, j]

    def _mean_room(self, points: Array) -> float:
        return float(np.minimum(self._room_at(points), 0.03).mean())

    def _cells(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        cells = np.round((points - self._seen.origin) / self._seen.resolution).astype(np.int64)
        i, j = np.clip(cells, 0, np.array(self._seen.heights.shape) - 1).T
        return i, j

    def _below(
        self, edge: Array, along: Array, across: Array, u: tuple[float, float], v: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the cells below a rectangle at the front edge of a dragging finger: from u[0] to u[1] [m]
        along the drag, and at most v [m] aside.
        """
        step = self._seen.resolution
        a, b = np.meshgrid(
            np.arange(u[0], u[1] + 1e-9, step), np.linspace(-v, v, int(np.ceil(2 * v / step)) + 1)
        )
        return self._cells(edge + a.reshape(-1, 1) * along + b.reshape(-1, 1) * across)

    def _surface(self, edge: Array, along: Array, across: Array) -> tuple[float, float] | None:
        """Return the height [m, world z] at which a fingertip behind `edge` touches the dragged piece, and
        the rise [m] of the piece in front of it. Return None if the fingertip finds no hold, or touches
        anything else.
        """
        s, seen = self._settings, self._seen
        i, j = self._below(edge, along, across, (-self._thick, 0.0), self._half)
        surface = float(np.where(self._piece[i, j], seen.heights[i, j], -np.inf).max())
        if surface < self._floor + NEAR_FLOOR:
            return None
        i, j = self._below(edge, along, across, (-self._thick - s.room, 0.0), self._half + s.room)
        if float(self._others[i, j].max()) > surface - s.press:
            return None
        # medians: single heights have too much noise
        rise = self._median(edge, along, across, (0.0, 0.02))
        rise -= self._median(edge, along, across, (-self._thick, 0.0))
        least = -NOISE if self._rolls(edge, along, across) else s.least_rise
        return (surface, rise) if rise >= least else None

    def _median(self, edge: Array, along: Array, across: Array, u: tuple[float, float]) -> float:
        """Return the median height [m] of the dragged piece below a part of the fingertip's path, or NaN if
        there are too few cells for a median.
        """
        i, j = self._below(edge, along, across, u, self._half)
        heights = self._seen.heights[i, j][self._piece[i, j]]
        return float(np.median(heights)) if len(heights) >= FEWEST else np.nan

    def _rolls(self, edge: Array, along: Array, across: Array) -> bool:
        """Return whether the top of a piece is so curved along the drag that the piece may roll."""
        s, seen = self._settings, self._seen
        i, j = self._below(edge, along, across, (-LONGEST, LONGEST), self._half)
        strip = np.where(self._piece[i, j], seen.heights[i, j], np.nan)
        strip = strip.reshape(-1, int(2 * LONGEST / seen.resolution + 1e-6) + 1)
        strip = strip[:, np.isfinite(strip).any(0)]
        profile = np.nanmedian(strip, axis=0)
        return float(np.mean(profile > profile.max() - s.flat)) < s.roll

    def _is_free(self, edge: Array, along: Array, across: Array, surface: float, shift: float) -> bool:
        """Return whether the hand touches nothing but the dragged piece during a drag.

        The finger in front and the palm stay above the dragged piece.
        """
        s, opening = self._settings, self._hand.gripper.max_width
        tip = surface - s.press
        i, j = self._below(edge, along, across, (-self._thick - s.room, shift), self._half + s.room)
        if float(self._others[i, j].max()) > tip:
            return False
        i, j = self._below(edge, along, across, (opening, opening + self._thick + shift), self._half + s.room)
        if float(self._others[i, j].max()) > tip:
            return False
        i, j = self._below(edge, along, across, (opening, opening + self._thick), self._half + s.room)
        if float(self._seen.heights[i, j].max()) > tip:
            return False
        middle, (reach, wide) = opening / 2, self._palm
        i, j = self._below(edge, along, across, (middle - reach, middle + reach + shift), wide)
        return float(self._seen.heights[i, j].max()) < tip + self._length - s.clearance
