"""Poses of objects in MuJoCo: free objects in the state, fixed objects in the model."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3

Array = NDArray[np.float64]
Poses = tuple[Array, Array]
"""Positions (body, 3) [m] and quaternions (body, 4), wxyz, of all bodies in parent frames."""


def write_free(data: mujoco.MjData, start: int, T_world_object: SE3) -> None:
    """Write the pose of a free object into MuJoCo's qpos.
    The entries of the object's joint begin at index `start`.
    """
    data.qpos[start : start + 3] = T_world_object.translation
    data.qpos[start + 3 : start + 7] = T_world_object.quat_wxyz


class FixedBodyPoses:
    """Poses of the fixed bodies in a compiled MuJoCo model. They can be changed until the next reset."""

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self._first = self.get_state()

    def put(self, body: int, T_world_body: SE3) -> None:
        self._model.body_pos[body] = T_world_body.translation
        self._model.body_quat[body] = T_world_body.quat_wxyz

    def has_moved(self, body: int) -> bool:
        """Return whether the current pose of a fixed body differs
        from its pose in the compiled MuJoCo model.
        """
        position, quaternion = self._first
        moved = (self._model.body_pos[body] != position[body]).any()
        return bool(moved or (self._model.body_quat[body] != quaternion[body]).any())

    def reset(self) -> None:
        self.set_state(self._first)

    def get_state(self) -> Poses:
        return self._model.body_pos.copy(), self._model.body_quat.copy()

    def set_state(self, poses: Poses) -> None:
        self._model.body_pos[:], self._model.body_quat[:] = poses
