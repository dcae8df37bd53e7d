"""Joint positions along a motion, as a function of a path parameter s in 0..1."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Curve(Protocol):
    """Twice continuously differentiable."""

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """Positions and first and second derivatives (m, n) at s (m,)."""
        ...

    def polyline(self, sagitta: float) -> tuple[Array, Array]:
        """Points (k, n) on the curve, and how far each joint (n,) is at most from their chords."""
        ...


class JointLine:
    """A straight line in joint space."""

    def __init__(self, start: Array, goal: Array):
        self.start, self.step = start, goal - start

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        first = np.tile(self.step, (len(s), 1))
        return self.start + s[:, None] * self.step, first, np.zeros_like(first)

    def polyline(self, sagitta: float) -> tuple[Array, Array]:
        return np.array([self.start, self.start + self.step]), np.zeros(len(self.start))


class JointSpline:
    """A cubic spline through points (k, n) at x (k,).

    Args:
        ends: first derivatives (2, n) at both ends, where they are given.
    """

    def __init__(self, x: Array, points: Array, ends: Array | None = None):
        from scipy.interpolate import CubicSpline  # takes a quarter of a second to import

        bc: Any = "not-a-knot" if ends is None else ((1, ends[0]), (1, ends[1]))
        self.x, self.spline = x, CubicSpline(x, points, bc_type=bc)

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        return self.spline(s), self.spline(s, 1), self.spline(s, 2)

    def polyline(self, sagitta: float) -> tuple[Array, Array]:
        # Second derivatives are linear between knots, so they are largest at knots; a chord over h is at
        # most h^2 / 8 of them away.
        bend = np.abs(self.spline(self.x, 2)).max(axis=0)
        span = self.x[-1] - self.x[0]
        count = max(int(np.ceil(span * np.sqrt(bend.max() / 8 / sagitta))), 1)
        return self.spline(np.linspace(self.x[0], self.x[-1], count + 1)), bend * (span / count) ** 2 / 8
