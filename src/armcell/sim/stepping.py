"""Physics steps in compiled code: fingers, step and contacts without Python in between.

A step of a small cell takes 20 us, and what Python did around it nearly half as much again. Here the same is
done in the same order, so the bits are the same.
"""

from __future__ import annotations

from pathlib import Path

import llvmlite.binding
import mujoco
import numpy as np
from numba import njit, types

from armcell.sim.by_address import matrix, vector
from armcell.sim.holding import HOLDING, carry, holding

SET_POINT, TARGET, LEAD, STEP, PUSH_STEP, BLOCKED_LEAD, CONTROL = range(7)
LAW_SIZE = 7
"""Columns of the fingers' law, of which there is one row per gripper; see `grip.GripperDrive`."""

LIBRARY = next(Path(mujoco.__file__).parent.glob("*mujoco*.[sd]*"))  # .so.4.0.0, .4.0.0.dylib, .dll
llvmlite.binding.load_library_permanently(str(LIBRARY))
_mj_step = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))
_geom_distance = types.ExternalFunction(
    "mj_geomDistance",
    types.float64(types.intp, types.intp, types.int32, types.int32, types.float64, types.intp),
)
_contact_force = types.ExternalFunction(
    "mj_contactForce", types.void(types.intp, types.intp, types.int32, types.intp)
)

_I4, _I8, _F8, _B = np.int32, np.int64, np.float64, np.bool_
FIXED = (
    _I4, _F8, _F8, _F8, _F8, _I8, _F8,
    _I8, _F8, _F8, _I8, _F8, _F8, _B, _B, _F8, _F8, _I8, _I8, _I8, _I4, _I4, _I8, _I4, _I4, _F8,
    *HOLDING,
)  # fmt: skip
"""Types of the arrays that `take_steps` takes by address."""

FAR = 0.5  # [m] how far distances are looked for
WORTH = 0.005  # [m] bodies nearer than this are left to the engine
AGAIN = 0.05  # [m] and looked at again when they moved so far
ERROR = 0.001  # [m] of a distance, at most
ALL = 0x7FFFFFFF  # of the engine's masks


@njit(cache=True)
def drive_fingers(law, joints, weights, qpos, ctrl):
    """Set the grippers' servos for the next step.

    Args:
        law: (g, 7), changed in place.
        joints: (g, k) index in qpos; weights (g, k): a servo's length is their weighted sum.
        qpos, ctrl: MuJoCo's; ctrl is written.
    """
    for g in range(len(law)):
        length, before = 0.0, law[g, SET_POINT]
        for k in range(joints.shape[1]):
            length += weights[g, k] * qpos[joints[g, k]]
        set_point, gap, lead = before, law[g, TARGET] - before, law[g, LEAD]
        if gap != 0.0:
            step = law[g, PUSH_STEP] if abs(set_point - length) > law[g, BLOCKED_LEAD] else law[g, STEP]
            set_point += max(-step, min(step, gap))
        if set_point > length + lead:
            set_point = length + lead
        elif set_point < length - lead:
            set_point = length - lead
        if set_point != before:
            law[g, SET_POINT] = set_point
            ctrl[int(law[g, CONTROL])] = set_point


@njit(cache=True)
def _before(qpos, apart):
    """Let the engine look at pairs of bodies no longer known to be apart; returns whether there are such."""
    columns, reach, reference, begins, limit, left, shut, old, most, last = apart[:10]
    bodies, geoms, first, bit, affinity, looked_at, body_type, body_affinity, _ = apart[10:]
    step = 0.0
    for j in range(len(most)):
        step += most[j] * abs(qpos[j] - last[j])
        last[j] = qpos[j]
    found = False
    for p in range(len(left)):
        left[p] -= step
        old[p] = False
        if left[p] > 0.0:
            continue
        moved = 0.0
        for c in range(begins[p], begins[p + 1]):
            moved += reach[c] * abs(qpos[columns[c]] - reference[c])
        left[p] = limit[p] - moved
        if left[p] > 0.0:
            continue
        found = old[p] = True
        for c in range(begins[p], begins[p + 1]):
            reference[c] = qpos[columns[c]]
        if shut[p]:
            shut[p] = False
            for k in range(first[p], first[p + 1]):
                a, b = geoms[k, 0], geoms[k, 1]
                affinity[a] |= bit[b]
                affinity[b] |= bit[a]
            for i in range(2):
                body = bodies[p, i]
                looked_at[body] += 1
                body_type[body] = body_affinity[body] = ALL
    return found


