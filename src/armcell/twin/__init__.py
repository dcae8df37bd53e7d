"""Digital twin of a real robot: dry-runs each motion, then monitors the robot's deviation."""

from armcell.twin.bands import ArmBands, TwinBands, learned
from armcell.twin.guard import UNWATCHED, TwinGuard
from armcell.twin.rehearsal import Rehearsal, Stage

__all__ = ["UNWATCHED", "ArmBands", "Rehearsal", "Stage", "TwinBands", "TwinGuard", "learned"]
