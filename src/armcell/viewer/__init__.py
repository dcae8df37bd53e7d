"""Browser view of a robot cell, built on viser.

Importing this package is cheap: viser is imported when a viewer is created.
"""

from armcell.viewer.explanation_view import draw_explanation, show_explanation
from armcell.viewer.planning_panel import PlanningPanel
from armcell.viewer.planning_session import PlanningSession
from armcell.viewer.viewer import CellViewer

__all__ = ["CellViewer", "PlanningPanel", "PlanningSession", "draw_explanation", "show_explanation"]
