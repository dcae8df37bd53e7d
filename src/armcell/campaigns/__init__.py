"""Many randomised trials of a cell's task: how often it works, why it fails, what matters; the gate."""

from armcell.campaigns.campaign import begin, resume, run
from armcell.campaigns.moments import take_pictures
from armcell.campaigns.report import summary, write_report
from armcell.campaigns.spec import CampaignSpec
from armcell.campaigns.statistics import compare
from armcell.campaigns.store import Store, rows_of

__all__ = [
    "CampaignSpec", "Store", "begin", "compare", "resume", "rows_of", "run", "summary", "take_pictures",
    "write_report",
]  # fmt: skip
