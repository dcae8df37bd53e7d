"""Two arms carry one rod in physics: relative pose and squeeze are watched at every tick.

What the hands do to each other is kept small by admittance on the measured force.

python examples/21_carry_together.py
"""

import armcell
from armcell.tasks import checked, moved_object_pose

with armcell.load("dual_ur10_rod").connect("sim", seed=2) as cell:
    rod = cell.carry("rod", left_arm="front_end", right_arm="back_end")
    start = cell.scene().object("rod").T_world_object
    up = moved_object_pose(start, z=0.2)
    turned = moved_object_pose(up, y=-0.05, turn_deg=12)
    checked(rod.grasp(route=[up, turned]))  # postures that can go all the way
    # Both grippers hold now; from here on every tick is watched.
    checked(rod.move(up, name="lift"))
    checked(rod.move(turned, name="move and turn"))
    checked(rod.move(moved_object_pose(start, y=-0.05, z=0.0005, turn_deg=12), name="put down"))
    checked(rod.release())
    checked(cell.move_together(left_arm="home", right_arm="home"))
    seen = rod.record
    slipped = (
        cell.scene()
        .object("rod")
        .T_world_object.distance_to(moved_object_pose(start, y=-0.05, turn_deg=12))[0]
    )

for stage in cell.reports:
    print(f"{stage.started_s:6.2f} s  {stage.name:16} {stage.motion_time_s:.2f} s")
print(f"over {seen.ticks} ticks the hands were at most {1000 * seen.off_m:.2f} mm off each other,")
print(f"squeezed with {seen.squeeze_n:.1f} N, and the rod slipped {1000 * seen.slip_m:.2f} mm")
print(f"it lies {1000 * slipped:.2f} mm from its target pose")
