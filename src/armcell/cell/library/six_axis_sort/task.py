"""Everything red to the red mat, everything blue to the blue one."""

from __future__ import annotations


def task(cell):
    return cell.sort({"red": "red_mat", "blue": "blue_mat"}, camera="above", by="colour")
