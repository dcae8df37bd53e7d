"""Two streams of cubes into shared trays: each arm at its own pace, one over a tray at a time."""

from __future__ import annotations

import numpy as np

from armcell.tasks import checked

SLOTS = [(x, y) for y in (0.055, -0.055) for x in (-0.11, 0.0, 0.11)]  # [m] on a tray, from its middle


def task(cell):
    taken = {"red_tray": [], "blue_tray": []}

    def tray_of(cube):
        return "red_tray" if "_red_" in cube else "blue_tray"

    def sort(arm, stream):
        while stream:
            cube = arm.choose(stream, zone=tray_of)  # for the tray that the other arm is not going to
            stream.remove(cube)
            tray = tray_of(cube)
            checked(arm.pick(cube))
            with arm.reserve(tray):
                slot = SLOTS[len(taken[tray])]
                taken[tray].append(cube)
                checked(arm.place(cube, on=tray, at=slot))
        checked(arm.move_to("home"))

    order = np.random.default_rng(cell.seed).permutation
    cubes = [name for name, item in cell.scene().objects.items() if item.movable]
    left, right = ([c for c in order(cubes) if c.startswith(side)] for side in ("left", "right"))
    return cell.side_by_side(left_arm=lambda arm: sort(arm, left), right_arm=lambda arm: sort(arm, right))
