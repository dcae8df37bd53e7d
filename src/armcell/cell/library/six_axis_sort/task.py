"""Sort red objects onto the red mat and blue objects onto the blue mat."""

from __future__ import annotations


def task(cell):
    return cell.sort({"red": "red_mat", "blue": "blue_mat"}, camera="above", by="color")
