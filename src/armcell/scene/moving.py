"""An obstacle whose motion is known: a belt's box, a door, another arm's load."""

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
    """An object with poses at times (k,) [s]: straight and evenly between them, at rest before and after.

    The object's own pose does not count.
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
        # Metres that any of its points can have moved up to each time.
        far = [a.distance_to(b) for a, b in zip(self.poses, self.poses[1:], strict=False)]
        steps = [metres + radians * self.reach for metres, radians in far]
        object.__setattr__(self, "_travelled", np.concatenate([[0.0], np.cumsum(steps)]))

    @property
    def name(self) -> str:
        return self.object.name

    @property
    def reach(self) -> float:
        """[m] from the object's origin to its farthest point, or a bit more."""
        found = 0.0
        for shape, T in self.object.shapes:
            centre, half = local_bounds(shape)
            limit = np.inf if half.max() >= 50 else np.linalg.norm(half)  # a plane has no end
            found = max(found, float(np.linalg.norm(T.apply(centre)) + limit))
        return found

    def pose(self, t: float) -> SE3:
        """T_world_object at a time [s]."""
        i = int(np.searchsorted(self.times, t, side="right")) - 1
        if i < 0:
            return self.poses[0]
        if i >= len(self.times) - 1:
            return self.poses[-1]
        share = (t - self.times[i]) / (self.times[i + 1] - self.times[i])
        return self.poses[i].interpolate(self.poses[i + 1], float(share))

    def travel(self, t0: float, t1: float) -> float:
        """[m] that no point of it moves more than between two times."""
        a, b = np.interp([t0, t1], self.times, self._travelled)  # pyright: ignore[reportAttributeAccessIssue]
        return float(b - a)

    def swept(self, t0: float, t1: float, step: float = 0.02, most: int = 200) -> CollisionObject:
        """One standing object of copies along the way between two times, `step` [m] of travel apart.

        What lies between copies is not in it: a motion planned around it has to be proven with the times.
        """
        count = int(np.clip(np.ceil(self.travel(t0, t1) / step), 1, most)) + 1
        fine = np.union1d(np.linspace(t0, t1, 20 * count), self.times[(self.times > t0) & (self.times < t1)])
        way = np.interp(fine, self.times, self._travelled)  # pyright: ignore[reportAttributeAccessIssue]
        at = np.interp(np.linspace(way[0], way[-1], count), way, fine) if way[-1] > way[0] else [t0]
        shapes = [(shape, self.pose(float(t)) @ T) for t in at for shape, T in self.object.shapes]
        return CollisionObject(self.name, tuple(shapes), color=self.object.color)
