"""Records of a run: its folder, the MCAP that Foxglove opens, the HTML report. Plots and MCAP load lazily."""

from armcell.records.recorder import Picture, RunRecorder, Series, new_run_folder
from armcell.records.report import write_report

__all__ = ["Picture", "RunRecorder", "Series", "new_run_folder", "write_report"]
