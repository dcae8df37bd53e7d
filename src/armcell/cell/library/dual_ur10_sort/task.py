"""Two arms sort cubes into shared trays at their own pace, one arm per tray at a time."""

from __future__ import annotations

import numpy as np

from armcell.tasks import checked

COLUMNS = (-0.11, 0.0, 0.11)  # [m] along a tray, from its center
ROWS = {"left_arm": 0.08, "right_arm": -0.08}  # [m] across a tray: each arm fills the row on its side


def task(cell):
    objects = cell.scene().objects
    x = {name: item.T_world_object.translation[0] for name, item in objects.items()}
    cubes = [name for name, item in objects.items() if item.movable]
    cubes = np.random.default_rng(cell.seed).permutation(cubes).tolist()  # random arrival order

    def tray_of(cube):
        return "red_tray" if "_red_" in cube else "blue_tray"

    streams = {arm: [c for c in cubes if c.startswith(arm.removesuffix("_arm"))] for arm in ROWS}
    orders = cell.orders(tray_of, **streams)  # finish early and rarely wait for a tray

    def sort(arm):
        free = {tray: set(COLUMNS) for tray in ("red_tray", "blue_tray")}
        for cube in orders[arm.group]:
            tray = tray_of(cube)
            checked(arm.pick(cube))
            column = min(free[tray], key=lambda c: abs(x[tray] + c - x[cube]))  # the nearest free column
            free[tray].remove(column)
            with arm.reserve(tray):
                checked(arm.place(cube, on=tray, at=(column, ROWS[arm.group])))
        checked(arm.move_to("home"))

    return cell.side_by_side(left_arm=sort, right_arm=sort)
