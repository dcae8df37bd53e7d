"""Browser view of a cell (viser). Importing this is light: viser loads when a viewer is made."""

from armcell.viewer.viewer import CellViewer
from armcell.viewer.why import show_explanation

__all__ = ["CellViewer", "show_explanation"]
