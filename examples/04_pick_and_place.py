"""Pick up a cube and place it, in physics: friction holds it, and every number can be asked for.

`armcell.load` gives a cell (here a built-in one); `connect` makes it live, simulated ("sim") or with a robot
that follows exactly ("fake"). The task script is the same for every mode.

    python examples/04_pick_and_place.py            add --view to watch it in the browser
"""

import sys
from contextlib import ExitStack

import armcell
from armcell.core import SE3, InputError

cell = armcell.load("panda_pick")
print(f"{cell.name}: {cell.spec.description}")

with ExitStack() as stack:
    observers, time_scale = [], None  # None: as fast as the computer can
    if "--view" in sys.argv:
        from armcell.viewer import CellViewer

        observers.append(stack.enter_context(CellViewer(cell.scene(), title=cell.name)))
        time_scale = 1.0  # real time
        print("watch it at", observers[0].url)
    live = stack.enter_context(cell.connect("sim", observers=observers, time_scale=time_scale))
    start = live.scene().object("cube").T_world_object
    print("the cube is at", start)

    # Every step answers with an outcome, true if it succeeded.
    picked = live.arm.pick("cube")
    hand = live.driver.gripper("hand")
    print(
        f"pick: {picked.code.name}; the hand holds {hand.held} with {hand.force_per_finger:.0f} N per finger"
    )

    live.arm.hold(2.0)
    print(f"held for 2 s, slipped {live.ctx.reports[-1].slip_m * 1000:.3f} mm")

    placed = live.arm.place("cube", on="tray")
    target = placed.evidence["placement"].T_world_object
    end = live.scene().object("cube").T_world_object
    print(f"place: {placed.code.name}; {end.distance_to(target)[0] * 1000:.1f} mm from where it should be")
    live.arm.move_to("home")

    # What was done, stage by stage.
    print("\nstage               planned by       motion   clearance      slip")
    for r in live.ctx.reports:
        clearance = "" if r.clearance_m is None else f"{r.clearance_m * 1000:6.1f} mm"
        slip = "" if r.slip_m is None else f"{r.slip_m * 1000:.3f} mm"
        print(f"{r.name:19s} {r.planner:14s} {r.motion_time_s:6.2f} s {clearance:>11s} {slip:>10s}")
    print("unwanted contacts:", len(live.driver.unwanted_contacts()))

    # A failure is an outcome, too: with its reason, and the arm has not moved.
    beyond = live.arm.move_to(SE3.from_xyz(1.5, 0.0, 0.3))
    print(f"\n1.5 m away: {beyond.code.name}: {beyond.message}")

    # A mistake in the script is an error that lists the names there are.
    try:
        live.arm.pick("cub")
    except InputError as error:
        print("pick('cub'):", error)
