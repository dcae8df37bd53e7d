"""Campaigns: many randomized trials of a cell's task, with statistics and the gate.

A campaign measures the success rate of a task, groups the causes of failures and ranks the parameters that
influence success. The gate requires such a campaign before a task runs on real arms.
"""

from armcell.campaigns.campaign import begin, resume, run
from armcell.campaigns.failure_frames import take_pictures
from armcell.campaigns.report import summary, write_report
from armcell.campaigns.spec import CampaignSpec
from armcell.campaigns.statistics import compare
from armcell.campaigns.store import Store, rows_of

__all__ = [
    "CampaignSpec", "Store", "begin", "compare", "resume", "rows_of", "run", "summary", "take_pictures",
    "write_report",
]  # fmt: skip
