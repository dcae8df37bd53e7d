"""Recovery as a behaviour tree of py_trees: drawn, changed, and run. Needs pip install 'armcell[trees]'.

python examples/37_behaviour_tree.py
"""

import py_trees

import armcell
from armcell.core import ErrorCode, Outcome
from armcell.tasks import trees


class Clumsy:
    """Watches the cell and opens the hand once, when the cube is on its way."""

    def __init__(self, live, hand):
        self.live, self.hand, self.done = live, hand, False

    def on_event(self, event):
        if event.text == "move to pre-place" and not self.done:
            self.done = True
            self.live.driver.command_gripper(self.hand.name, self.hand.max_width, self.hand.max_force)

    def on_state(self, sample): ...

    def on_trajectory(self, time, trajectory): ...


with armcell.load("panda_pick").connect(seed=2) as live:
    ctx, hand = live.ctx, live.model.gripper()

    # 1. What `transfer` does, as a tree, before anything has moved.
    bring = trees.transferring(ctx, "cube", hand, on="tray")
    print(trees.drawn(bring, status=False))

    # 2. Your own around it: a guard that comes first in every tick, and the way home at the end.
    safe = trees.Check("area free?", lambda: Outcome(ErrorCode.SUCCESS))
    work = py_trees.composites.Sequence(
        "work", memory=True, children=[bring, trees.moving_to(ctx, hand.arm_group, "home")]
    )
    root = py_trees.composites.Sequence("guarded", memory=False, children=[safe, work])

    # 3. Run it while the hand is made to drop its object.
    ctx.observers.append(Clumsy(live, hand))
    outcome = trees.run(root)
    print(outcome.code.name, "after", outcome.evidence["ticks"], "ticks")
    print(trees.drawn(root))
    print("lifted", sum(report.name == "lift" for report in live.reports), "times")
    print("dot:", trees.as_dot(root).splitlines()[0])

    # 4. What cannot be done fails with its reasons.
    outcome = trees.run(trees.picking(ctx, "wall", hand))
    print(outcome.code.name, outcome.message)
