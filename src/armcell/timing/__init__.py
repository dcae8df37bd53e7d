"""Time parameterization of paths within velocity, acceleration, jerk and torque limits."""

from armcell.timing.blend import BlendedPath
from armcell.timing.jerk import jerk_limited
from armcell.timing.parameterize import (
    TimingSettings,
    TorqueLimitError,
    TorqueModel,
    checked_limits,
    parameterize,
    smoothing_deviation,
)
from armcell.timing.trajectory_editing import (
    check_scaling,
    concatenate_trajectories,
    delay_trajectory,
    merge_trajectories,
    reverse_trajectory,
    slow_down,
    slow_down_to_duration,
    stationary_trajectory,
    synchronize_trajectories,
    trajectory_section,
    with_resting_joints,
    with_start_state,
)

__all__ = [
    "BlendedPath",
    "TimingSettings",
    "TorqueLimitError",
    "TorqueModel",
    "check_scaling",
    "checked_limits",
    "concatenate_trajectories",
    "delay_trajectory",
    "jerk_limited",
    "merge_trajectories",
    "parameterize",
    "reverse_trajectory",
    "slow_down",
    "slow_down_to_duration",
    "smoothing_deviation",
    "stationary_trajectory",
    "synchronize_trajectories",
    "trajectory_section",
    "with_resting_joints",
    "with_start_state",
]
