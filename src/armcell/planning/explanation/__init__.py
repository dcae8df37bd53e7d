"""Why not, and what would help? One file per cause; `attach` gives failed results their explainer."""

from armcell.planning.explanation.attach import explain_misuse, explained
from armcell.planning.explanation.measured import explain_start
from armcell.planning.explanation.pose import Branch, PoseExplanation, beyond_limits, explain_pose

__all__ = [
    "Branch",
    "PoseExplanation",
    "beyond_limits",
    "explain_misuse",
    "explain_pose",
    "explain_start",
    "explained",
]
