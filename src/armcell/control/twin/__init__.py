"""The twin of a real robot: each motion is played in physics first, then watched against that."""

from armcell.control.twin.bands import ArmBands, TwinBands, learned
from armcell.control.twin.guard import UNWATCHED, TwinGuard
from armcell.control.twin.rehearsal import Rehearsal, Stage

__all__ = ["UNWATCHED", "ArmBands", "Rehearsal", "Stage", "TwinBands", "TwinGuard", "learned"]
