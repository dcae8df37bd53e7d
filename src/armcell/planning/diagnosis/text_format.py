"""Text for numbers in explanations of failures.

The functions format offsets, lengths, angles, rotations, joint motions and contacts.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import Contact
from armcell.model import RobotModel


def offset(vector: ArrayLike) -> str:
    """Format a translation (3,) [m] as text for an explanation: "12 mm along +x, 3.0 mm along -z"."""
    v = np.asarray(vector, dtype=float)
    axes = [k for k in range(3) if abs(v[k]) >= max(5e-5, 0.05 * np.abs(v).max())]
    parts = [f"{length(abs(v[k]))} along {'+' if v[k] > 0 else '-'}{'xyz'[k]}" for k in axes]
    return ", ".join(parts) or "0 mm"


def length(meters: float) -> str:
    """Format a length [m] as text for an explanation: "12 mm", "3.0 mm" or "1.20 m"."""
    if meters >= 1.0:
        return f"{meters:.2f} m"
    return f"{meters * 1000:.1f} mm" if meters < 0.01 else f"{meters * 1000:.0f} mm"


def angle(radians: float) -> str:
    """Format an angle [rad] as text in degrees, for an explanation."""
    degrees = np.rad2deg(abs(radians))
    return f"{degrees:.1f} deg" if degrees < 10 else f"{degrees:.0f} deg"


def turn(rotvec: ArrayLike) -> str:
    """Format a rotation vector (3,) [rad] in the tool's frame as text for an explanation: "20 deg about the
    tool's z".
    """
    v = np.asarray(rotvec, dtype=float)
    size = float(np.linalg.norm(v))
    main = int(np.argmax(np.abs(v)))
    if size > 0 and abs(v[main]) > 0.99 * size:
        return f"{angle(size)} about the tool's {'-' if v[main] < 0 else ''}{'xyz'[main]}"
    axis = " ".join(f"{c + 0.0:.2f}" for c in np.round(v / max(size, 1e-12), 2))
    return f"{angle(size)} about the tool's axis ({axis})"


def joint_value(model: RobotModel, name: str, value: float) -> str:
    """Format a joint position, or a difference of positions, as text for an explanation.

    The unit is degrees, or millimeters for a prismatic joint.
    """
    if model.joint(name).type == "prismatic":
        return f"{value * 1000:.1f} mm"
    return f"{np.rad2deg(value):.1f} deg"


def joint_steps(model: RobotModel, names: Iterable[str], difference: ArrayLike, most: int = 4) -> str:
    """Format the largest joint motions as text for an explanation: "panda_joint2 by +4.0 deg, ..."."""
    steps = [(n, float(d)) for n, d in zip(names, np.asarray(difference), strict=True) if abs(d) > 1e-3]
    steps.sort(key=lambda step: -abs(step[1]))
    parts = [f"{n} by {'+' if d > 0 else ''}{joint_value(model, n, d)}" for n, d in steps[:most]]
    rest = f" and {len(steps) - most} more" if len(steps) > most else ""
    return (", ".join(parts) or "nothing") + rest


def contacts(found: Iterable[Contact], most: int = 3) -> str:
    """Format the first few contacts and the number of further contacts as text for an explanation."""
    parts = [c.describe() for c in found]
    return "; ".join(parts[:most]) + (f"; and {len(parts) - most} more" if len(parts) > most else "")
