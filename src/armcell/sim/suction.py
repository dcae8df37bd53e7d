"""Suction cups in physics: contact, and a vacuum force that is bounded by pressure times area.

Each cup is a ring of `RING` small spheres (`cups.py`), on which a held surface rests, and a MuJoCo adhesion
actuator. MuJoCo's adhesion pulls along the contact normals and divides the force equally among the contacts,
so a ring that touches everywhere is pulled like a surface under uniform pressure ("adhesion" in MuJoCo's XML
reference). Contacts count within the stroke of the cup's lip. A cup seals while all its spheres touch the
same body; otherwise it leaks and does not pull. The ring therefore carries at most

- a pull of F = pressure x area along the normal,
- friction mu (F - pull) along the surface, with the object's coefficient,
- a tilting moment r (F - pull) about the ring's edge.

Schmalz gives the same formulas for the pull and the friction of a cup ("Theoretical Holding Force of a
Suction Cup", https://www.schmalz.com). The vacuum of a sealed cup rises exponentially, and is lost at once
when the cup leaks.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.model import SuctionGripper
from armcell.sim.cups import RING
from armcell.sim.mujoco_model import BuiltModel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SETTLED = 0.9  # fraction of the vacuum at which a cup counts as holding

ON, LEVEL, RATE, CUP_CONTROL = range(4)
CUP_LAW = 4
"""Number of columns of a cup's row in `law`; see `Suction`."""


class Suction:
    """Vacuum simulation of all suction cups. The compiled physics stepper uses its arrays.

    Attributes:
        law: (c, 4) one row per cup: whether the vacuum is on, its level from 0 to 1, the share of the missing
            level that one physics step adds, and the control index.
        beads: (ngeom,) number of the sphere, cup times `RING` plus position, or -1 for other geoms.
        sealed: (c,) owner index of the body on which each cup seals, or -1.
        holds: (c,) row of each cup's gripper in `fingers`, and the cup's link among the owners, (c, 2).
        fingers: (g, f) `HeldObjectCorrection`'s table of the links that hold an object, changed in place.
    """

    def __init__(self, built: BuiltModel, timestep: float, fingers: Ints):
        mj, cups = built.mj, built.cups
        self._cups = cups
        self._grippers = {
            n: g for n, g in built.scene.model.grippers.items() if isinstance(g, SuctionGripper)
        }
        self.law, self.fingers = np.zeros((len(cups), CUP_LAW)), fingers
        self.beads = np.full(mj.ngeom, -1)
        self.sealed = np.full(len(cups), -1)
        rows = list(built.grippers)
        self.holds = np.array([(rows.index(c.gripper), c.owner) for c in cups], np.int64).reshape(-1, 2)
        for k, cup in enumerate(cups):
            gripper = self._grippers[cup.gripper]
            self.law[k, RATE] = 1.0 - np.exp(-timestep / gripper.evacuation)
            self.law[k, CUP_CONTROL] = cup.ctrl
            start = int(mj.body_geomadr[cup.body])
            self.beads[start : start + RING] = RING * k + np.arange(RING)
        self.arrays = (self.law, self.beads, self.sealed, self.holds, self.fingers)

    def __bool__(self) -> bool:
        return bool(self._cups)

    def rows(self, gripper: str) -> list[int]:
        """Return the indices of a gripper's cups among all suction cups."""
        return [k for k, cup in enumerate(self._cups) if cup.gripper == gripper]

    def switch(self, gripper: str, on: bool, data: mujoco.MjData) -> None:
        """Switch a gripper's vacuum on or off. Switching it off brings the suction cups to ambient pressure
        immediately.
        """
        for k in self.rows(gripper):
            self.law[k, ON] = float(on)
            if not on:
                self.law[k, LEVEL] = data.ctrl[self._cups[k].ctrl] = 0.0

    def is_on(self, gripper: str) -> bool:
        return any(self.law[k, ON] > 0 for k in self.rows(gripper))

    def update(self, count: int, pairs: NDArray[np.int32], owner: Ints, ctrl: Array) -> None:
        """Set the vacuum forces for the next physics step from the contacts of the last one."""
        draw_vacuum(count, pairs, owner, ctrl, self.arrays)

    def pull(self, k: int) -> float:
        """Return the present vacuum force [N] of a suction cup."""
        cup = self._cups[k]
        seals = self.sealed[k] >= 0
        return float(self.law[k, LEVEL]) * self._grippers[cup.gripper].force(cup.cup) if seals else 0.0

    def add_pull(self, gripper: str, data: mujoco.MjData, origin: Array, total: Array) -> None:
        """Add the vacuum forces of a gripper's suction cups to the wrench `total` (6,) on the hand, about the
        point `origin` (3,).
        """
        for k in self.rows(gripper):
            body = self._cups[k].body
            force = self.pull(k) * data.xmat[body][2::3]
            total[:3] += force
            total[3:] += np.cross(data.xpos[body] - origin, force)

    def get_state(self) -> tuple[Array, Ints, Ints]:
        return self.law.copy(), self.sealed.copy(), self.fingers.copy()

    def set_state(self, state: tuple[Array, Ints, Ints]) -> None:
        self.law[:], self.sealed[:], self.fingers[:] = state


@njit(cache=True)
def draw_vacuum(count, pairs, owner, ctrl, arrays):
    """Find which suction cups seal, and set their vacuum forces for the next physics step.

    A leaking cup loses its vacuum at once. The links of sealed cups hold the object in the sense of
    `HeldObjectCorrection`; a gripper without a sealed cup holds nothing (-2).

    Args:
        count: number of contacts.
        pairs: (n, 2) geoms of each contact.
        owner: (geom,) owner of each geom, or -1.
        ctrl: MuJoCo's controls, changed in place.
        arrays: `Suction.arrays`; `law`, `sealed` and `fingers` are changed in place.
    """
    law, beads, sealed, holds, fingers = arrays
    if len(law) == 0:
        return
    touched = np.full(len(law) * RING, -1)
    for i in range(count):
        for side in range(2):
            bead = beads[pairs[i, side]]
            if bead >= 0:
                touched[bead] = owner[pairs[i, 1 - side]]
    for k in range(len(law)):
        body = touched[RING * k]
        for i in range(1, RING):
            if touched[RING * k + i] != body:
                body = -1
        sealed[k] = body
        if body < 0:
            law[k, LEVEL] = 0.0
        else:
            law[k, LEVEL] += law[k, RATE] * (law[k, ON] - law[k, LEVEL])
        ctrl[int(law[k, CUP_CONTROL])] = law[k, LEVEL]
    for k in range(len(law)):
        fingers[holds[k, 0], :] = -1
        fingers[holds[k, 0], 0] = -2
    for k in range(len(law)):
        if sealed[k] >= 0 and law[k, LEVEL] > 0.0:
            row = fingers[holds[k, 0]]
            f = 0
            while f < len(row) - 1 and row[f] >= 0 and row[f] != holds[k, 1]:
                f += 1
            row[f] = holds[k, 1]
