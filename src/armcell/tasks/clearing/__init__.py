"""Clearing a bin of unknown things by what a camera sees."""

from armcell.tasks.clearing.clear import Look, clear_bin
from armcell.tasks.clearing.settings import ClearSettings

__all__ = ["ClearSettings", "Look", "clear_bin"]
