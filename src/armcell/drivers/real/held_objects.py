"""Objects that the grippers of real arms hold, without a sensor for objects."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from armcell.core import SE3
from armcell.scene import PlanningScene

LOST = 0.003  # [m] decrease of a hand's width after which the object that it held is no longer there


class _HeldObject(NamedTuple):
    """Object that a real arm's gripper holds, as the driver recorded it at the grasp."""

    name: str
    T_tcp_object: SE3
    width: float  # [m] of the hand when it grasped the object


class HeldObjects:
    """Poses of a scene's movable objects in mode `real`: a held object moves with its gripper.

    Attributes:
        poses: T_world_object of each movable object, by name.
    """

    def __init__(self, scene: PlanningScene):
        self._scene = scene
        self.poses = {n: o.T_world_object for n, o in scene.objects.items() if o.movable}
        self._held: dict[str, _HeldObject] = {}
        self._lost: set[str] = set()  # grippers whose object slipped away; they have not opened since

    @property
    def held(self) -> dict[str, str]:
        """Return the names of the objects that real arms hold, by gripper."""
        return {gripper: held.name for gripper, held in self._held.items()}

    def correct(self, name: str, T_world_object: SE3) -> None:
        """Correct the believed pose of a movable object that no real arm holds."""
        if name in self.poses and name not in self.held.values():
            self.poses[name] = T_world_object

    def release(self, gripper: str) -> None:
        """Record that the gripper of a real arm opens, so that it no longer holds an object."""
        self._held.pop(gripper, None)
        self._lost.discard(gripper)

    def update(self, gripper: str, T_world_tcp: SE3, width: float, holds: bool) -> None:
        """Update the object poses for a real arm's gripper: the object that it holds moves with it.

        Args:
            gripper: name of the gripper.
            T_world_tcp: pose of its tcp.
            width: measured width [m].
            holds: whether the gripper reports that it holds an object.
        """
        held = self._held.get(gripper)
        if held is not None and (not holds or width < held.width - LOST):
            del self._held[gripper]
            self._lost.add(gripper)
        elif held is not None:
            self.poses[held.name] = T_world_tcp @ held.T_tcp_object
        elif holds and gripper not in self._lost:
            for name, pose in self.poses.items():
                low, high = self._scene.object(name).bounds()
                point = pose.inverse().apply(T_world_tcp.translation)
                if np.all(point >= low) and np.all(point <= high):
                    self._held[gripper] = _HeldObject(name, T_world_tcp.inverse() @ pose, width)
                    break
