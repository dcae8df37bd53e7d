"""Friction of objects: static or dynamic by slip speed, and no creep or drift of held objects.

MuJoCo has one Coulomb coefficient per contact. A sticking contact needs the static coefficient and a sliding
contact the dynamic one, so an object's coefficient must change with its slip speed. All contacts of an object
share one coefficient: the object slides when every loaded contact slips, and uses its dynamic coefficient
until it rests again. A held object that is dragged over a table therefore keeps its static friction in the
hand.

Two properties of MuJoCo's friction displace an object that a hand holds firmly:

- Creep. A friction constraint is soft: a tangential force f makes the contact slide at a speed proportional
  to f / `impratio`. With `impratio` 10, a 2 kg cube creeps at 74 um/s in a Panda's hand. A larger value
  stops the creep, but while the forces change, a step takes five solver iterations instead of one. While all
  hands that hold an object are at rest, the forces are constant: there, `holding_impratio` costs nothing.
- Drift. For the relative velocity J v of a contact, the solver sets J a = -b J v. It leaves out dJ/dt v, the
  acceleration of the contact by the hand's motion along its curve. In the steady state the object therefore
  lags by the speed (dJ/dt v) (1/b + dt/2): the first summand balances the missing term, the second is the
  difference between the hand's arc and the tangent along which a free body moves in one step. In a
  `panda_pick`, the lag adds up to 1 to 2 mm. `carry` adds the same distance to the object's position at
  every step. Velocities and forces stay MuJoCo's, so an object slips where friction does not suffice.
"""

from __future__ import annotations

import ctypes
from functools import cache

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.sim.array_pointers import matrix, vector
from armcell.sim.mujoco_model import BuiltModel
from armcell.sim.settings import PhysicsSettings

F64 = NDArray[np.float64]

SLIDES = 0.02  # [m/s] an object starts to slide when all its contacts are faster than this
RESTS = 0.005  # [m/s] it rests when one contact is slower; a firm grasp creeps at micrometers per second
STILL = 1e-3  # [m/s] a hand is at rest when its tcp is slower, plus `STILL_ARM` times its angular velocity
STILL_ARM = 0.1  # [m]


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

    def _slips(self, data: mujoco.MjData) -> tuple[NDArray[np.int64], F64]:
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


_I8, _F8, _B = np.int64, np.float64, np.bool_
HOLDING = (_F8, _F8, _I8, _I8, _I8, _I8, _I8, _B, _F8, _I8, _F8, _F8, _F8, _F8)
"""Types of `HeldObjectCorrection.arrays`."""


class HeldObjectCorrection:
    """Correction of the creep and drift that MuJoCo's friction causes in held objects.

    Call `carry` after each step.

    Attributes:
        arrays: the arrays that `carry` reads and writes, of the types `HOLDING`: `impratio` in MuJoCo's
            options (1,); law (4,): its values in motion and at rest, the lag as a multiple of the distance
            between the hand's arc and its tangent, and the time step; hands (g, 2) tcp body and root body;
            fingers (g, f) owners, -1 for none; owner (geom,); free (owner, 2) of movable objects: start in
            qpos, -1 for a screwed-in object, and body, -1 for links and fixed objects; welds (g, owner)
            equality or -1; whether each equality is active; past (g, 13) whether the tcp pose of the last
            step is known, its position and its rotation matrix; held (g,) owner or -1; xpos, xmat, cvel and
            subtree_com.
    """

    def __init__(self, built: BuiltModel, settings: PhysicsSettings, data: mujoco.MjData):
        mj, grippers = built.mj, list(built.grippers.values())
        most = max((len(g.finger_owners) for g in grippers), default=0)
        fingers = np.full((len(grippers), most), -1)
        welds = np.full((len(grippers), len(built.owners)), -1)
        free = np.full((len(built.owners), 2), -1)
        for k, index in enumerate(grippers):
            fingers[k, : len(index.finger_owners)] = index.finger_owners
            for (item, gripper), equality in built.welds.items():
                if gripper == index.gripper.name:
                    welds[k, built.owner_index[item]] = equality
        for name, start in built.object_qpos.items():
            free[built.owner_index[name]] = start, built.body[name]
        for name in built.threaded:
            free[built.owner_index[name], 1] = built.body[name]
        tcps = np.array([g.tcp_body for g in grippers], np.int64)
        self._past = np.zeros((len(grippers), 13))
        self._held = np.full(len(grippers), -1)
        self.arrays = (
            _impratio(mj),
            np.array([settings.impratio, settings.holding_impratio, lag(settings), settings.timestep]),
            np.stack([tcps, mj.body_rootid[tcps].astype(np.int64)], 1),
            fingers, np.asarray(built.geom_owner, np.int64), free, welds, data.eq_active.view(np.bool_),
            self._past, self._held, data.xpos, data.xmat, data.cvel, data.subtree_com,
        )  # fmt: skip
        self._qpos = data.qpos

    def forget(self) -> None:
        """Discard the hand poses of the last physics step, from which the friction correction computes the
        drift of held objects. Call this after the state has changed without a physics step.
        """
        self._past[:, 0] = 0.0

    def update(self, count: int, pairs: NDArray[np.int32]) -> None:
        """Correct the creep and drift that MuJoCo's friction causes in held objects, after Python code has
        taken a physics step.

        Args:
            count: number of contacts.
            pairs: (n, 2) geoms of each contact.
        """
        carry(count, pairs, self._qpos, self.arrays)

    def get_state(self) -> F64:
        return self._past.copy()

    def set_state(self, state: F64) -> None:
        self._past[:] = state


