"""Couplings of MJCF joints as mimic rules, from equalities, tendons and closed linkages.

A planner needs each passive joint as a function of a driven joint. Physics keeps the model's own equalities
and tendons.
"""

from __future__ import annotations

import copy
import logging
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

logger = logging.getLogger(__name__)

Array = NDArray[np.float64]
# MuJoCo's enumeration values do not equal numpy's integers when they are looked up in a tuple.
ON_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)
ON_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
LOOPS = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)
SAMPLES = 9  # positions of a driver at which a linkage is solved
SPRING_WEIGHT = 1e-3  # [m/rad] weight of a sprung joint's rest position against the linkage's residual
REST_WEIGHT = 1e-6  # [m/rad] the same for joints without a spring; makes the solution unique
CLOSED = 1e-3  # [m] largest residual of a linkage that counts as closed
MOVES = 1e-3  # [rad or m] smallest motion of a passive joint that counts as driven
LINEAR = 0.05  # largest deviation from a line that is not reported, as a fraction of the joint's motion


@dataclass
class Couplings:
    """Linear couplings between MJCF joints: q[joint] = multiplier * q[driver] + offset.
    They are stored by joint id.

    Attributes:
        actuated: joints that an actuator drives, directly or by a tendon.
        rules: (driver, multiplier, offset) of each coupled joint; a driver is not coupled itself.
    """

    actuated: set[int] = field(default_factory=set)
    rules: dict[int, tuple[int, float, float]] = field(default_factory=dict)

    def add(self, joint: int, other: int, multiplier: float, offset: float) -> None:
        """Record that two MJCF joints are coupled by q[joint] = multiplier * q[other] + offset.

        The coupling connects the drivers of both joints. Of the two drivers, the one with its own actuator
        stays the driver. If both have one, the driver of `other` does; if neither has one, the first in the
        tree does. A coupling that forms a loop, or whose multiplier is 0, is ignored.
        """
        a, (ka, ca) = self._root(joint)
        b, (kb, cb) = self._root(other)
        # q[joint] = ka q[a] + ca, q[other] = kb q[b] + cb
        if a == b or ka == 0 or multiplier * kb == 0:
            return
        k, c = multiplier * kb / ka, (multiplier * cb + offset - ca) / ka  # q[a] = k q[b] + c
        driven = a in self.actuated, b in self.actuated
        if driven == (True, False) or (driven == (False, False) and a < b):
            a, b, k, c = b, a, 1 / k, -c / k
        for coupled, (driver, km, cm) in list(self.rules.items()):
            if driver == a:
                self.rules[coupled] = (b, km * k, km * c + cm)
        self.rules[a] = (b, k, c)

    def _root(self, joint: int) -> tuple[int, tuple[float, float]]:
        driver, multiplier, offset = self.rules.get(joint, (joint, 1.0, 0.0))
        return driver, (multiplier, offset)


def couplings(model: Any, name: str) -> Couplings:
    """Return the linear couplings between the joints of a compiled MuJoCo model.

    Args:
        name: the robot's name, for messages.
    """
    found = Couplings()
    tendons = []
    for i in range(len(model.actuator_trntype)):  # not nu: an actuator may have two inputs
        kind, target = int(model.actuator_trntype[i]), int(model.actuator_trnid[i, 0])
        if kind in ON_JOINT:
            found.actuated.add(target)
        elif kind == ON_TENDON:
            tendons.append(target)
    driven_by_tendon = {j for t in tendons for j, _ in tendon_joints(model, t)}
    equalities = [i for i in range(model.neq) if model.eq_active0[i]]
    for i in equalities:
        _joint_equality(model, i, found)
    for i in equalities:
        _tendon_equality(model, i, found)
    for tendon in tendons:
        _driven_tendon(model, tendon, found)
    found.actuated |= driven_by_tendon - set(found.rules)
    if any(int(model.eq_type[i]) in LOOPS for i in equalities):
        _close_linkages(model, found, name)
    return found


def tendon_joints(model: Any, tendon: int) -> list[tuple[int, float]]:
    """Return the joints that a fixed MJCF tendon couples, each with its coefficient. The list is empty for
    other tendons.
    """
    first = int(model.tendon_adr[tendon])
    parts = range(first, first + int(model.tendon_num[tendon]))
    return [
        (int(model.wrap_objid[i]), float(model.wrap_prm[i]))
        for i in parts
        if model.wrap_type[i] == mujoco.mjtWrap.mjWRAP_JOINT
    ]


def _joint_equality(model: Any, i: int, found: Couplings) -> None:
    if model.eq_type[i] != mujoco.mjtEq.mjEQ_JOINT or model.eq_obj2id[i] < 0:
        return
    joint, other = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
    constant, slope, *_ = model.eq_data[i, :5]
    start = [float(model.qpos0[model.jnt_qposadr[j]]) for j in (joint, other)]
    found.add(joint, other, float(slope), start[0] + float(constant) - float(slope) * start[1])


def _tendon_equality(model: Any, i: int, found: Couplings) -> None:
    """Couple two joints as mimic joints if a fixed tendon connects them and an equality constraint keeps the
    tendon's length constant.

    MJCF models couple opposed fingers like this. Tendons with more or fewer than two joints are ignored.
    """
    if model.eq_type[i] != mujoco.mjtEq.mjEQ_TENDON or model.eq_obj2id[i] >= 0:
        return
    tendon = int(model.eq_obj1id[i])
    parts = tendon_joints(model, tendon)
    if len(parts) != 2:
        return
    (a, ka), (b, kb) = parts
    length = float(model.tendon_length0[tendon] + model.eq_data[i, 0])
    found.add(b, a, -ka / kb, length / kb)


