"""Clear the bin with both arms, each into its own tray; three cameras detect the objects."""


def task(cell):
    return cell.clear(
        "bin",
        into={"left_arm": "left_tray", "right_arm": "right_tray"},
        table="work_table",
        camera="above_bin",
        tray_camera={"left_arm": "above_left_tray", "right_arm": "above_right_tray"},
    )
