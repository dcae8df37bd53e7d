"""Compiled physics steps: gripper control, MuJoCo's step and contact checks without Python.

A step of a small cell takes 20 us, and the same work in Python takes nearly half as much in addition. The
compiled code computes in the same order, so its results have the same bits.
"""

from __future__ import annotations

from pathlib import Path

import llvmlite.binding
import mujoco
import numpy as np
from numba import njit, types

from armcell.sim.array_pointers import matrix, vector
from armcell.sim.friction import HOLDING, carry, holding
from armcell.sim.servo import drive_joints
from armcell.sim.suction import draw_vacuum

SET_POINT, TARGET, LEAD, STEP, PUSH_STEP, BLOCKED_LEAD, CONTROL = range(7)
LAW_SIZE = 7
"""Number of columns of a gripper's row in `law`; see `grip.GripperDrive`."""

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
    *HOLDING, _F8, _I8, _I8, _I8, _I8, _F8, _F8, _I8,
)  # fmt: skip
"""Types of the arrays that `take_steps` takes by address."""

FAR = 0.5  # [m] largest distance that is measured
WORTH = 0.005  # [m] MuJoCo tests pairs of bodies nearer than this
AGAIN = 0.05  # [m] motion after which the distance of such a pair is measured again
ERROR = 0.001  # [m] largest error of a measured distance
ALL = 0x7FFFFFFF  # all bits of MuJoCo's contact masks


@njit(cache=True)
def drive_fingers(law, joints, weights, qpos, ctrl):
    """Compute the setpoints of all gripper servos for the next physics step in the compiled step kernel.

    Args:
        law: (g, 7) one row per gripper, changed in place.
        joints: (g, k) indices of the finger joints in qpos.
        weights: (g, k) weights of the finger joints; a servo's length is their weighted sum.
        qpos: MuJoCo's positions.
        ctrl: MuJoCo's controls, changed in place.
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
    """Mark, before a physics step, the body pairs whose distances must be measured again after the step. This
    function is part of the compiled step kernel.

    The bodies of such a pair may have moved by the pair's limit since the last measurement. MuJoCo tests the
    pair for contact in this step. Return whether there are such pairs.
    """
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
    """Measure, after a physics step, the distances of the body pairs that `_before` has marked before the
    step. This function is part of the compiled step kernel.

    If the bodies of a pair are far enough apart, MuJoCo skips the pair again in the next steps. If not, it
    continues to test the pair.
    """
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
    """Return the arrays of the body pairs that are far apart (`PairCulling.arrays`), for use in the compiled
    step kernel.

    Row k of the address table `fixed` describes the first of these arrays.
    """
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
    """Run physics steps in the compiled step kernel. Stop after the last step, at an unwanted contact, or
    when a joint deviates too far from its target.

    Args:
        model, data: addresses of MuJoCo's mjModel and mjData.
        begin, end: number of the first step, and number after the last step.
        fixed: `addresses_of` the number of contacts (1,), a live view; MuJoCo's qpos and ctrl; the geoms'
            centers (geom, 3); law, joints and weights of `drive_fingers`; `PairCulling.arrays`;
            `HeldObjectCorrection.arrays`; `Suction.arrays`; MuJoCo's qvel; `law` and `at` of `ArmServo`.
        pairs: (c, 2) geoms of each contact, a live view; only the first `readable` rows may be read.
        readable: number of readable rows of `pairs`.
        unwanted: (geom, geom) True where two geoms must not touch.
        period: steps between new targets, which apply from steps 0, period, 2 period and so on.
        targets: (n / period, m) targets; the first k columns are written to the controls.
        controls: (k,) control indices.
        columns: (j,) indices in qpos of the joints that must follow the first j columns of `targets`.
        limit: largest deviation [rad or m] of a joint from its target after `period` steps.
        worst: (j,) largest deviation of each joint, changed in place.
    Returns:
        The number of the next step; whether a contact must be checked; whether a joint is off its target.
    """
    count, qpos, ctrl = vector(fixed, 0, _I4), vector(fixed, 1, _F8), vector(fixed, 2, _F8)
    places, law = matrix(fixed, 3, _F8), matrix(fixed, 4, _F8)
    joints, weights = matrix(fixed, 5, _I8), matrix(fixed, 6, _F8)
    apart, hold = _apart(fixed, 7), holding(fixed, 26)
    cups = (
        matrix(fixed, 40, _F8), vector(fixed, 41, _I8), vector(fixed, 42, _I8), matrix(fixed, 43, _I8),
        matrix(fixed, 44, _I8),
    )  # fmt: skip
    qvel, servo, at = vector(fixed, 45, _F8), matrix(fixed, 46, _F8), matrix(fixed, 47, _I8)
    for step in range(begin, end):
        row = step // period
        if step % period == 0:
            for i in range(len(controls)):
                ctrl[controls[i]] = targets[row, i]
        drive_fingers(law, joints, weights, qpos, ctrl)
        draw_vacuum(min(count[0], readable), pairs, hold[4], ctrl, cups)
        drive_joints(servo, at, qpos, qvel, ctrl)
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
    """Add up the contact forces on each finger along an axis, in the compiled step kernel. The sums are
    separate for each link or object that touches the finger.

    Contacts between two fingers do not count.

    Args:
        model, data: addresses of MuJoCo's mjModel and mjData.
        geoms, frames: (c, 2) geoms and (c, 9) frame of each contact.
        owner: (geom,) index of the geom's link or object.
        fingers: (f,) index of each finger in the same numbering.
        axis: (3,) direction in the world frame.
        forces: (owner, f) [N], changed in place.
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
    """Return two results in the compiled step kernel: the total finger force [N] along an axis, and the index
    of the object between the fingers.

    The object is the one that all fingers press, or -1.

    Args:
        model, data, geoms, frames, owner, fingers, axis: see `add_finger_forces`.
        owners: number of links and objects.
        first_object: index of the first object; the objects come after the links.
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
    """Collect the contacts between a hand and other bodies, with their wrenches, in the compiled step kernel.

    Args:
        model, data: addresses of MuJoCo's mjModel and mjData.
        geoms: (c, 2) geoms of each contact.
        owner: (geom,) index of the geom's link or object, or -1.
        hand: (owner,) True for the links of the hand.
        which: (c,) number of each collected contact, changed in place.
        signs: (c,) 1 if the contact's second geom is the hand's, else -1, changed in place.
        wrenches: (c, 6) force and torque in the frame of each collected contact, changed in place.
    Returns:
        The number of collected contacts.
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
    """Add up the wrenches of a hand's contacts about one point, in the compiled step kernel.

    Args:
        which: (k,) numbers of the contacts.
        places: (c, 3) positions of all contacts.
        origin: (3,) the point.
        wrenches: (k, 2, 3) force and torque of each contact about its position.
        total: (6,) force, then torque, changed in place.
    """
    for i in range(len(which)):
        force, torque = wrenches[i, 0], wrenches[i, 1]
        for r in range(3):
            b, c = (r + 1) % 3, (r + 2) % 3
            at_b, at_c = places[which[i], b] - origin[b], places[which[i], c] - origin[c]
            total[r] += force[r]
            total[3 + r] += torque[r] + (at_b * force[c] - at_c * force[b])
