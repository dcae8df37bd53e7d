"""Smooth paths through waypoints: straight lines, and corners rounded by arcs or splines.

The deviation at each corner is bounded. Arcs: Kunz and Stilman, "Time-optimal trajectory generation for path
following with bounded acceleration and velocity" (RSS 2012), section IV.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError
from armcell.core.checks import float_array, is_number
from armcell.timing import path_pieces

Array = NDArray[np.float64]


class BlendedPath:
    """Joint path that consists of straight lines and rounded corners (blends), and passes through or near
    waypoints (k, n).

    A corner that may not be rounded remains sharp, and the motion must stop there; `stops` contains the path
    parameters of these corners.

    The path parameter s [rad] is the arc length on lines and arcs. On spline corners s advances slightly
    faster than the arc length: the derivative of the path by s is shorter than 1.

    Args:
        waypoints: (k, n) joint positions.
        max_deviation: maximum distance [rad] between a corner and the rounded path; one value, or one per
            inner waypoint.
        smooth: round corners with splines, whose curvature is continuous, as jerk limits require; otherwise
            with arcs.
    Raises:
        InputError: no waypoint, a non-finite value, or a negative deviation.
    """

    def __init__(self, waypoints: ArrayLike, max_deviation: float | ArrayLike = 0.05, smooth: bool = False):
        # a copy, because the compiled code requires writable arrays
        points = np.array(float_array(waypoints, (None, None), "waypoints"))
        if points.size == 0:
            raise InputError(f"waypoints have shape {points.shape}, need (k, n), k >= 1")
        if not isinstance(smooth, bool | np.bool_):
            raise InputError(f"smooth is {smooth!r}, it must be True or False")
        deviation = np.zeros(len(points))
        if np.ndim(max_deviation) > 0 and np.shape(max_deviation) != (max(len(points) - 2, 0),):
            raise InputError(
                f"{np.shape(max_deviation)} deviations given for {max(len(points) - 2, 0)} inner waypoints"
            )
        deviation[1:-1] = max_deviation
        if not (deviation >= 0.0).all():
            raise InputError("a corner's max_deviation is negative or not a number")
        self.smooth = smooth
        keep = path_pieces.distinct(points)
        if not keep.all():
            points, deviation = points[keep], deviation[keep]
        self.points = points
        count, kind, origin, x, y, length, radius, turn, stop = path_pieces.build(points, deviation, smooth)
        self.kind, self.radius, self.turn = kind[:count], radius[:count], turn[:count]
        self.origin, self.x, self.y = origin[:count], x[:count], y[:count]
        self.lengths, self.rests = length[:count], stop[:count]
        self.starts = np.zeros(count + 1)  # path parameter at the start of each piece, and at the end
        np.cumsum(self.lengths, out=self.starts[1:])

    @property
    def length(self) -> float:
        return float(self.starts[-1])

    @property
    def stops(self) -> list[float]:
        """Path parameters s [rad] of the sharp corners of a blended path, at which the motion must stop."""
        return self.starts[1:][self.rests].tolist()

    @property
    def arrays(self) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Pieces of a blended path as a tuple of arrays (kind, origin, x, y, lengths, radius), which is the
        form that the compiled functions require.
        """
        return self.kind, self.origin, self.x, self.y, self.lengths, self.radius

    def evaluate(self, piece: NDArray[np.int64], s: Array) -> tuple[Array, Array, Array]:
        """Return points (m, n) on given pieces of a blended path, with the first and second derivatives with
        respect to the path parameter.

        Args:
            piece: (m,) indices of path pieces.
            s: (m,) path parameters, each measured from the start of its piece.
        Raises:
            InputError: an index is out of range, or the arrays have different lengths.
        """
        piece = np.array(float_array(piece, (None,), "piece"), dtype=np.int64)
        s = np.array(float_array(s, (None,), "s"))
        if piece.shape != s.shape or ((piece < 0) | (piece >= len(self.kind))).any():
            raise InputError(f"piece must be {len(s)} numbers from 0 to {len(self.kind) - 1}")
        return path_pieces.evaluate(*self.arrays, piece, s)

    def at(self, s: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the points (m, n) of a blended path at path parameters s (m,), with their first and second
        derivatives.
        """
        s = np.atleast_1d(float_array(s, None, "s"))
        piece = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, len(self.kind) - 1)
        return self.evaluate(piece, np.clip(s - self.starts[piece], 0.0, self.lengths[piece]))

    def polyline(self, sagitta: float = 1e-4) -> Array:
        """Return the points (m, n) of a polyline that approximates a blended path. The polyline deviates from
        the path by at most `sagitta` [rad].

        Raises:
            InputError: `sagitta` is not a positive number.
        """
        if not (is_number(sagitta) and sagitta > 0):
            raise InputError(f"sagitta is {sagitta!r}, it must be a positive number [rad]")
        if self.length == 0.0:
            return self.points[:1]
        return path_pieces.chords(*self.arrays, self.turn, float(sagitta))
