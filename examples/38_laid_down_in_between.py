"""Upside down where no single grasp does it: laid on another side in between, and taken otherwise from there.

python examples/38_laid_down_in_between.py
"""

import armcell
from armcell.core import SE3, Box
from armcell.scene import CollisionObject
from armcell.tasks import RecoverySettings

cell = armcell.load("panda_pick")
pose = SE3.from_xyz_rpy((0.50, -0.22, 0.019), (0.0, 0.0, 0.4))
brick = CollisionObject.single("brick", Box(0.10, 0.05, 0.04), pose, movable=True, mass=0.2)
scene = cell.scene().without_object("cube").with_object(brick)
over = {"on": "tray", "up": (0.0, 0.0, -1.0)}  # turn the object upside down

with cell.connect(scene=scene) as live:
    # 1. With one grasp it is refused, and nothing moves:
    # the fingers cannot be under it before, nor beneath it afterwards.
    single = live.arm.transfer("brick", **over, settings=RecoverySettings(tries=1, intermediate_placements=0))
    print("with one grasp:", single.code.name)

    # 2. All that may be needed. Nothing moves before a whole way has been planned.
    outcome = live.arm.transfer("brick", **over)
    print(
        outcome.code.name,
        "intermediate placements on:",
        ", ".join(outcome.evidence["intermediate_placements"]),
    )
    T = live.driver.object_poses()["brick"]
    print(f"its z axis now points {'down' if T.rotation.matrix[2, 2] < -0.999 else 'elsewhere'}")
    print(f"{outcome.evidence['error_m'] * 1000:.1f} mm from where it should lie")

    # 3. Every grasp and every way is in the record of stages, as always.
    print("grasps:", sum(report.name == "close" for report in live.reports))
