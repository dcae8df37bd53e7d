"""How long an arm takes to fetch things one after the other and to bring each where it goes: an estimate.

Between things it is taken to move straight in the joints' space: from above the nearest grasp of a thing to
above where that grasp has the hand when the thing stands on its zone.
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
from armcell.tasks.stages.reach import Reaching

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pace:
    """How long what is not a free motion is taken to need.

    By default as 64 picks and 64 placings of two UR10 took, at the speeds that a task has by default.
    """

    fetch: float = 3.4  # [s] to open, approach, close and lift
    put: float = 3.0  # [s] to lower, open and draw back

    def __post_init__(self) -> None:
        for name in ("fetch", "put"):
            require(getattr(self, name) >= 0, f"{name} is {getattr(self, name):g}, it must not be negative")


@dataclass(frozen=True, eq=False)
class Leg:
    """A motion of an arm between positions (n,), and its work where that ends."""

    motion: float  # [s]
    work: float = 0.0  # [s]
    zone: str = ""  # the arm's own from the beginning of the motion to the end of the work
    way: tuple[Array, Array] | None = None


class Errands:
    """Legs of an arm that brings its things in some order and goes back; what is out of reach takes no way.

    Args:
        zone: by thing, the object that it goes to.
    Raises:
        UnknownNameError: no such object.
    """

    def __init__(
        self, scene: PlanningScene, group: str, zone: Mapping[str, str], settings: TaskSettings, pace: Pace
    ):
        self.scene, self.zone, self.settings, self.pace = scene, zone, settings, pace
        gripper = scene.model.gripper(arm_group=group)
        self._reaching = Reaching(scene, gripper, settings.approach_distance)
        self._start = scene.positions[self._reaching.ik.columns]
        hand = hand_of(scene.model, gripper)
        self._grasps = {item: grasp_candidates(scene.object(item), hand)[0] for item in zone}
        self._placed = {item: self._on_zone(item) for item in zone}
        self._until = cache(self._fetched)  # orders that begin alike have the same legs there

    def __call__(self, order: tuple[str, ...]) -> tuple[Leg, ...]:
        legs, q = self._until(order)
        seconds = self._reaching.seconds(q, self._start, self.settings.free)
        return (*legs, Leg(seconds, way=(q, self._start)))

    def _fetched(self, order: tuple[str, ...]) -> tuple[tuple[Leg, ...], Array]:
        """The legs until the last thing is on its zone, and the arm's positions (n,) there."""
        if not order:
            return (), self._start
        (before, q), item, s = self._until(order[:-1]), order[-1], self.settings
        fetch, put, zone = self.pace.fetch, self.pace.put, self.zone[item]
        found = self._ways(item, q)
        if found is None:
            return (*before, Leg(0.0, fetch), Leg(0.0, put, zone)), q
        seconds, over, there = found
        bring = self._reaching.seconds(over, there, s.carry)
        return (*before, Leg(seconds, fetch, way=(q, over)), Leg(bring, put, zone, (over, there))), there

    def _ways(self, item: str, q: Array) -> tuple[float, Array, Array] | None:
        """The time [s] from positions (n,) to above a thing, and the positions there and above its zone."""
        s, pose = self.settings, self.scene.object(item).T_world_object
        near = self._reaching.nearest_first(pose, self._grasps[item], q, s.free)
        if not near or near[0].q is None:
            return None
        above = (self._placed[item] @ near[0].grasp.T_object_tcp).shifted(0.0, 0.0, s.lower_distance)
        there = self._reaching.to(above, near[0].q)
        return None if there is None else (near[0].seconds, near[0].q, there)

    def _on_zone(self, item: str) -> SE3:
        """T_world_object when the thing stands on its zone."""
        thing, zone = self.scene.object(item), self.scene.object(self.zone[item])
        try:
            return place_candidates(thing, zone)[0].T_world_object
        except InputError:  # a box of walls, say: it goes in as it is turned now
            return SE3(thing.T_world_object.rotation, zone.T_world_object.translation)