def _driven_tendon(model: Any, tendon: int, found: Couplings) -> None:
    """Couple the joints that one actuator drives through a fixed tendon, as mimic joints.

    All joints move through their ranges together.
    """
    parts = tendon_joints(model, tendon)
    for joint, coefficient in parts[1:]:
        first, other = parts[0]
        same = 1.0 if coefficient * other > 0 else -1.0
        low, high = _range(model, joint)
        start, end = _range(model, first)
        if not np.isfinite([low, high, start, end]).all() or end == start:
            found.add(joint, first, same, 0.0)
            continue
        slope = same * (high - low) / (end - start)
        found.add(joint, first, slope, (low if same > 0 else high) - slope * start)


def _range(model: Any, joint: int) -> tuple[float, float]:
    if not model.jnt_limited[joint]:
        return -np.inf, np.inf
    low, high = model.jnt_range[joint]
    return float(low), float(high)


def _close_linkages(model: Any, found: Couplings, name: str) -> None:
    """Couple each passive joint of a closed linkage to a driving joint as a mimic joint,
    with a fitted linear rule.
    """
    from scipy.optimize import least_squares  # imported late: few models have linkages

    model = copy.copy(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    passive = [j for j in range(model.njnt) if j not in found.actuated and j not in found.rules]
    if not passive:
        return
    at = model.jnt_qposadr
    rest, weight = _rest(model, passive)
    bounds = np.array([_range(model, j) for j in passive]).T
    rows_of = _equality_rows(model, data)
    drivers = sorted(found.actuated - set(found.rules))
    start = {d: _middle(model, d) for d in drivers}

    def residual(x: Array, values: dict[int, float]) -> Array:
        data.qpos[:] = model.qpos0
        for driver, value in values.items():
            data.qpos[at[driver]] = value
        data.qpos[at[passive]] = x
        for joint, (driver, multiplier, offset) in found.rules.items():
            data.qpos[at[joint]] = multiplier * data.qpos[at[driver]] + offset
        return np.concatenate((rows_of(), weight * (x - rest)))

    count = len(rows_of())
    for driver in drivers:
        low, high = _range(model, driver)
        if not np.isfinite([low, high]).all():
            continue
        values, solutions, x = np.linspace(low, high, SAMPLES), [], np.clip(model.qpos0[at[passive]], *bounds)
        first = residual(x, {**start, driver: low})
        if np.allclose(first, residual(x, {**start, driver: high}), atol=1e-9):
            continue  # this driver moves no linkage
        for value in values:
            values_of = {**start, driver: float(value)}
            x = least_squares(residual, x, bounds=bounds, args=(values_of,), xtol=1e-12).x
            solutions.append(x)
        worst = np.abs(residual(x, {**start, driver: float(values[-1])})[:count]).max()
        if worst > CLOSED:
            logger.warning(
                "%s: the linkage of joint %r stays open by %.1f mm at the end of its range",
                name, model.joint(driver).name, 1000 * worst,
          )  # fmt: skip
        _fit(model, driver, passive, values, np.array(solutions), found, name)


def _rest(model: Any, joints: list[int]) -> tuple[Array, Array]:
    """Return the spring rest positions (n,) and weights (n,) of MJCF joints. The fit of couplings pulls the
    joints toward these positions.
    """
    stiffness = np.array([float(np.ravel(model.jnt_stiffness[j])[0]) for j in joints])
    strongest = max(float(stiffness.max()), 1e-12)
    weight = REST_WEIGHT + SPRING_WEIGHT * np.sqrt(stiffness / strongest)
    return np.array(model.qpos_spring[model.jnt_qposadr[joints]]), weight


def _fit(
    model: Any, driver: int, passive: list[int], values: Array, solutions: Array, found: Couplings, name: str
) -> None:
    for joint, positions in zip(passive, solutions.T, strict=True):
        motion = float(np.ptp(positions))
        if motion < MOVES or joint in found.rules:
            continue
        multiplier, offset = np.polyfit(values, positions, 1)
        off = float(np.abs(np.polyval((multiplier, offset), values) - positions).max())
        if off > LINEAR * motion:
            logger.info(
                "%s: joint %r follows %r along a curve; the planner's line is off by at most %.3g",
                name, model.joint(joint).name, model.joint(driver).name, off,
          )  # fmt: skip
        found.rules[joint] = (driver, float(multiplier), float(offset))


def _middle(model: Any, joint: int) -> float:
    low, high = _range(model, joint)
    start = float(model.qpos0[model.jnt_qposadr[joint]])
    return float(np.clip(start, low, high)) if low < high else start


def _equality_rows(model: Any, data: Any) -> Any:
    """Return a function that computes the residuals [m] of a model's
    connect and weld constraints, to find coupled joints.
    """

    def rows() -> Array:
        mujoco.mj_fwdPosition(model, data)
        kind = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        ids = data.efc_id
        loops = np.isin(model.eq_type, LOOPS)
        keep = [i for i in np.flatnonzero(kind) if loops[ids[i]]]
        return np.array(data.efc_pos[keep])

    return rows
