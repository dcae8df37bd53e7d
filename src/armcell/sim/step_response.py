"""Step responses of the arm joints in physics, to evaluate a set of gains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import InputError
from armcell.scene import PlanningScene
from armcell.sim.settings import PhysicsSettings
from armcell.sim.world import SimWorld

Array = NDArray[np.float64]

BAND = 0.02  # tolerance as a fraction of the step size within which the joint counts as settled


@dataclass(frozen=True, eq=False)
class StepResponse:
    """Response of one arm joint to a step of its target at time 0, starting from rest.

    Times are in s, positions in rad or m.
    """

    joint: str
    size: float
    times: Array  # (k,)
    positions: Array  # (k,), relative to the joint's initial position
    rise_time: float  # from 10 to 90 % of the step; inf if the joint never reaches 90 %
    overshoot: float  # beyond the target, as a fraction of the step size
    settling_time: float  # time from which the joint stays within 2 % of the step; inf if it does not settle
    final_error: float  # distance from the target at the end


def sag(scene: PlanningScene, settings: PhysicsSettings, duration: float = 1.0) -> dict[str, float]:
    """Measure the static response of each joint: how far [rad or m] it sags under gravity while it holds its
    position in the physics simulation.

    The joints hold the scene's positions under gravity for `duration` [s].
    """
    worst = np.zeros(scene.model.dof)
    with SimWorld(scene, settings) as world:
        for _ in range(max(round(duration / settings.timestep), 1)):
            world.step()
            worst = np.maximum(worst, np.abs(world.joint_state().positions - scene.positions))
    return dict(zip(scene.model.joint_names, worst.tolist(), strict=True))


def step_responses(
    scene: PlanningScene, joints: tuple[str, ...], settings: PhysicsSettings, size: float = 0.1,
    duration: float = 2.0,
) -> list[StepResponse]:  # fmt: skip
    """Measure how each joint responds to a step of its target in the physics simulation, one joint at a time.

    Each response starts from the scene's state at rest.

    Args:
        size: step size [rad or m]; the step is negative for a joint too close to its upper limit.
        duration: simulated time per joint [s].
    Raises:
        InputError: `size` or `duration` is not positive, or a joint's range is too small for the step.
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
        positions = np.zeros(steps + 1)
        with SimWorld(scene, settings) as world:
            world.set_arm_target((joint,), [start + signed])
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
