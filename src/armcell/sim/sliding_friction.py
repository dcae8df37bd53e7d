"""Selection between static and dynamic friction of objects by their slip speed.

MuJoCo has one Coulomb coefficient per contact. A sticking contact needs the static coefficient and a sliding
contact the dynamic one, so an object's coefficient must change with its slip speed. All contacts of an object
share one coefficient: the object slides when every loaded contact slips, and uses its dynamic coefficient
until it rests again. A held object that is dragged over a table therefore keeps its static friction in the
hand.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.built_model import BuiltModel

Array = NDArray[np.float64]

SLIDES = 0.02  # [m/s] an object starts to slide when all its contacts are faster than this
RESTS = 0.005  # [m/s] it rests when one contact is slower; a firm grasp creeps at micrometers per second


class SlidingFriction:
    """Controller that switches objects between static and dynamic friction,
    depending on whether they are slipping.

    Attributes:
        owners: (k,) indices of these objects in `BuiltModel.owners`.
    """

    def __init__(self, built: BuiltModel):
        self._mj, self._owner = built.mj, np.asarray(built.geom_owner)
        two = [item for item in built.objects.values() if item.material.dynamic_friction is not None]
        moving = [item for item in two if item.name in built.object_dof]
        self.owners = [built.owner_index[item.name] for item in moving]
        self._geoms = [np.flatnonzero(self._owner == owner) for owner in self.owners]
        self._static = [item.material.friction for item in moving]
        self._dynamic = [item.material.sliding for item in moving]
        self._slides = [False] * len(moving)

    def __bool__(self) -> bool:
        return bool(self.owners)

    def reset(self) -> None:
        """Reset all objects to static friction, as if none of them were slipping."""
        self.set_state((False,) * len(self.owners))

    def get_state(self) -> tuple[bool, ...]:
        """Return whether each object with static and dynamic friction
        is slipping in the physics simulation.
        """
        return tuple(self._slides)

    def set_state(self, slides: tuple[bool, ...]) -> None:
        for k, value in enumerate(slides):
            self._put(k, value)

    def _put(self, k: int, slides: bool) -> None:
        self._slides[k] = slides
        self._mj.geom_friction[self._geoms[k], 0] = self._dynamic[k] if slides else self._static[k]

    def update(self, data: mujoco.MjData) -> None:
        """Select static or dynamic friction for the next physics step, depending on which objects are
        slipping in the current contacts.

        Call this after each step.
        """
        owners, speeds = self._slips(data)
        for k, owner in enumerate(self.owners):
            mine = speeds[(owners == owner).any(axis=1)]
            if not len(mine):  # without contact, the object keeps its friction until the next contact
                continue
            slowest = float(mine.min())
            if self._slides[k] and slowest < RESTS:
                self._put(k, False)
            elif not self._slides[k] and slowest > SLIDES:
                self._put(k, True)

    def _slips(self, data: mujoco.MjData) -> tuple[NDArray[np.int64], Array]:
        """Return the pairs of bodies (n, 2) and slip speeds (n,) [m/s] of all contacts that transmit a force,
        to select static or dynamic friction.
        """
        contact = data.contact
        loaded = contact.efc_address >= 0
        loaded[loaded] = data.efc_force[contact.efc_address[loaded]] > 0
        geoms, pos = contact.geom[loaded], contact.pos[loaded]
        normal = contact.frame[loaded][:, :3]
        bodies = self._mj.geom_bodyid[geoms]
        # cvel is angular over linear velocity at the center of mass of the body's tree, in world axes
        arms = pos[:, None] - data.subtree_com[self._mj.body_rootid[bodies]]
        velocity = data.cvel[bodies][..., 3:] + np.cross(data.cvel[bodies][..., :3], arms)
        relative = velocity[:, 1] - velocity[:, 0]
        tangential = relative - normal * np.sum(relative * normal, axis=1, keepdims=True)
        return self._owner[geoms], np.linalg.norm(tangential, axis=1)
