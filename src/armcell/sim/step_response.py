"""Step responses of a robot's joints in physics: how a set of gains follows a jump of the target."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armcell.core import InputError, UnknownNameError
from armcell.core.checks import settings_from
from armcell.model.files import read_yaml
from armcell.scene import PlanningScene
from armcell.sim.settings import PhysicsSettings
from armcell.sim.world import SimWorld

Array = NDArray[np.float64]

GAINS = Path(__file__).parent / "gains"
BAND = 0.02  # of the step: within it the joint counts as settled


def gains_names() -> list[str]:
    """Sets of gains that come along."""
    return sorted(p.stem for p in GAINS.glob("*.yaml"))


def with_gains(settings: PhysicsSettings, gains: str | Path) -> PhysicsSettings:
    """Settings with the arm's control and gains from a YAML file, or from a set by name.

    Raises:
        InputError: no such file, or a key or value that is not a gain.
    """
    name = str(gains)
    if "/" not in name and "." not in name:
        if name not in gains_names():
            raise UnknownNameError("set of gains", name, gains_names())
        gains = GAINS / f"{name}.yaml"
    values, known = read_yaml(Path(gains)), ["arm_control", "arm_kp", "arm_ki", "arm_kv"]
    known += ["slide_kp", "slide_kv", "gravity_compensation", "full_gain_effort"]
    for key in values:
        if key not in known:
            raise UnknownNameError("gain", key, known, file=Path(gains))
    mine = {f.name: getattr(settings, f.name) for f in fields(settings)}
    try:
        return settings_from(PhysicsSettings, {**mine, **values}, "gains")
    except InputError as error:
        raise InputError(error.reason, file=Path(gains), cure=error.cure) from None


@dataclass(frozen=True, eq=False)
class StepResponse:
    """One joint's answer to a jump of its target at time 0, from rest. Times in s, angles in rad or m."""

    joint: str
    size: float
    times: Array  # (k,)
    positions: Array  # (k,), from where the joint was
    rise_time: float  # from 10 to 90 % of the step; inf if it never gets there
    overshoot: float  # beyond the target, share of the step
    settling_time: float  # after which it stays within 2 % of the step; inf if it does not
    final_error: float  # at the end


def sag(scene: PlanningScene, settings: PhysicsSettings, duration: float = 1.0) -> dict[str, float]:
    """How far each actuated joint leaves the scene's positions while it is told to stay [rad or m]."""
    world = SimWorld(scene, settings)
    worst = np.zeros(scene.model.dof)
    for _ in range(max(round(duration / settings.timestep), 1)):
        world.step()
        worst = np.maximum(worst, np.abs(world.joint_state().positions - scene.positions))
    return dict(zip(scene.model.joint_names, worst.tolist(), strict=True))


def step_responses(
    scene: PlanningScene, joints: tuple[str, ...], settings: PhysicsSettings, size: float = 0.1,
    duration: float = 2.0,
) -> list[StepResponse]:  # fmt: skip
    """Each joint in turn, from the scene's state at rest.

    Args:
        size: of the step [rad or m]; downwards for a joint that stands too near its upper limit.
    Raises:
        InputError: a size or duration that is not positive, or a joint without room for the step.
    """
    for what, value in (("size", size), ("duration", duration)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{what} of a step is {value:g}, it must be positive")
    found, steps = [], max(round(duration / settings.timestep), 10)
    for joint in joints:
        column = scene.model.columns((joint,))[0]
        start = float(scene.positions[column])
        signed = size if start + size <= scene.model.upper[column] else -size
        if start + signed < scene.model.lower[column]:
            raise InputError(f"joint {joint!r} has no room for a step of {size:g}")
        world = SimWorld(scene, settings)
        world.set_arm_target((joint,), [start + signed])
        positions = np.zeros(steps + 1)
        for i in range(steps):
            world.step()
            positions[i + 1] = world.joint_state().positions[column] - start
        times = np.arange(steps + 1, dtype=np.float64) * settings.timestep
        found.append(_measured(joint, signed, times, positions))
    return found


def _measured(joint: str, size: float, times: Array, positions: Array) -> StepResponse:
    share = positions / size
    above = [np.flatnonzero(share >= level) for level in (0.1, 0.9)]
    rise = float(times[above[1][0]] - times[above[0][0]]) if len(above[1]) else np.inf
    off = np.flatnonzero(np.abs(share - 1) > BAND)
    settled = float(times[off[-1] + 1]) if off[-1] + 1 < len(times) else np.inf
    return StepResponse(
        joint, size, times, positions, rise, max(float(share.max()) - 1, 0.0), settled,
        float(abs(positions[-1] - size)),
    )  # fmt: skip
