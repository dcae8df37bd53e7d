"""Digital twin of a real robot: dry-runs each motion, then monitors the robot's deviation."""

from armcell.twin.dry_run import DryRun, TwinSimulation
from armcell.twin.guard import UNWATCHED, TwinGuard
from armcell.twin.residual_thresholds import ArmResidualThresholds, ResidualThresholds, fit_thresholds

__all__ = [
    "UNWATCHED",
    "ArmResidualThresholds",
    "DryRun",
    "ResidualThresholds",
    "TwinGuard",
    "TwinSimulation",
    "fit_thresholds",
]
