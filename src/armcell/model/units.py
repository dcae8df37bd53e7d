"""Signs of wrong units in a robot description: degrees for radians, millimeters for meters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

DEGREES = 30.0, 720.0  # limits [rad] in this range are more likely degrees
LARGEST_TURN = 2 * np.pi + 0.1  # [rad] a fixed rotation is at most a full turn
LARGEST_LINK = 20.0  # [m] larger meshes of a link, and longer distances between joints, are in millimeters
LONGEST_TRAVEL = 100.0  # [m] longer travels of a linear axis are in millimeters


def limit_faults(joint: str, type: str, lower: float, upper: float) -> Iterator[str]:
    """Yield signs of wrong units, such as degrees, in the limits of a revolute or prismatic joint [rad or
    m].
    """
    most = max(abs(lower), abs(upper))
    if type == "revolute" and DEGREES[0] <= most <= DEGREES[1]:
        yield f"the limits of joint {joint!r}, {lower:g} to {upper:g} rad, look like degrees: use radians"
    if type == "prismatic" and LONGEST_TRAVEL < most < np.inf:
        yield f"the limits of joint {joint!r}, {lower:g} to {upper:g} m, look like millimeters: use meters"
    if lower == upper == 0.0:
        yield f"joint {joint!r} cannot move: lower and upper are both 0; set lower= and upper= of its <limit>"


def origin_faults(owner: str, xyz: Sequence[float], rpy: Sequence[float]) -> Iterator[str]:
    """Yield signs of wrong units, such as millimeters, in a position [m] and a rotation [rad] of a
    description.
    """
    if np.linalg.norm(xyz) > LARGEST_LINK:
        at = " ".join(f"{v:g}" for v in xyz)
        yield f"the origin of {owner}, {at} m, looks like millimeters: use meters"
    if np.abs(rpy).max() > LARGEST_TURN:
        turn = " ".join(f"{v:g}" for v in rpy)
        yield f"the rotation of {owner}, {turn} rad, looks like degrees: use radians"
