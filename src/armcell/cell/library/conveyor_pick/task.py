"""Pick boxes one after the other from a moving conveyor belt and place them in the tray."""

from armcell.tasks import checked

NEAR = -0.55  # [m] y position from which the arm can reach a box


def task(cell):
    for name, at in (("box_1", (-0.08, 0.0)), ("box_2", (0.08, 0.0))):
        while cell.driver.object_poses()[name].translation[1] < NEAR:
            cell.ctx.advance(0.1)
        checked(cell.arm.pick_moving(name))
        checked(cell.arm.place(name, on="tray", at=at))
