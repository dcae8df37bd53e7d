"""Bin clearing: picks unknown objects from a bin by camera images."""

from armcell.tasks.bin_clearing.clear_bin import clear_bin
from armcell.tasks.bin_clearing.counts import BinClearingCounts
from armcell.tasks.bin_clearing.settings import BinClearingSettings
from armcell.tasks.bin_clearing.work_regions import Look

__all__ = ["BinClearingCounts", "BinClearingSettings", "Look", "clear_bin"]