def lag(settings: PhysicsSettings) -> float:
    """Return the dimensionless factor in the formula for the lag of a held object behind a hand that moves on
    an arc. MuJoCo's friction causes the lag.

    The lag per physics step dt is this factor times dt^2/2 dJ/dt v, the distance between the hand's arc and
    its tangent. J is the Jacobian of the contact, and v are the generalized velocities. The factor is 0 for
    the integrator RK4, for which the lag is not corrected.

    MuJoCo's damping of a contact is b = 2 / (dmax max(timeconst, 2 dt)) [1/s] (`solref`, `solimp`). The
    integrator "discrete" applies it to the velocity after the step, the others to that before the step.
    """
    if settings.integrator == "RK4":
        return 0.0
    dt = settings.timestep
    per_step = 2.0 / (max(settings.object_solref[0], 2.0 * dt) * max(settings.object_solimp[1], 1e-4)) * dt
    return 2.0 / per_step + (1.0 if settings.integrator == "discrete" else -1.0)


def _impratio(mj: mujoco.MjModel) -> F64:
    """Return a writable view (1,) of MuJoCo's friction option `impratio`, which determines how fast held
    objects creep.

    The result is a private array if the memory layout is unknown.
    """
    address = mj.opt.gravity.__array_interface__["data"][0] + 8 * _offset()
    return np.zeros(1) if _offset() == 0 else _view(address)


def _view(address: int) -> F64:
    return np.ctypeslib.as_array((ctypes.c_double * 1).from_address(address))


@cache
def _offset() -> int:
    """Return the distance in memory, in doubles, from MuJoCo's option `gravity` to its friction option
    `impratio`. The distance is needed to change `impratio`.

    The result is 0 if the memory layout is unknown.

    The search writes two values to a test model and looks for them among the numbers before `gravity`.
    """
    option = mujoco.MjModel.from_xml_string("<mujoco/>").opt
    base, found = option.gravity.__array_interface__["data"][0], set(range(-7, 0))
    for value in (17.25, 23.5):
        option.impratio = value
        found = {k for k in found if _view(base + 8 * k).item() == value}
    return found.pop() if len(found) == 1 else 0


@njit(cache=True)
def holding(fixed, k):
    """Return the arrays of the friction correction (`HeldObjectCorrection`) in the compiled physics step,
    reconstructed from their memory addresses in the table `fixed`.

    Row k of the table contains the address of the first array, and the next rows those of the others.
    """
    return (
        vector(fixed, k, _F8), vector(fixed, k + 1, _F8), matrix(fixed, k + 2, _I8),
        matrix(fixed, k + 3, _I8), vector(fixed, k + 4, _I8), matrix(fixed, k + 5, _I8),
        matrix(fixed, k + 6, _I8), vector(fixed, k + 7, _B), matrix(fixed, k + 8, _F8),
        vector(fixed, k + 9, _I8), matrix(fixed, k + 10, _F8), matrix(fixed, k + 11, _F8),
        matrix(fixed, k + 12, _F8), matrix(fixed, k + 13, _F8),
    )  # fmt: skip


@njit(cache=True)
def _partner(owner, pairs, i, finger):
    """Return the index of the link or object that touches a given finger in contact i, or -1. The friction
    correction uses this index to find held objects.
    """
    a, b = owner[pairs[i, 0]], owner[pairs[i, 1]]
    if a == finger:
        return b
    return a if b == finger else -1


@njit(cache=True)
def _touches(count, pairs, owner, finger, item):
    found = False
    for i in range(count):
        found = found or _partner(owner, pairs, i, finger) == item
    return found


@njit(cache=True)
def _in_hand(count, pairs, owner, free, fingers):
    """Return the index of the object in a hand whose friction must be corrected, or -1. All fingers (f,) of
    the hand touch this object.
    """
    for i in range(count):
        item = _partner(owner, pairs, i, fingers[0])
        if item < 0 or free[item, 1] < 0:
            continue
        by_all = True
        for finger in fingers[1:]:
            by_all = by_all and (finger < 0 or _touches(count, pairs, owner, finger, item))
        if by_all:
            return item
    return -1


