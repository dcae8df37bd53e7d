"""Time parameterization of paths within velocity, acceleration, jerk and torque limits."""

from armcell.timing.blend import BlendedPath
from armcell.timing.jerk import jerk_limited
from armcell.timing.parameterize import (
    TimingSettings,
    TorqueLimitError,
    TorqueModel,
    parameterize,
    smoothing_departure,
)
from armcell.timing.stretch import check_scaling, reversed_in_time, stretched, stretched_to, synchronized

__all__ = [
    "BlendedPath",
    "TimingSettings",
    "TorqueLimitError",
    "TorqueModel",
    "check_scaling",
    "jerk_limited",
    "parameterize",
    "reversed_in_time",
    "smoothing_departure",
    "stretched",
    "stretched_to",
    "synchronized",
]
