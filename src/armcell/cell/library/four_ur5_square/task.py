"""Four arms fill one tray in their middle, and then each takes the next arm's cube out of the tray."""

from __future__ import annotations

from armcell.tasks import checked

ARMS = ("a_arm", "b_arm", "c_arm", "d_arm")
RADIUS = 0.14  # [m] from the middle of the tray to the row of an arm's cubes
SLOTS = {"1": -0.06, "2": 0.06}  # [m] along that row
OUTWARD = {"a": (1, 0), "b": (0, 1), "c": (-1, 0), "d": (0, -1)}  # from the middle of the tray to an arm


def task(cell):
    streams = {arm: [f"{arm[0]}_cube_{k}" for k in SLOTS] for arm in ARMS}
    orders = cell.orders(lambda cube: "tray", **streams)

    def slot(cube):
        (x, y), t = OUTWARD[cube[0]], SLOTS[cube[-1]]
        return RADIUS * x - t * y, RADIUS * y + t * x

    def work(arm):
        for cube in orders[arm.group]:
            checked(arm.pick(cube))
            with arm.reserve("tray"):  # one arm over the tray at a time, first come, first served
                checked(arm.place(cube, on="tray", at=slot(cube)))
        arm.rendezvous("the tray is full")
        follower = ARMS[(ARMS.index(arm.group) + 1) % len(ARMS)]
        cube = f"{follower[0]}_cube_1"
        with arm.reserve("tray"):
            checked(arm.pick(cube))
        checked(arm.place(cube, on=f"{arm.group[0]}_pad"))
        checked(arm.move_to("home"))

    return cell.side_by_side(**dict.fromkeys(ARMS, work))
