"""Empty the bin into the tray, from what two cameras see."""


def task(cell):
    return cell.clear("bin", into="tray", table="work_table", camera="above_bin", tray_camera="above_tray")
