"""A box is taken from a belt that runs at 0.1 m/s, while it runs.

python examples/18_pick_from_a_belt.py
"""

import armcell

# The cell file gives a fixed object a surface that moves (`belt:`): what lies on it is carried by friction.
conveyor = armcell.load("conveyor_pick")
print("movable:", ", ".join(n for n, o in conveyor.scene().objects.items() if o.movable))

with conveyor.connect("sim", seed=2) as cell:
    # 1. Wait until the first is near enough to be met.
    cell.arm.hold(1.5)

    # 2. Its speed is seen, the meeting planned, the hand moves along, closes and lifts.
    outcome = cell.arm.pick_moving("box_1")
    print("picked:", outcome.ok, outcome.message)
    print(f"it moves at {outcome.evidence.get('speed', 0) * 1000:.0f} mm/s")
    print("in the hand:", cell.driver.gripper("gripper").held)

    # 3. The belt runs on; from here on it is an object like any other.
    placed = cell.arm.place("box_1", on="tray")
    print("placed:", bool(placed), placed.message)

    # What each stage took, in the cell's time.
    for report in cell.reports:
        print(f"  {report.name:16s} {report.motion_time_s:5.2f} s")
    contacts, welds = cell.driver.unwanted_contacts(), cell.driver.welds()
    print("unwanted contacts:", len(contacts), "welds:", len(welds))  # held by friction alone
