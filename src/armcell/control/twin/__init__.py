"""The twin of a real robot: each motion is played in physics first, then watched against that."""

from armcell.control.twin.bands import ArmBands, TwinBands, learned
from armcell.control.twin.guard import TwinGuard
from armcell.control.twin.rehearsal import Rehearsal, Stage

__all__ = ["ArmBands", "Rehearsal", "Stage", "TwinBands", "TwinGuard", "learned"]
