"""Three arms sort cubes into three trays; an arm that cannot reach a cube's tray passes the cube on."""

from __future__ import annotations

from armcell.tasks import checked

NEXT = {"a_arm": "b_arm", "b_arm": "c_arm", "c_arm": "a_arm"}
TRAYS = {"red": ("a_arm", "b_arm"), "green": ("b_arm", "c_arm"), "blue": ("c_arm", "a_arm")}  # who reaches it
SLOT = 0.09  # [m] along a tray between two cubes
MAT_SLOT = 0.23  # of the distance from the middle at which the cube starts


def task(cell):
    start = {name: item.T_world_object for name, item in cell.scene().objects.items()}

    def tray_of(cube):
        return f"{color_of(cube)}_tray"

    def target(cube):
        """Return the support on which one of the three UR5 arms places a cube first: the tray of the cube's
        color, or the mat if the arm on the cube's side cannot reach that tray.
        """
        return tray_of(cube) if owner(cube) in TRAYS[color_of(cube)] else "mat"

    def mat_slot(cube):
        x, y, _ = MAT_SLOT * start[cube].translation
        return x, y

    streams = {arm: [f"{arm[0]}_{color}" for color in TRAYS] for arm in NEXT}
    orders = cell.orders(target, **streams)  # finish early and rarely wait for a zone

    def put_away(arm, cube, slot):
        with arm.reserve(tray_of(cube)):
            checked(arm.place(cube, on=tray_of(cube), at=(0.0, slot)))

    def sort(arm):
        for cube in orders[arm.group]:
            checked(arm.pick(cube))
            if target(cube) == "mat":
                with arm.reserve("mat"):
                    checked(arm.place(cube, on="mat", at=mat_slot(cube)))
            else:
                first = TRAYS[color_of(cube)][0] == arm.group
                put_away(arm, cube, -SLOT if first else SLOT)
        arm.rendezvous("every cube is passed on")
        giver = next(other for other, follower in NEXT.items() if follower == arm.group)
        cube = next(c for c in orders[giver] if target(c) == "mat")
        with arm.reserve("mat"):
            checked(arm.pick(cube))
        put_away(arm, cube, 0.0)
        checked(arm.move_to("home"))

    return cell.side_by_side(**dict.fromkeys(NEXT, sort))


def owner(cube):
    return f"{cube[0]}_arm"


def color_of(cube):
    return cube.split("_")[1]
