"""Whether the joints keep up with a motion of the tip, and how much slower would do."""

from __future__ import annotations

import numpy as np

from armcell.core import ErrorCode, JointTrajectory, Outcome, PlanRequest
from armcell.model import RobotModel
from armcell.timing.sampling import peaks

ROUNDING = 1e-6
SPARE = 1.02  # what is said to be slow enough is by so much slower


def within_limits(
    model: RobotModel, trajectory: JointTrajectory, request: PlanRequest | None, what: str = ""
) -> Outcome | None:
    """None, or which joint is too slow for it, where, and what would do.

    The limits are the joints' own: scalings are for the tip here, as in MoveIt.

    Args:
        request: whose scalings made the motion; None where it cannot be told by two numbers.
    """
    names = trajectory.joint_names
    velocity, acceleration = model.limits(names, "velocity"), model.limits(names, "acceleration")
    q, v, a = trajectory.positions, trajectory.velocities, trajectory.accelerations
    assert v is not None and a is not None
    peak_v, peak_a = peaks(trajectory.times, q, v, a, velocity, acceleration)
    if peak_v <= 1.0 + ROUNDING and peak_a <= 1.0 + ROUNDING:
        return None
    slower = max(peak_v, float(np.sqrt(peak_a)))
    by_velocity = peak_v >= np.sqrt(peak_a)
    ratios = np.abs(v) / velocity if by_velocity else np.abs(a) / acceleration
    row, joint = (int(i) for i in np.unravel_index(np.argmax(ratios), ratios.shape))
    kind, unit = ("velocity", "rad/s") if by_velocity else ("acceleration", "rad/s^2")
    if model.joint(names[joint]).type == "prismatic":
        unit = unit.replace("rad", "m")
    limit = float((velocity if by_velocity else acceleration)[joint])
    needed = limit * float(peak_v if by_velocity else peak_a)
    at = float(trajectory.times[row] / trajectory.duration)
    text = (
        f"{what}{names[joint]} would need a {kind} of {needed:.3g} {unit} at {at:.0%} of the time, "
        f"its limit is {limit:.3g}: it has to be {slower:.3g} times slower"
    )
    evidence = {"joint": names[joint], kind: needed, "limit": limit, "slower": slower, "fraction": at}
    if request is not None:
        v_scale = request.velocity_scaling / (slower * SPARE)
        a_scale = request.acceleration_scaling / (slower * SPARE) ** 2
        text += f" (velocity_scaling {v_scale:.3g} with acceleration_scaling {a_scale:.3g} would do)"
        evidence |= {"velocity_scaling": v_scale, "acceleration_scaling": a_scale}
    return Outcome(ErrorCode.PLANNING_FAILED, text, evidence)
