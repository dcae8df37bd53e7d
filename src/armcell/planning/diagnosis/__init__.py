"""Diagnosis: explains why planning failed and which changes help; one module per cause."""

from armcell.planning.diagnosis.dispatch import explain_misuse, with_explanation
from armcell.planning.diagnosis.pose import Branch, PoseExplanation, explain_pose, solutions_beyond_limits
from armcell.planning.diagnosis.start_state import explain_start

__all__ = [
    "Branch",
    "PoseExplanation",
    "explain_misuse",
    "explain_pose",
    "explain_start",
    "solutions_beyond_limits",
    "with_explanation",
]
