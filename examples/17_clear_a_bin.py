"""A bin of unknown things is emptied by what two depth cameras see; then a cube that is dropped on the way.

python examples/17_clear_a_bin.py
"""

import armcell
from armcell.core import Event
from armcell.tasks import BinClearingSettings

# 1. Twenty mixed things, dropped by physics. The planner knows none of them.
cell = armcell.load("bin_clearing")
with cell.connect("sim", seed=0) as live:
    print("the planner knows:", ", ".join(live.scene().objects))
    few = BinClearingSettings(most_picks=6)  # take the limit away and it goes on until the bin is empty
    outcome = live.clear(
        "bin", into="tray", table="work_table", camera="above_bin", tray_camera="above_tray", settings=few
    )
    e = outcome.evidence
    print(f"{e['picks']} picks: {e['cleared']} of {e['things']} things in the tray, {e['missed']} misses")
    print("why it ended:", outcome.message)
    print("unwanted contacts:", len(live.driver.unwanted_contacts()))


# 2. Something goes wrong on purpose: the hand opens while it carries the cube.
class Clumsy:
    """An observer that opens the hand at the beginning of the first way to the tray."""

    done = False

    def on_event(self, event: Event) -> None:
        if event.text == "move to pre-place" and not self.done:
            self.done = True
            live.driver.world.set_gripper_target("hand", 0.08)

    def on_state(self, sample) -> None: ...

    def on_trajectory(self, time, trajectory) -> None: ...


with armcell.load("panda_pick").connect("sim", seed=1, observers=[Clumsy()]) as live:
    outcome = live.arm.transfer("cube", on="tray")
    print(f"transfer: {outcome.code.name} after {outcome.evidence['tries']} tries")
    print("trouble:", *outcome.evidence["troubles"])
