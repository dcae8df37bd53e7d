"""Learns the thresholds of a cell's simulated twin: how far the real arms normally deviate from it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from armcell.cell.cell import Cell
from armcell.cell.live import LiveCell
from armcell.cell.twin import twin_identity
from armcell.core import InputError, JointGoal, JointState, PlanRequest
from armcell.execution import execute
from armcell.planning import plan
from armcell.twin import ResidualThresholds, fit_thresholds

HOME_SPEED = 0.1  # of the limits, for the first loop
SPEEDS = (0.2, 0.4, 0.6)  # of the limits, in turn
REACH = 0.7  # [rad] largest offset of a goal from the home position, per joint
TRIES = 30  # random goals tried per motion


def learn_thresholds(
    cell: Cell, motions: int = 12, seed: int = 0, tell: Callable[[str], None] = lambda text: None
) -> ResidualThresholds:
    """Learn the twin thresholds of a cell: move every real arm, and measure how far it normally deviates from
    its simulated twin.

    Each arm first moves in a slow loop, then to random goals near home. All motions are planned in the cell's
    scene and dry-run in simulation first; nothing is gripped.

    Args:
        motions: number of motions per arm after the slow loop.
        tell: receives one line per motion.
    Raises:
        InputError: the arms have no twin, a motion failed, or no reachable goal was found.
    """
    rng = np.random.default_rng(seed)
    with cell.connect("real", seed, watch=False) as live:
        driver = live.driver
        calibrations, guard = driver.calibrations(), driver.guard
        if guard is None:
            raise InputError("the cell's real arms have no twin", file=cell.file, hint="real: {twin: true}")
        for name in calibrations:
            home = _home(cell, name)
            _go(live, name, home, HOME_SPEED, tell)
            for step in (0.1, -0.1):
                _go(live, name, home + step, HOME_SPEED, tell)
            for k in range(motions):
                _wander(live, name, home, SPEEDS[k % len(SPEEDS)], rng, tell)
            _go(live, name, home, SPEEDS[1], tell)
        watched = guard.motions
        arms = {
            name: fit_thresholds([(m.twin, m.columns, m.seen) for m in watched if m.arm == name])
            for name in calibrations
        }
    learned_on = {f"calibration.{name}": checksum for name, checksum in calibrations.items()}
    return ResidualThresholds(arms, {**twin_identity(cell), **learned_on})


def _home(cell: Cell, group: str) -> np.ndarray:
    names = cell.model.group(group).joint_names
    if "home" in cell.model.named_states.get(group, {}):
        return cell.model.named_state(group, "home").reindexed(names).positions
    return cell.scene().state.reindexed(names).positions


def _wander(
    live: LiveCell, group: str, home: np.ndarray, speed: float, rng: np.random.Generator,
    tell: Callable[[str], None],
) -> None:  # fmt: skip
    failure = ""
    for _ in range(TRIES):
        try:
            _go(live, group, home + rng.uniform(-REACH, REACH, len(home)), speed, tell)
            return
        except _NotFree as error:
            failure = str(error)
    raise InputError(f"{group}: no free motion near home was found: {failure}")


class _NotFree(InputError):
    """Error for a test motion that cannot be planned or that the cell's simulated twin rejects. armcell
    raises it while it learns the twin thresholds of a cell.
    """


def _go(live: LiveCell, group: str, q: np.ndarray, speed: float, tell: Callable[[str], None]) -> None:
    model, scene = live.model, live.scene()
    names = model.group(group).joint_names
    columns = list(model.columns(names))
    q = np.clip(q, model.lower[columns], model.upper[columns])
    goal = JointGoal(JointState(names, q))
    result = plan(scene, PlanRequest(group, (goal,), velocity_scaling=speed, acceleration_scaling=speed))
    if not result.ok or result.trajectory is None:
        raise _NotFree(result.message)
    done = execute(live.driver, live.ctx.gate.motion(result.trajectory))
    if not done.ok and done.evidence.get("twin"):
        raise _NotFree(done.message)
    if not done.ok:
        raise InputError(f"{group}: {done.message}", hint="see docs/real_ur.md, Faults")
    tell(f"{group}: {done.duration:.1f} s at {speed:.0%}")
