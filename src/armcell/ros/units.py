"""Numbers that would make sense in another unit: degrees, or millimetres."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from armcell.core import SE3, InputError
from armcell.model import RobotModel

TURN = 2 * np.pi + 0.1  # [rad] beyond which an angle is suspicious
MANY = 5.0  # times its range that a sliding joint is away
FAR = 100.0  # [m] from the robot: no work cell is as big


def unit_fault(model: RobotModel, names: Iterable[str], positions: Sequence[float]) -> str | None:
    """What joint positions look like that fit the limits only in another unit; None where they do not."""
    turning, sliding = [], []
    for name, value in zip(names, positions, strict=True):
        joint = model.joint(name)
        (sliding if joint.type == "prismatic" else turning).append((value, joint.limits))
    if any(abs(v) > TURN and not x.lower <= v <= x.upper for v, x in turning) and all(
        x.lower <= np.deg2rad(v) <= x.upper for v, x in turning
    ):
        return "these look like degrees: ROS has radians"
    if any(abs(v) > MANY * max(abs(x.lower), abs(x.upper)) for v, x in sliding) and all(
        x.lower <= v / 1000 <= x.upper for v, x in sliding
    ):
        return "these look like millimetres: ROS has metres"
    return None


def check_near(T: SE3) -> None:
    """
    Raises:
        InputError: a pose is so far away that its unit must be wrong.
    """
    distance = float(np.linalg.norm(T.translation))
    if distance > FAR:
        raise InputError(f"it is {distance:.4g} m away", cure="in millimetres? ROS has metres")
