"""Estimates of the time in which an arm carries objects to their zones in a given order.

The estimate assumes straight joint-space motions: from above the nearest grasp of an object to the hand's
pose above the object's zone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, InputError
from armcell.core.checks import require
from armcell.grasping import grasp_candidates, hand_of, place_candidates
from armcell.scene import PlanningScene
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stages.reach import ReachEstimator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CycleTimes:
    """Cycle times for estimating the cost of a tour:
    the estimated durations of grasping and of placing an object.

    The defaults are means of 64 picks and 64 placements of two UR10 at a task's default speeds.
    """

    fetch: float = 3.4  # [s] to open, approach, close and lift
    put: float = 3.0  # [s] to lower, open and retreat

    def __post_init__(self) -> None:
        for name in ("fetch", "put"):
            require(getattr(self, name) >= 0, f"{name} is {getattr(self, name):g}, it must not be negative")


@dataclass(frozen=True, eq=False)
class TourSegment:
    """Segment of an arm's tour: one motion between two joint positions (n,), followed by work at its end."""

    motion: float  # [s]
    work: float = 0.0  # [s]
    zone: str = ""  # reserved from the start of the motion to the end of the work
    motion_ends: tuple[Array, Array] | None = None


class TourEstimator:
    """Estimator for the cost of a tour: the time in which an arm carries
    objects to their destinations in a given order and returns.

    Unreachable objects contribute no travel time.

    Args:
        zone: the destination object of each object.
    Raises:
        UnknownNameError: no such object.
    """

    def __init__(
        self,
        scene: PlanningScene,
        group: str,
        zone: Mapping[str, str],
        settings: TaskSettings,
        cycle_times: CycleTimes,
    ):
        self.scene, self.zone, self.settings, self.cycle_times = scene, zone, settings, cycle_times
        gripper = scene.model.gripper(arm_group=group)
        self._reaching = ReachEstimator(scene, gripper, settings.approach_distance)
        self._start = scene.positions[self._reaching.ik.columns]
        hand = hand_of(scene.model, gripper)
        self._grasps = {item: grasp_candidates(scene.object(item), hand)[0] for item in zone}
        self._placed = {item: self._on_zone(item) for item in zone}
        self._until = cache(self._fetched)  # orders with a common prefix share its segments

    def __call__(self, order: tuple[str, ...]) -> tuple[TourSegment, ...]:
        segments, q = self._until(order)
        seconds = self._reaching.seconds(q, self._start, self.settings.free)
        return (*segments, TourSegment(seconds, motion_ends=(q, self._start)))

    def _fetched(self, order: tuple[str, ...]) -> tuple[tuple[TourSegment, ...], Array]:
        """Return the segments of the arm's tour that places the objects in `order`, without the return
        motion. Also return the joint positions (n,) after the last segment.
        """
        if not order:
            return (), self._start
        (before, q), item, s = self._until(order[:-1]), order[-1], self.settings
        fetch, put, zone = self.cycle_times.fetch, self.cycle_times.put, self.zone[item]
        found = self._motions(item, q)
        if found is None:
            return (*before, TourSegment(0.0, fetch), TourSegment(0.0, put, zone)), q
        seconds, over, there = found
        bring = self._reaching.seconds(over, there, s.carry)
        return (
            *before,
            TourSegment(seconds, fetch, motion_ends=(q, over)),
            TourSegment(bring, put, zone, (over, there)),
        ), there

    def _motions(self, item: str, q: Array) -> tuple[float, Array, Array] | None:
        """Estimate how an arm fetches one object during its tour: the time [s] to reach it, and the joint
        positions above the object and above its zone.
        """
        s, pose = self.settings, self.scene.object(item).T_world_object
        near = self._reaching.nearest_first(pose, self._grasps[item], q, s.free)
        if not near or near[0].q is None:
            return None
        above = (self._placed[item] @ near[0].grasp.T_object_tcp).shifted(0.0, 0.0, s.lower_distance)
        there = self._reaching.ik_near(above, near[0].q)
        return None if there is None else (near[0].seconds, near[0].q, there)

    def _on_zone(self, item: str) -> SE3:
        """Return the pose of an object in the world after an arm has placed it in its zone."""
        body, zone = self.scene.object(item), self.scene.object(self.zone[item])
        try:
            return place_candidates(body, zone)[0].T_world_object
        except InputError:  # for example a box with walls: keep the present rotation
            return SE3(body.T_world_object.rotation, zone.T_world_object.translation)
