"""Take one box after the other from the running belt and put it into the tray."""

from armcell.tasks import checked

NEAR = -0.55  # [m] a box that has come so far can be met


def task(cell):
    for name, at in (("box_1", (-0.08, 0.0)), ("box_2", (0.08, 0.0))):
        while cell.driver.object_poses()[name].translation[1] < NEAR:
            cell.ctx.advance(0.1)
        checked(cell.arm.pick_moving(name))
        checked(cell.arm.place(name, on="tray", at=at))