@njit(cache=True)
def _move(qpos, start, R, shift, turn):
    """Correct the pose of a held object, which drifts because of MuJoCo's friction, by a shift [m] and a
    small rotation vector [rad], both along the world axes.

    Args:
        start: index of x, y, z, qw, qx, qy, qz in qpos.
        R: (9,) rotation of the body.
    """
    for r in range(3):
        qpos[start + r] += shift[r]
    x, y, z = (
        0.5 * (R[0] * turn[0] + R[3] * turn[1] + R[6] * turn[2]),
        0.5 * (R[1] * turn[0] + R[4] * turn[1] + R[7] * turn[2]),
        0.5 * (R[2] * turn[0] + R[5] * turn[1] + R[8] * turn[2]),
    )
    a, b, c, d = qpos[start + 3], qpos[start + 4], qpos[start + 5], qpos[start + 6]
    w = a - b * x - c * y - d * z
    i, j, k = b + a * x + c * z - d * y, c + a * y + d * x - b * z, d + a * z + b * y - c * x
    length = np.sqrt(w * w + i * i + j * j + k * k)
    qpos[start + 3], qpos[start + 4] = w / length, i / length
    qpos[start + 5], qpos[start + 6] = j / length, k / length


@njit(cache=True)
def _lags(x, R, v, w, point, past, dt, scale):
    """Compute how far a held object slid behind the hand in the last physics step because of MuJoCo's
    friction: shift [m] and rotation [rad].

    The shift (3,) is that of a point of the body; the rotation is a rotation vector (3,).

    With the same joint velocities before and after the step, dt v - (distance moved) is dt^2/2 dJ/dt v.

    Args:
        x, R, v, w: pose and velocities of the hand.
        point: (3,) point of the body.
        past: (13,) pose of the hand before the step.
        dt: time step [s].
        scale: result of `lag`.
    """
    shift, turn, turned = np.empty(3), np.empty(3), np.empty((3, 3))
    for r in range(3):
        for c in range(3):
            turned[r, c] = 0.0
            for k in range(3):
                turned[r, c] += R[3 * r + k] * past[4 + 3 * c + k]
    for r in range(3):
        a, b = (r + 1) % 3, (r + 2) % 3
        before = past[1 + r]
        for k in range(3):
            before += turned[k, r] * (point[k] - x[k])
        speed = v[r] + w[a] * (point[b] - x[b]) - w[b] * (point[a] - x[a])
        shift[r] = scale * (dt * speed - (point[r] - before))
        turn[r] = scale * (dt * w[r] - 0.5 * (turned[b, a] - turned[a, b]))
    return shift, turn


@njit(cache=True)
def carry(count, pairs, qpos, arrays):
    """Correct the errors of MuJoCo's friction after a physics step: choose `impratio` so that held objects do
    not creep, and shift each object by its lag behind the hand.

    Args:
        count: number of contacts.
        pairs: (n, 2) geoms of each contact.
        qpos: MuJoCo's positions after the step; the poses in `arrays` are those before the step.
        arrays: `HeldObjectCorrection.arrays`; `impratio`, `past` and `held` are changed in place.
    """
    impratio, law, hands, fingers, owner, free, welds, welded, past, held, xpos, xmat, cvel, com = arrays
    still, moving = False, False
    for g in range(len(hands)):
        held[g] = _in_hand(count, pairs, owner, free, fingers[g])
    for g in range(len(hands)):
        item = held[g]
        if item < 0:
            past[g, 0] = 0.0
            continue
        tcp, root = hands[g, 0], hands[g, 1]
        x, R, w, v = xpos[tcp], xmat[tcp], cvel[tcp, :3], np.empty(3)
        for r in range(3):
            a, b = (r + 1) % 3, (r + 2) % 3
            v[r] = cvel[tcp, 3 + r] + w[a] * (x[b] - com[root, b]) - w[b] * (x[a] - com[root, a])
        speed = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        if speed + STILL_ARM * np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2) < STILL:
            still = True
            past[g, 0] = 0.0
        else:
            moving = True
        start, body, weld = free[item, 0], free[item, 1], welds[g, item]
        if past[g, 0] > 0.0 and start >= 0 and law[2] > 0.0 and not (weld >= 0 and welded[weld]):
            hands_on = 0
            for other in held:
                hands_on += other == item
            shift, turn = _lags(x, R, v, w, xpos[body], past[g], law[3], law[2] / hands_on)
            _move(qpos, start, xmat[body], shift, turn)
        past[g, 0] = 1.0
        past[g, 1:4], past[g, 4:] = x, R
    impratio[0] = law[1] if still and not moving else law[0]
