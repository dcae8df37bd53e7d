"""`armcell doctor CELL`: check that arms follow in physics, and find out why if they do not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from armcell.cli.doctor_finding import NO, OK, Finding
from armcell.core import ArmcellError, InputError

JUMP = 0.05  # [rad or m] step of each joint's target, in turn
TIME = 1.0  # [s] time to follow the step
MOST_OFF = 0.2  # largest error at the end, as share of the step
MOST_OVER = 0.5  # largest overshoot, as share of the step
FINER = (0.005, 0.002, 0.001, 0.0005)  # [s] physics time steps to try if the cell's own fails


def check_drives(loaded: Any) -> Iterator[Finding]:
    """Check, for `armcell doctor`, how well the arm joints follow a small step in the physics simulation.

    The check uses the cell's time step and gains. If the joints do not follow, finer time steps show whether
    the time step or the gains are the cause.
    """
    scene, physics = loaded.scene(), loaded.physics
    step = physics.timestep
    text, sound = _followed(scene, physics)
    if sound:
        yield Finding(OK, "physics step", f"{1e3 * step:g} ms: {text}")
        return
    for finer in (s for s in FINER if s < step):
        if _followed(scene, replace(physics, timestep=finer))[1]:
            hint = f"with {1e3 * finer:g} ms they follow: write `timestep: {finer:g}` under `physics:`"
            yield Finding(NO, "physics step", f"{1e3 * step:g} ms is too coarse: {text}; {hint}")
            return
    gains = f"arm_kp {physics.arm_kp:g}, arm_kv {physics.arm_kv:g}"
    gains += f", joint_gains of {', '.join(physics.joint_gains)}" if physics.joint_gains else ""
    hint = f"look at the gains under `physics:` ({gains}), and at efforts, masses and inertias in the URDF"
    yield Finding(NO, "drives", f"{text}, with a finer step as well: {hint}")


def _followed(scene: Any, physics: Any) -> tuple[str, bool]:
    """Describe, for `armcell doctor`, the step response of the joint that follows a step least accurately,
    and return whether it is acceptable.
    """
    from armcell.sim.step_response import step_responses

    fingers = {name for g in scene.model.grippers.values() for name in g.joint_names}
    worst, text = -1.0, "no joint has room to move"
    for joint in scene.model.joint_names:
        if joint in fingers:
            continue
        try:
            (found,) = step_responses(scene, (joint,), physics, JUMP, TIME)
        except InputError:  # the joint limits leave no range for the step
            continue
        except ArmcellError as error:
            return f"{joint}: {error}", False
        off = found.final_error / JUMP
        badness = max(off / MOST_OFF, found.overshoot / MOST_OVER)
        if badness > worst:
            worst = badness
            over = f"{found.overshoot:.0%} beyond on the way"
            text = f"{joint} is off by {off:.0%} of a jump of {JUMP:g} after {TIME:g} s, {over}"
    return text, bool(np.isfinite(worst) and worst <= 1.0)
