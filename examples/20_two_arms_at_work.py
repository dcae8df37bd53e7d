"""Two arms, each with its own program, in one work space: no arm waits longer than needed.

python examples/20_two_arms_at_work.py
"""

import numpy as np

import armcell
from armcell.core import SE3, PoseGoal
from armcell.tasks import checked


def down_at(x, y):
    return PoseGoal(SE3.from_xyz_rpy((x, y, 1.05), (np.pi, 0.0, 0.0)))


def patrol(arm, points, log):
    """To the points one after the other; the middle only with the key to it."""
    for x, y in points:
        checked(arm.move_to(down_at(x, y)))
        with arm.reserve("the middle"):
            checked(arm.move_to(down_at(0.0, 0.0)))
            log.append(arm.group)
    checked(arm.move_to("home"))


log = []
with armcell.load("dual_ur10").connect("sim", seed=1) as cell:
    result = cell.side_by_side(
        left_arm=lambda arm: patrol(arm, [(-0.4, 0.0), (0.4, 0.0)], log),
        right_arm=lambda arm: patrol(arm, [(0.4, 0.0), (-0.4, 0.0)], log),
    )
    touched = cell.driver.unwanted_contacts()
print(f"{'done' if result else result.message} in {result.makespan:.1f} s, {len(touched)} contacts")
print("in the middle:", ", ".join(log))
print(f"yielded {sum(result.yielded.values())} times, took a detour {sum(result.searched.values())} times")
