"""Diagnosis: explains why planning failed and which changes help; one module per cause."""

from armcell.planning.diagnosis.dispatch import explain_invalid_request, with_explanation
from armcell.planning.diagnosis.start_state import explain_start
from armcell.planning.diagnosis.unreachable_pose import (
    IKBranch,
    PoseExplanation,
    explain_pose,
    solutions_beyond_limits,
)

__all__ = [
    "IKBranch",
    "PoseExplanation",
    "explain_invalid_request",
    "explain_pose",
    "explain_start",
    "solutions_beyond_limits",
    "with_explanation",
]
