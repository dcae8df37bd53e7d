"""Time parameterization of paths within velocity, acceleration, jerk and torque limits."""

from armcell.timing.blend import BlendedPath
from armcell.timing.editing import (
    check_scaling,
    concatenated,
    delayed,
    merged,
    resting,
    reversed_in_time,
    section,
    started_from,
    stretched,
    stretched_to,
    synchronized,
    with_resting_joints,
)
from armcell.timing.jerk import jerk_limited
from armcell.timing.parameterize import (
    TimingSettings,
    TorqueLimitError,
    TorqueModel,
    checked_limits,
    parameterize,
    smoothing_departure,
)

__all__ = [
    "BlendedPath",
    "TimingSettings",
    "TorqueLimitError",
    "TorqueModel",
    "check_scaling",
    "checked_limits",
    "concatenated",
    "delayed",
    "jerk_limited",
    "merged",
    "parameterize",
    "resting",
    "reversed_in_time",
    "section",
    "smoothing_departure",
    "started_from",
    "stretched",
    "stretched_to",
    "synchronized",
    "with_resting_joints",
]
