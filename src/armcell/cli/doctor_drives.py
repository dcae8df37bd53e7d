"""`armcell doctor CELL`: whether arms follow in physics; if not, whether step or drives are to blame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from armcell.cli.doctor_line import NO, OK, Line
from armcell.core import ArmcellError, InputError

JUMP = 0.05  # [rad or m] of each joint's target, in turn
TIME = 1.0  # [s] it has for that
MOST_OFF = 0.2  # of the jump, at the end
MOST_OVER = 0.5  # of the jump, on the way
FINER = (0.005, 0.002, 0.001, 0.0005)  # [s] steps to try where the cell's own does not do


def drives(loaded: Any) -> Iterator[Line]:
    """How the joints of the arms follow a small jump with the cell's step and gains."""
    scene, physics = loaded.scene(), loaded.physics
    step = physics.timestep
    text, sound = _followed(scene, physics)
    if sound:
        yield Line(OK, "physics step", f"{1e3 * step:g} ms: {text}")
        return
    for finer in (s for s in FINER if s < step):
        if _followed(scene, replace(physics, timestep=finer))[1]:
            cure = f"with {1e3 * finer:g} ms they follow: write `timestep: {finer:g}` under `physics:`"
            yield Line(NO, "physics step", f"{1e3 * step:g} ms is too coarse: {text}; {cure}")
            return
    gains = f"arm_kp {physics.arm_kp:g}, arm_kv {physics.arm_kv:g}"
    cure = f"look at the gains under `physics:` ({gains}), and at efforts, masses and inertias in the URDF"
    yield Line(NO, "drives", f"{text}, with a finer step as well: {cure}")


def _followed(scene: Any, physics: Any) -> tuple[str, bool]:
    """The worst joint, in words, and whether it is good enough."""
    from armcell.sim.step_response import step_responses

    fingers = {g.joint_name for g in scene.model.grippers.values()}
    worst, text = -1.0, "no joint has room to move"
    for joint in scene.model.joint_names:
        if joint in fingers:
            continue
        try:
            (found,) = step_responses(scene, (joint,), physics, JUMP, TIME)
        except InputError:  # no room for the jump
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
