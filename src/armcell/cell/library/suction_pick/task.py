"""One arm picks with suction cups; objects that the cups cannot hold are refused before the arm moves."""

from __future__ import annotations

from armcell.core import ErrorCode, Outcome
from armcell.tasks import checked

PLACES = {"carton": (-0.08, 0.09), "plate": (0.09, 0.09), "box": (-0.1, -0.1), "can": (0.09, -0.1)}
REFUSED = ("safe", "ball")  # too heavy, too curved


def task(cell):
    refusals = {}
    for item in REFUSED:
        began = cell.ctx.driver.now
        outcome = cell.arm.pick(item)
        if outcome.ok or cell.ctx.driver.now > began:
            return Outcome(ErrorCode.FAILURE, f"the {item} was not refused before the arm moved")
        cell.ctx.emit("note", f"refused: {outcome.message}")
        refusals[f"refused_{item}"] = outcome.message
    for item, at in PLACES.items():
        checked(cell.arm.pick(item))
        checked(cell.arm.place(item, on="mat", at=at))
    checked(cell.arm.move_to("home"))
    return Outcome(ErrorCode.SUCCESS, evidence=refusals)
