"""Your own task of stages: checked before planning, ranked by cost, with a table where it fails.

python examples/36_tasks_of_stages.py
"""

import armcell
from armcell.core import NamedGoal
from armcell.planning import warm_up
from armcell.tasks import (
    Alternatives,
    Connect,
    Fallbacks,
    Merger,
    MoveGripper,
    MoveStraight,
    PartialSolution,
    SearchState,
    Serial,
    Task,
    TaskError,
    clearance,
    duration,
    path_length,
    perform_all,
    perform_pipelined,
    pick_stages,
    picking,
    place_stages,
    placing,
    weighted,
)

cell = armcell.load("panda_pick")
s = cell.settings
warm_up()  # compiled before the clock of a plan runs

with cell.connect(seed=1) as live:
    hand, scene = live.model.gripper(), live.scene()
    arm, tip = hand.arm_group, hand.tcp_link

    # 1. One task of two parts. armcell checks the stages' inputs before it plans.
    pick = Serial("pick", tuple(pick_stages(scene, "cube", hand, s)))
    place = Serial("place", tuple(place_stages("cube", "tray", hand, s)))
    try:
        Task("the wrong way round", (place, pick)).plan(PartialSolution(scene), SearchState(s))
    except TaskError as error:
        print("checked:", error.problems[0])

    # 2. Several plans, cheapest first. Any function of a solution can be the cost.
    for name, cost in (("duration", duration), ("path_length", path_length),
                       ("both", weighted((1.0, duration), (0.05, clearance)))):  # fmt: skip
        plan = Task("pick and place", (pick, place), cost).plan(
            PartialSolution(scene), SearchState(s), count=4
        )
        print(f"by {name}:", ", ".join(f"{c:.2f}" for c in plan.costs))

    # 3. Alternatives: go home and close the fingers at the same time if certified, otherwise in sequence.
    home = Connect("home", arm, s.free, goal=NamedGoal("home"))
    narrow = MoveGripper("narrow", hand, 0.03)
    leave = Fallbacks("leave", (Merger("at once", (home, narrow)), Serial("in turn", (home, narrow))))
    plan = Task("all of it", (pick, place, leave)).plan(PartialSolution(scene), SearchState(s))
    last = type(plan.best.steps[-1]).__name__
    print("performed:", perform_all(live.ctx, plan.best.steps).code.name, "- the last step:", last)

    # 4. The failure table: stages, counts, nearest miss and reason.
    ways = [MoveStraight(f"{x:g} m", arm, tip, s.near, (x, 0.0, 0.0)) for x in (2.0, 3.0)]
    plan = Task("too far", (Alternatives("ahead", tuple(ways)), leave)).plan(
        PartialSolution(live.scene()), SearchState(s)
    )
    print(plan.code.name)
    print(plan.table())

    # 5. There and back: armcell plans each task while the previous one runs.
    parts = [picking("cube", hand), placing("cube", "table", hand, at=(0.0, -0.2)),
             picking("cube", hand), placing("cube", "tray", hand)]  # fmt: skip
    outcome = perform_pipelined(live.ctx, parts)
    evidence = outcome.evidence
    print(
        outcome.code.name,
        f"{len(evidence['performed'])} parts, {evidence['ahead']} by plans made ahead",
        evidence["again"],
    )
