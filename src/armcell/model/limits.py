"""Joint limits from joint_limits.yaml, which tighten the URDF's limits or add missing ones.

URDF has no acceleration and jerk limits. The file has MoveIt's format (`joint_limits: {joint:
{has_velocity_limits, max_velocity, ...}}`) with the additional keys `max_jerk`, `min_position` and
`max_position`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.model.robot import RobotModel
from armcell.model.untrusted_files import read_yaml

_FIELDS = {
    "max_velocity": "velocity",
    "max_acceleration": "acceleration",
    "max_jerk": "jerk",
    "max_effort": "effort",
    "min_position": "lower",
    "max_position": "upper",
}
_SWITCHES = {
    "has_velocity_limits": "max_velocity",
    "has_acceleration_limits": "max_acceleration",
    "has_jerk_limits": "max_jerk",
    "has_effort_limits": "max_effort",
    "has_position_limits": None,
    "has_deceleration_limits": None,
    "max_deceleration": None,
}


def with_joint_limits(model: RobotModel, path: Path) -> RobotModel:
    """Return the robot with joint limits from a file joint_limits.yaml.
    The file can only tighten existing limits.

    Raises:
        InputError: wrong type, or a limit wider than the URDF's.
        UnknownNameError: the robot has no such joint, or the key is unknown.
    """
    data = read_yaml(path).get("joint_limits")
    if not isinstance(data, dict):
        raise InputError("has no mapping 'joint_limits'", file=path)
    joints = dict(model.joints)
    for name, entry in data.items():
        if name not in joints:
            raise UnknownNameError("joint", name, joints, file=path)
        joints[name] = replace(joints[name], limits=_tightened(joints[name].limits, name, entry, path))
    return replace(model, joints=joints)


def _tightened(limits: Any, name: str, entry: Any, path: Path):
    where = {"file": path, "element": f"joint_limits/{name}"}
    if not isinstance(entry, dict):
        raise InputError("is not a mapping", **where)
    off = {_SWITCHES[k] for k, v in entry.items() if k in _SWITCHES and v is False}
    for key, value in entry.items():
        if key in _SWITCHES:
            continue
        if key not in _FIELDS:
            raise UnknownNameError("key", key, [*_FIELDS, *_SWITCHES], **where)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"{key} is {value!r}, a number is needed", **where)
        if not math.isfinite(value):
            raise InputError(f"{key} is {value}, a finite number is needed", **where)
        if key in off:
            continue
        attribute = _FIELDS[key]
        old = getattr(limits, attribute)
        if attribute not in ("lower", "upper") and value <= 0:
            raise InputError(f"{key} is {value:g}, it must be positive", **where)
        slack = 1e-6 * abs(old) + 1e-9 if math.isfinite(old) else 0.0
        if value < old - slack if attribute == "lower" else value > old + slack:
            raise InputError(
                f"{key} {value:g} is wider than the robot's own {old:g}",
                **where,
                hint="limits may only be tightened",
            )
        limits = replace(limits, **{attribute: float(value)})
    if limits.lower > limits.upper:
        raise InputError(f"min_position {limits.lower:g} is above max_position {limits.upper:g}", **where)
    return limits
