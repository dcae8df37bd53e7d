"""Bin clearing: picks unknown objects from a bin by camera images."""

from armcell.tasks.clearing.clear import Look, clear_bin
from armcell.tasks.clearing.settings import ClearSettings

__all__ = ["ClearSettings", "Look", "clear_bin"]
