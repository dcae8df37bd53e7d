"""Settings of PTP, LIN and CIRC: Cartesian limits, auxiliary point, smoothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from armcell.core import InputError
from armcell.planning.planners.registry import UnknownParameterError

AUXILIARY = ("interim", "center")
WITHOUT_EFFECT = (
    "max_rot_acc",
    "max_rot_dec",
)  # of older files; MoveIt reads none of them for motions either
FILE_KEY = "cartesian_limits"  # of pilz_cartesian_limits.yaml


@dataclass(frozen=True)
class CartesianLimits:
    """Cartesian limits for LIN and CIRC motions, with the default values of pilz_cartesian_limits.yaml."""

    max_trans_vel: float = 1.0  # [m/s]
    max_trans_acc: float = 2.25  # [m/s^2]
    max_trans_dec: float = 5.0  # [m/s^2] absolute value: files have -5.0
    max_rot_vel: float = 1.57  # [rad/s]

    @property
    def equivalent_radius(self) -> float:
        """Radius [m] at which LIN and CIRC motions convert rotation to path length: the translational speed
        limit [m/s] divided by the rotational one [rad/s].

        With it, a motion reaches both speed limits together.
        """
        return self.max_trans_vel / self.max_rot_vel


@dataclass(frozen=True)
class PilzSettings:
    """Settings of a PTP, LIN or CIRC motion."""

    limits: CartesianLimits = CartesianLimits()
    smoothing: float = 0.032  # [s] window over which steps of the acceleration are spread
    auxiliary: tuple[str, tuple[float, float, float]] | None = (
        None  # CIRC's auxiliary point: kind, world position
    )


def settings_from_request(
    planner_id: str, parameters: Mapping[str, Any], planner_configs: Mapping[str, Any]
) -> tuple[PilzSettings, tuple[str, ...]]:
    """Read the settings of a PTP, LIN or CIRC motion, and list the names of given values that have no effect.

    Args:
        parameters: by name; they override the file's values.
        planner_configs: content of a pilz_cartesian_limits.yaml, or empty.
    Raises:
        UnknownParameterError: no such parameter. InputError: an impossible value.
    """
    if planner_configs and FILE_KEY not in planner_configs:
        raise InputError(
            f"planner_configs of pipeline 'pilz' has no {FILE_KEY!r}",
            hint="give what pilz_cartesian_limits.yaml has, or the limits as parameters",
        )
    in_file = planner_configs.get(FILE_KEY, {})
    if not isinstance(in_file, Mapping):
        raise InputError(f"{FILE_KEY} is {in_file!r}, a mapping is needed")
    limits = {f.name: f.default for f in fields(CartesianLimits)}
    known: dict[str, Any] = {"smoothing": PilzSettings.smoothing}
    if planner_id != "PTP":
        known |= limits
    if planner_id == "CIRC":
        known |= dict.fromkeys(AUXILIARY)
    ignored = [name for name in in_file if name in WITHOUT_EFFECT or (planner_id == "PTP" and name in limits)]
    ignored += [name for name in parameters if name in WITHOUT_EFFECT and planner_id != "PTP"]
    given = {k: v for k, v in {**in_file, **parameters}.items() if k not in ignored}
    for name in given:
        if name not in known:
            raise UnknownParameterError(planner_id, name, known)
    points = {name: given.pop(name) for name in AUXILIARY if given.get(name) is not None}
    values = {k: _positive(planner_id, k, v) for k, v in given.items() if k not in AUXILIARY}
    if len(points) > 1:
        raise InputError("CIRC is given an interim point and a center", hint="give one of them")
    smoothing = values.pop("smoothing", PilzSettings.smoothing)
    auxiliary = next(((name, _point(name, point)) for name, point in points.items()), None)
    settings = PilzSettings(CartesianLimits(**values), smoothing, auxiliary)
    return settings, tuple(sorted(set(ignored)))


def _positive(planner_id: str, name: str, value: Any) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(value)
    if not number:
        raise InputError(f"parameter {name!r} of planner {planner_id!r} is {value!r}, a number is needed")
    if name == "max_trans_dec":
        value = abs(value)  # MoveIt's decelerations are negative
    if value <= 0:
        raise InputError(f"parameter {name!r} of planner {planner_id!r} is {value}, it must be positive")
    return float(value)


def _point(name: str, value: Any) -> tuple[float, float, float]:
    try:
        x, y, z = (float(v) for v in value)
    except (TypeError, ValueError):
        x = y = z = np.nan
    if not np.isfinite([x, y, z]).all():
        raise InputError(f"{name} is {value!r}, three finite numbers [m] in the world frame are needed")
    return x, y, z
