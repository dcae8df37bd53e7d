"""Digital twin of a real robot: dry-runs each motion, then monitors the robot's deviation."""

from armcell.control.twin.bands import ArmBands, TwinBands, learned
from armcell.control.twin.guard import UNWATCHED, TwinGuard
from armcell.control.twin.rehearsal import Rehearsal, Stage

__all__ = ["UNWATCHED", "ArmBands", "Rehearsal", "Stage", "TwinBands", "TwinGuard", "learned"]
