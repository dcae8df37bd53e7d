"""Links that are named like suction cups."""

from __future__ import annotations

import re
from collections.abc import Sequence

from armcell.model.robot import RobotModel

SUCTION = re.compile(r"suction|vacuum|sucker|bellow|(?<![a-z])cups?(?![a-z])", re.IGNORECASE)
CUP = re.compile(r"sucker|bellow|(?<![a-z])cups?(?![a-z])", re.IGNORECASE)


def cup_links(model: RobotModel, links: Sequence[str]) -> tuple[str, ...]:
    """Return which of the given links are named like suction cups or, if none is, like a vacuum gripper.

    Of links that carry each other, only the outermost ones are in the result.
    """
    solid = [n for n in links if model.links[n].collisions or model.links[n].visuals]
    named = [n for n in solid if CUP.search(n)] or [n for n in solid if SUCTION.search(n)]
    return tuple(n for n in named if not set(model.subtree(n)[1:]) & set(named))
