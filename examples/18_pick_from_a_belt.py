"""A box is taken from a belt that runs at 0.1 m/s, while it runs.

python examples/18_pick_from_a_belt.py
"""

import armcell

with armcell.load("conveyor_pick").connect("sim", seed=2) as cell:
    cell.arm.hold(1.5)  # until the box is near enough to be met
    outcome = cell.arm.pick_moving("box_1")  # its speed is seen, the meeting planned, the hand moves along
    print("picked:", outcome.ok, outcome.message)
    print(f"it moves at {outcome.evidence.get('speed', 0) * 1000:.0f} mm/s")
    print("in the hand:", cell.driver.gripper("gripper").held)
    print("placed:", bool(cell.arm.place("box_1", on="tray")))
    for report in cell.reports:
        print(f"  {report.name:16s} {report.motion_time_s:5.2f} s")
    print("unwanted contacts:", len(cell.driver.unwanted_contacts()), "welds:", len(cell.driver.welds()))
