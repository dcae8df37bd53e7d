"""PTP: the fastest synchronous motion of the joints; all of them start, cruise, brake and end together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.core import Outcome
from armcell.planning.industrial.command import AT_GOAL, Command, Made, timed
from armcell.planning.industrial.curves import JointLine
from armcell.planning.industrial.profile import Profile, Trapezoid
from armcell.planning.problem import INDUSTRIAL, pipelines

Array = NDArray[np.float64]


def synchronous(step: Array, velocity: Array, acceleration: Array, deceleration: Array) -> Trapezoid:
    """The fastest trapezoid over s in 0..1 with which joints that go by `step` (n,) keep their limits (n,).

    MoveIt takes the group's strictest limits for every joint. Here each joint has its own: where they are
    all the same the motion is MoveIt's, else it is not slower.
    """
    ways = np.abs(step)
    moving = ways > 0.0
    return Trapezoid.fastest(
        1.0,
        *(float(np.min(limit[moving] / ways[moving])) for limit in (velocity, acceleration, deceleration)),
    )


@pipelines[INDUSTRIAL].register("PTP")
def ptp(command: Command) -> Made | Outcome:
    if np.max(np.abs(command.goal - command.start)) <= AT_GOAL:
        return command.standing()
    names, request = command.question.joint_names, command.request
    model = command.question.scene.model
    curve = JointLine(command.start, command.goal)
    velocity = model.limits(names, "velocity") * request.velocity_scaling
    acceleration = model.limits(names, "acceleration") * request.acceleration_scaling
    profile = Profile(
        synchronous(curve.step, velocity, acceleration, acceleration), command.settings.smoothing
    )
    tip = model.group(request.group).tip_link
    return Made(curve, timed(curve, profile, names), None if tip is None else command.placed())
