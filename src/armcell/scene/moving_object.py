"""Obstacles with a known motion, such as a box on a conveyor, a door or another arm's load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, InputError
from armcell.core.checks import float_array
from armcell.core.geometry import local_bounds
from armcell.scene.objects import CollisionObject

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MovingObject:
    """Moving obstacle with a known motion: an object whose poses are given at times (k,) [s].

    Between two times the object moves in a straight line and turns evenly; before the first and after the
    last time it is at rest. `object.T_world_object` is ignored.
    """

    object: CollisionObject
    times: Array
    poses: tuple[SE3, ...]  # T_world_object

    def __post_init__(self) -> None:
        name, times = self.object.name, np.array(float_array(self.times, None, "times", finite=False))
        object.__setattr__(self, "times", times)
        if times.ndim != 1 or len(times) == 0 or len(times) != len(self.poses):
            raise InputError(f"moving object {name!r} has {len(self.poses)} poses at {times.size} times")
        if not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
            raise InputError(f"moving object {name!r}: its times must be finite and increase")
        if self.object.has_cloud or not np.isfinite(self.reach):
            raise InputError(f"moving object {name!r}: a cloud or plane cannot move")
        # Upper bound of the distance [m] that any point of the object has moved by each time.
        far = [a.distance_to(b) for a, b in zip(self.poses, self.poses[1:], strict=False)]
        steps = [meters + radians * self.reach for meters, radians in far]
        object.__setattr__(self, "_travelled", np.concatenate([[0.0], np.cumsum(steps)]))

    @property
    def name(self) -> str:
        return self.object.name

    @property
    def reach(self) -> float:
        """Return an upper bound on the distance [m] from the origin
        of a moving obstacle to any of its points.
        """
        found = 0.0
        for shape, T in self.object.shapes:
            center, half = local_bounds(shape)
            limit = np.inf if half.max() >= 50 else np.linalg.norm(half)  # a plane is infinite
            found = max(found, float(np.linalg.norm(T.apply(center)) + limit))
        return found

    def pose(self, t: float) -> SE3:
        """Return the pose T_world_object of a moving obstacle at time `t` [s]."""
        i = int(np.searchsorted(self.times, t, side="right")) - 1
        if i < 0:
            return self.poses[0]
        if i >= len(self.times) - 1:
            return self.poses[-1]
        share = (t - self.times[i]) / (self.times[i + 1] - self.times[i])
        return self.poses[i].interpolate(self.poses[i + 1], float(share))

    def travel(self, t0: float, t1: float) -> float:
        """Return an upper bound on how far [m] a moving object of the scene travels between the times t0 and
        t1 [s].

        The bound holds for every point of the object.
        """
        a, b = np.interp([t0, t1], self.times, self._travelled)  # pyright: ignore[reportAttributeAccessIssue]
        return float(b - a)

    def swept(self, t0: float, t1: float, step: float = 0.02, most: int = 200) -> CollisionObject:
        """Return one fixed object that consists of copies of a moving object along its path between the times
        t0 and t1.

        The result does not cover the space between the copies, so a motion planned around it must still be
        checked against the moving object at its times.

        Args:
            t0, t1: start and end time [s].
            step: largest travel between two copies [m].
            most: maximum number of intervals between copies.
        """
        count = int(np.clip(np.ceil(self.travel(t0, t1) / step), 1, most)) + 1
        fine = np.union1d(np.linspace(t0, t1, 20 * count), self.times[(self.times > t0) & (self.times < t1)])
        way = np.interp(fine, self.times, self._travelled)  # pyright: ignore[reportAttributeAccessIssue]
        at = np.interp(np.linspace(way[0], way[-1], count), way, fine) if way[-1] > way[0] else [t0]
        shapes = [(shape, self.pose(float(t)) @ T) for t in at for shape, T in self.object.shapes]
        return CollisionObject(self.name, tuple(shapes), color=self.object.color)