@njit(cache=True)
def _after(model, data, places, apart):
    """Of those pairs: how far the joints may move until they might touch."""
    _, _, _, _, limit, left, shut, old, _, _ = apart[:10]
    bodies, geoms, first, bit, affinity, looked_at, body_type, body_affinity, radius = apart[10:]
    for p in range(len(left)):
        if not old[p]:
            continue
        distance = FAR
        for k in range(first[p], first[p + 1]):
            if not distance > WORTH + ERROR:
                break
            a, b = geoms[k, 0], geoms[k, 1]
            between = 0.0
            for i in range(3):
                between += (places[a, i] - places[b, i]) ** 2
            if np.sqrt(between) - radius[a] - radius[b] < distance:
                distance = min(distance, _geom_distance(model, data, a, b, distance, 0))
        limit[p] = left[p] = AGAIN
        if not distance > WORTH + ERROR:
            continue
        limit[p] = left[p] = distance - ERROR
        shut[p] = True
        for k in range(first[p], first[p + 1]):
            a, b = geoms[k, 0], geoms[k, 1]
            affinity[a] &= ~bit[b]
            affinity[b] &= ~bit[a]
        for i in range(2):
            body = bodies[p, i]
            looked_at[body] -= 1
            if looked_at[body] == 0:
                body_type[body] = body_affinity[body] = 0


