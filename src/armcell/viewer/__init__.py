"""Browser view of a robot cell, built on viser.

Importing this package is cheap: viser is imported when a viewer is created.
"""

from armcell.viewer.planning_panel import PlanningPanel
from armcell.viewer.session import PlanningSession
from armcell.viewer.viewer import CellViewer
from armcell.viewer.why import draw_explanation, show_explanation

__all__ = ["CellViewer", "PlanningPanel", "PlanningSession", "draw_explanation", "show_explanation"]
