"""Detection of numbers in the wrong unit: degrees for radians, or millimeters for meters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from armcell.core import SE3, InputError
from armcell.model import RobotModel

TURN = 2 * np.pi + 0.1  # [rad] a larger angle is suspicious
MANY = 5.0  # a prismatic joint's value beyond this multiple of its limit is suspicious
FAR = 100.0  # [m] maximum distance from the origin: no work cell is larger


def unit_fault(model: RobotModel, names: Iterable[str], positions: Sequence[float]) -> str | None:
    """Return a hint about wrong units if joint positions exceed the
    limits but would be valid as degrees or millimeters.

    Args:
        model: the robot, for joint types and limits.
        names: joint names, in the order of `positions`.
        positions: one value for each joint [rad or m].
    """
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
        return "these look like millimeters: ROS has meters"
    return None


def check_in_meters(T: SE3) -> None:
    """Check that a pose is in meters. A pose more than 100 m from the origin is probably in millimeters.

    Raises:
        InputError: the translation is longer than 100 m.
    """
    distance = float(np.linalg.norm(T.translation))
    if distance > FAR:
        raise InputError(f"it is {distance:.4g} m away", hint="in millimeters? ROS has meters")