@njit(cache=True)
def _apart(fixed, k):
    """`Apart.arrays` from row k of a table of addresses on."""
    return (
        vector(fixed, k, _I8), vector(fixed, k + 1, _F8), vector(fixed, k + 2, _F8),
        vector(fixed, k + 3, _I8),
        vector(fixed, k + 4, _F8), vector(fixed, k + 5, _F8), vector(fixed, k + 6, _B),
        vector(fixed, k + 7, _B), vector(fixed, k + 8, _F8), vector(fixed, k + 9, _F8),
        matrix(fixed, k + 10, _I8), matrix(fixed, k + 11, _I8), vector(fixed, k + 12, _I8),
        vector(fixed, k + 13, _I4), vector(fixed, k + 14, _I4), vector(fixed, k + 15, _I8),
        vector(fixed, k + 16, _I4), vector(fixed, k + 17, _I4), vector(fixed, k + 18, _F8),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def take_steps(
    model, data, begin, end, fixed, pairs, readable, unwanted, period, targets, controls, columns, limit,
    worst,
):  # fmt: skip
    """Steps number begin to end - 1, until after one with an unwanted contact or with a joint off its target.

    Args:
        model, data: addresses of MuJoCo's mjModel and mjData.
        fixed: `addresses_of` the number of contacts (1,), read in place; MuJoCo's qpos and ctrl; the geoms'
            middles (geom, 3); law, joints and weights of `drive_fingers`; `Apart.arrays`; `Holding.arrays`.
        pairs: (c, 2) geoms of each contact, read in place, of which the first `readable` can be.
        unwanted: (geom, geom) whether they are not to touch.
        period: steps between new targets, which come before steps 0, period, 2 period and so on.
        targets: (n / period, m) of which the first k columns are for the controls (k,).
        columns: (j,) of qpos, where the first j columns of `targets` shall be after `period` steps.
        limit: [rad or m] how far off they may be.
        worst: (j,) how far they were at most, written.
    Returns:
        The number of the next step; whether there is a contact to be looked at; whether a joint is off.
    """
    count, qpos, ctrl = vector(fixed, 0, _I4), vector(fixed, 1, _F8), vector(fixed, 2, _F8)
    places, law = matrix(fixed, 3, _F8), matrix(fixed, 4, _F8)
    joints, weights = matrix(fixed, 5, _I8), matrix(fixed, 6, _F8)
    apart, hold = _apart(fixed, 7), holding(fixed, 26)
    for step in range(begin, end):
        row = step // period
        if step % period == 0:
            for i in range(len(controls)):
                ctrl[controls[i]] = targets[row, i]
        drive_fingers(law, joints, weights, qpos, ctrl)
        unknown = _before(qpos, apart)
        _mj_step(model, data)
        if unknown:
            _after(model, data, places, apart)
        carry(min(count[0], readable), pairs, qpos, hold)
        touches, off = False, False
        for i in range(count[0]):
            if i >= readable or unwanted[pairs[i, 0], pairs[i, 1]]:
                touches = True
                break
        if step % period == period - 1:
            for i in range(len(columns)):
                error = abs(qpos[columns[i]] - targets[row, i])
                worst[i] = max(worst[i], error)
                off = off or error > limit
        if touches or off:
            return step + 1, touches, off
    return end, False, False


@njit(
    types.void(
        types.intp, types.intp, types.int32[:, :], types.float64[:, :], types.int64[:], types.int64[:],
        types.float64[:], types.float64[:, :],
    ),
    cache=True,
)  # fmt: skip
def add_finger_forces(model, data, geoms, frames, owner, fingers, axis, forces):
    """Add up the forces along an axis that others than fingers have on fingers.

    Args:
        geoms, frames: (c, 2) and (c, 9) of each contact.
        owner: (geom,) index of its link or object; fingers (f,) those of the fingers.
        axis: (3,) in the world.
        forces: (owner, f) [N], added to.
    """
    wrench = np.empty(6)
    for i in range(len(geoms)):
        a, b = owner[geoms[i, 0]], owner[geoms[i, 1]]
        finger, other, sign = -1, -1, 0.0
        for f in range(len(fingers)):
            if fingers[f] == a:
                finger, other, sign = f, b, sign - 1.0
            if fingers[f] == b:
                finger, other, sign = f, a, sign + 1.0
        if other < 0 or sign == 0.0:
            continue
        _contact_force(model, data, i, wrench.ctypes.data)
        for r in range(3):  # a contact frame's rows are its axes in the world, the first from a to b
            along = 0.0
            for c in range(3):
                along += frames[i, 3 * r + c] * axis[c]
            forces[other, finger] += sign * wrench[r] * along


@njit(
    types.Tuple((types.float64, types.int64))(
        types.intp, types.intp, types.int32[:, :], types.float64[:, :], types.int64[:], types.int64[:],
        types.float64[:], types.int64, types.int64,
    ),
    cache=True,
)  # fmt: skip
def grip_between(model, data, geoms, frames, owner, fingers, axis, owners, first_object):
    """Sum of the forces [N] along an axis on all fingers, and the object that all of them press, or -1.

    Args:
        geoms, frames, owner, fingers, axis: see `add_finger_forces`.
        owners: how many links and objects there are; the objects come last, from `first_object` on.
    """
    forces = np.zeros((owners, len(fingers)))
    add_finger_forces(model, data, geoms, frames, owner, fingers, axis, forces)
    total, held, most = 0.0, -1, 0.0
    for other in range(owners):
        both, least = 0.0, np.inf
        for f in range(len(fingers)):
            both += abs(forces[other, f])
            least = min(least, abs(forces[other, f]))
        total += both
        if other >= first_object and least > 0.0 and least >= most:
            held, most = other, least
    return total, held


@njit(
    types.int64(
        types.intp, types.intp, types.int32[:, :], types.int64[:], types.boolean[:], types.int64[:],
        types.float64[:], types.float64[:, :],
    ),
    cache=True,
)  # fmt: skip
def hand_contacts(model, data, geoms, owner, hand, which, signs, wrenches):
    """Contacts between a hand and something else.

    Args:
        geoms: (c, 2) of each contact.
        owner: (geom,) index of its link or object, -1 for none; hand (owner,) which of them are the hand's.
        which: (c,) and signs (c,), written: number of each found; 1 where the hand is second, else -1.
        wrenches: (c, 6) of each found, written: force over torque in the contact's frame.
    Returns:
        How many there are.
    """
    found = 0
    for i in range(len(geoms)):
        a, b = owner[geoms[i, 0]], owner[geoms[i, 1]]
        first, second = a >= 0 and hand[a], b >= 0 and hand[b]
        if first != second:
            which[found], signs[found] = i, 1.0 if second else -1.0
            _contact_force(model, data, i, wrenches.ctypes.data + found * 48)
            found += 1
    return found


@njit(
    types.void(
        types.int64[:], types.float64[:, :], types.float64[:], types.float64[:, :, :], types.float64[:]
    ),
    cache=True,
)
def add_about(which, places, origin, wrenches, total):
    """Add up wrenches about a point.

    Args:
        which: (k,) numbers of contacts; places (c, 3) of all of them; origin (3,) the point.
        wrenches: (k, 2, 3) force and torque of each, about its place.
        total: (6,) force over torque, added to.
    """
    for i in range(len(which)):
        force, torque = wrenches[i, 0], wrenches[i, 1]
        for r in range(3):
            b, c = (r + 1) % 3, (r + 2) % 3
            at_b, at_c = places[which[i], b] - origin[b], places[which[i], c] - origin[c]
            total[r] += force[r]
            total[3 + r] += torque[r] + (at_b * force[c] - at_c * force[b])
