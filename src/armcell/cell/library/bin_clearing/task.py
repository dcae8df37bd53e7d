"""Clear the bin into the tray; two cameras detect the objects."""


def task(cell):
    return cell.clear("bin", into="tray", table="work_table", camera="above_bin", tray_camera="above_tray")
