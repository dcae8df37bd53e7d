"""Browser view of a cell (viser). Importing this is light: viser loads when a viewer is made."""

from armcell.viewer.planning_panel import PlanningPanel
from armcell.viewer.session import PlanningSession
from armcell.viewer.viewer import CellViewer
from armcell.viewer.why import draw_explanation, show_explanation

__all__ = ["CellViewer", "PlanningPanel", "PlanningSession", "draw_explanation", "show_explanation"]
