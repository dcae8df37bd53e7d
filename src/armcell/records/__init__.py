"""Records of a run: run folder, MCAP file for Foxglove, HTML report, replay and comparison."""

from armcell.records.about import about_run, cell_of
from armcell.records.again import execute_again
from armcell.records.compare import Comparison, compare
from armcell.records.reader import Record, read_record
from armcell.records.recorder import Picture, RunRecorder, Series, new_run_folder
from armcell.records.report import REPORT_FILE, write_report

__all__ = [
    "REPORT_FILE", "Comparison", "Picture", "Record", "RunRecorder", "Series", "about_run", "cell_of",
    "compare", "execute_again", "new_run_folder", "read_record", "write_report",
]  # fmt: skip
