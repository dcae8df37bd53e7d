"""How fast? Time parameterisation of paths."""

from armcell.timing.blend import BlendedPath
from armcell.timing.parameterize import (
    TimingSettings,
    check_scaling,
    parameterize,
    reversed_in_time,
    stretched,
)

__all__ = ["BlendedPath", "TimingSettings", "check_scaling", "parameterize", "reversed_in_time", "stretched"]
