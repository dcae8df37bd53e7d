"""A smooth path from straight edges: corners rounded by circular arcs of bounded deviation.

Kunz and Stilman, "Time-optimal trajectory generation for path following with bounded acceleration and
velocity" (RSS 2012), section IV. The path is parameterised by its length s [rad].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError

Array = NDArray[np.float64]

MIN_EDGE = 1e-6  # [rad] shorter edges are dropped


@dataclass(frozen=True, eq=False)
class Piece:
    """A line `origin + s x`, or (finite radius) an arc `origin + r (x cos(s/r) + y sin(s/r))`."""

    origin: Array
    x: Array  # unit
    y: Array
    length: float
    radius: float = np.inf

    def start(self) -> Array:
        return self.origin if np.isinf(self.radius) else self.origin + self.radius * self.x

    def end(self) -> Array:
        if np.isinf(self.radius):
            return self.origin + self.length * self.x
        angle = self.length / self.radius
        return self.origin + self.radius * (np.cos(angle) * self.x + np.sin(angle) * self.y)


class BlendedPath:
    """Lines and arcs through (or near) waypoints (k, n). Corners that may not be rounded keep their
    point: the motion has to stop there (`stops` are their path lengths).

    Args:
        max_deviation: how far a corner may be cut [rad]; one number or one per inner waypoint.
    """

    def __init__(self, waypoints: ArrayLike, max_deviation: float | ArrayLike = 0.05):
        points = np.asarray(waypoints, dtype=float)
        if not np.all(np.isfinite(points)):
            raise InputError("a waypoint has a value that is not finite")
        deviation = np.broadcast_to(np.asarray(max_deviation, dtype=float), (max(len(points) - 2, 0),))
        keep = [0]
        for i in range(1, len(points)):
            if np.linalg.norm(points[i] - points[keep[-1]]) > MIN_EDGE:
                keep.append(i)
        self.points = points[keep]
        self.pieces: list[Piece] = []
        self.stops: list[float] = []
        self._build([float(deviation[i - 1]) if 0 < i < len(points) - 1 else 0.0 for i in keep])
        self.starts = np.concatenate([[0.0], np.cumsum([p.length for p in self.pieces])])
        if self.pieces:
            self._origin = np.array([p.origin for p in self.pieces])
            self._x = np.array([p.x for p in self.pieces])
            self._y = np.array([p.y for p in self.pieces])
            self._radius = np.array([p.radius for p in self.pieces])

    @property
    def length(self) -> float:
        return float(self.starts[-1])

    def _build(self, deviation: list[float]) -> None:
        points = self.points
        if len(points) < 2:
            return
        edges = np.diff(points, axis=0)
        lengths = np.linalg.norm(edges, axis=1)
        units = edges / lengths[:, None]
        begin, travelled = points[0], 0.0
        for i in range(1, len(points)):
            end, arc = points[i], None
            if i < len(points) - 1:
                arc = _corner(points[i], units[i - 1], units[i], lengths[i - 1], lengths[i], deviation[i])
            if arc is not None:
                end = arc.start()
            length = float(np.linalg.norm(end - begin))
            if length > 1e-12:
                self.pieces.append(Piece(begin, units[i - 1], np.zeros_like(begin), length))
                travelled += length
            if arc is not None:
                self.pieces.append(arc)
                travelled += arc.length
                begin = arc.end()
            else:
                begin = points[i]
                if i < len(points) - 1 and float(units[i - 1] @ units[i]) < 1 - 1e-9:
                    self.stops.append(travelled)

    def evaluate(self, piece: NDArray[np.int64], s: Array) -> tuple[Array, Array, Array]:
        """Points, unit tangents and curvature vectors (m, n) at lengths s (m,) within the pieces (m,)."""
        origin, x, y, radius = self._origin[piece], self._x[piece], self._y[piece], self._radius[piece]
        bent = np.isfinite(radius)[:, None]
        r = np.where(bent[:, 0], radius, 1.0)
        c, sn = np.cos(s / r)[:, None], np.sin(s / r)[:, None]
        outward = c * x + sn * y
        point = np.where(bent, origin + r[:, None] * outward, origin + s[:, None] * x)
        tangent = np.where(bent, c * y - sn * x, x)
        return point, tangent, np.where(bent, -outward / r[:, None], 0.0)

    def at(self, s: ArrayLike) -> tuple[Array, Array, Array]:
        """Points, unit tangents and curvature vectors (m, n) at path lengths s (m,)."""
        s = np.atleast_1d(np.asarray(s, dtype=float))
        piece = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, len(self.pieces) - 1)
        local = np.clip(s - self.starts[piece], 0.0, self.starts[piece + 1] - self.starts[piece])
        return self.evaluate(piece, local)

    def polyline(self, sagitta: float = 1e-4) -> Array:
        """Points (m, n) whose chords stay within `sagitta` [rad] of the path."""
        if not self.pieces:
            return self.points[:1]
        index, local = [0], [0.0]
        for i, piece in enumerate(self.pieces):
            count = 1
            if np.isfinite(piece.radius):
                count = max(int(np.ceil(piece.length / np.sqrt(8 * sagitta * piece.radius))), 2)
            index += [i] * count
            local += [piece.length * (k + 1) / count for k in range(count)]
        return self.evaluate(np.array(index), np.array(local))[0]


def _corner(point: Array, u: Array, v: Array, before: float, after: float, deviation: float) -> Piece | None:
    """The arc that rounds a corner between directions u and v; None where it stays sharp."""
    cosine = float(np.clip(u @ v, -1.0, 1.0))
    angle = float(np.arccos(cosine))  # by which the direction turns
    if angle < 1e-5 or angle > np.pi - 1e-3 or deviation <= 0:
        return None
    # The arc may use half of each neighbouring edge.
    reach = min(before / 2, after / 2, deviation * np.sin(angle / 2) / (1 - np.cos(angle / 2)))
    radius = reach / np.tan(angle / 2)
    middle = (v - u) / np.linalg.norm(v - u)
    centre = point + middle * radius / np.cos(angle / 2)
    x = (point - reach * u - centre) / radius
    return Piece(centre, x, u, float(angle * radius), float(radius))
