"""Records of a run: run folder, MCAP file for Foxglove, HTML report, replay and comparison."""

from armcell.records.compare import Comparison, compare
from armcell.records.metadata import recorded_cell, run_metadata
from armcell.records.reader import Record, read_record
from armcell.records.recorder import Picture, RunRecorder, Series, new_run_folder
from armcell.records.reexecution import reexecute
from armcell.records.report import REPORT_FILE, write_report

__all__ = [
    "REPORT_FILE",
    "Comparison",
    "Picture",
    "Record",
    "RunRecorder",
    "Series",
    "compare",
    "new_run_folder",
    "read_record",
    "recorded_cell",
    "reexecute",
    "run_metadata",
    "write_report",
]  # fmt: skip
