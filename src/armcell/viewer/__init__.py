"""Browser view of a cell (viser). Importing this is light: viser loads when a viewer is made."""

from armcell.viewer.viewer import CellViewer

__all__ = ["CellViewer"]
