"""URScript functions of the emulated controller: arithmetic on numbers, lists, text, poses."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np

from armcell.core import SE3, SO3
from armcell.drivers.ur.wire.kinematics import matrix_of, pose_of
from armcell.emulators.ur.urscript.interpreter import Pose, Vec, copy_value, format_value


def math_functions() -> dict[str, Callable[..., Any]]:
    return _numbers() | _lists_and_text() | _poses()


def _numbers() -> dict[str, Callable[..., Any]]:
    one_argument = (math.sin, math.cos, math.tan, math.asin, math.acos, math.atan, math.sqrt)
    table: dict[str, Callable[..., Any]] = {f.__name__: f for f in one_argument}
    return table | {
        "atan2": math.atan2,
        "pow": math.pow,
        "log": lambda base, value: math.log(value, base),
        "norm": _norm,
        "floor": math.floor,
        "ceil": math.ceil,
        "round": round,
        "d2r": math.radians,
        "r2d": math.degrees,
        "random": random.random,
    }


def _norm(value: Any) -> float:
    return math.sqrt(sum(x * x for x in value)) if isinstance(value, list) else abs(value)


def _lists_and_text() -> dict[str, Callable[..., Any]]:
    return {
        "size": len,
        "length": len,
        "get_list_length": len,
        "make_list": lambda n, value, capacity=0: Vec(copy_value(value) for _ in range(min(int(n), 10_000))),
        "to_num": _number,
        "to_str": format_value,
        "str_cat": lambda a, b: format_value(a) + format_value(b),
        "str_len": len,
        "str_at": lambda text, index: text[int(index)],
        "str_empty": lambda text: not text,
        "str_find": lambda text, part, start=0: text.find(part, int(start)),
        "str_sub": _part,
        "binary_list_to_integer": lambda bits: sum(int(b) << i for i, b in enumerate(bits)),
        "integer_to_binary_list": lambda n: Vec(bool(int(n) >> i & 1) for i in range(32)),
    }


def _number(text: str) -> float:
    return int(text) if str(text).strip().lstrip("+-").isdigit() else float(text)


def _part(text: str, index: int, count: int = -1) -> str:
    return text[int(index) :] if count < 0 else text[int(index) : int(index) + int(count)]


def _poses() -> dict[str, Callable[..., Any]]:
    def of(T: Any) -> Pose:
        return Pose(float(x) for x in pose_of(T))

    def interpolate(a: Any, b: Any, fraction: float) -> Pose:
        start, end = SE3.from_matrix(matrix_of(a)), SE3.from_matrix(matrix_of(b))
        return of(start.interpolate(end, float(fraction)).matrix)

    def point_distance(a: Any, b: Any) -> float:
        return float(np.linalg.norm(np.subtract(a[:3], b[:3])))

    return {
        "pose_trans": lambda a, b: of(matrix_of(a) @ matrix_of(b)),
        "pose_inv": lambda a: of(np.linalg.inv(matrix_of(a))),
        "pose_add": lambda a, b: of(_sum(a, b)),
        "pose_sub": lambda a, b: of(_difference(a, b)),
        "pose_dist": lambda a, b: float(np.linalg.norm(pose_of(_difference(a, b)))),
        "point_dist": point_distance,
        "interpolate_pose": interpolate,
        "rpy2rotvec": lambda rpy, *more: Vec(float(x) for x in _from_rpy(rpy, *more).log()),
        "rotvec2rpy": lambda rotvec, *more: Vec(_rpy(SO3.exp(_three(rotvec, *more)).matrix)),
        "wrench_trans": _wrench_trans,
    }


def _sum(a: Any, b: Any) -> Any:
    """Return the sum of poses a and b, as URScript's built-in math function `pose_add` defines it.

    Translations are added, and a's rotation is multiplied by b's.
    """
    T = matrix_of([*a[:3], *b[3:]])
    T[:3, :3] = matrix_of(a)[:3, :3] @ T[:3, :3]
    T[:3, 3] += np.asarray(b[:3])
    return T


def _difference(a: Any, b: Any) -> Any:
    """Return the difference of poses a and b, as URScript's built-in math function `pose_sub` defines it.

    Translations are subtracted, and the rotation leads from b to a.
    """
    T = np.eye(4)
    T[:3, :3] = matrix_of(a)[:3, :3] @ matrix_of(b)[:3, :3].T
    T[:3, 3] = np.subtract(a[:3], b[:3])
    return T


def _three(first: Any, *more: float) -> list[float]:
    return [float(x) for x in (first if isinstance(first, list) else (first, *more))]


def _from_rpy(first: Any, *more: float) -> SO3:
    roll, pitch, yaw = _three(first, *more)
    return SO3.exp((0, 0, yaw)) @ SO3.exp((0, pitch, 0)) @ SO3.exp((roll, 0, 0))


def _rpy(R: Any) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [rad] of a rotation about the fixed axes x, y and z,
    for URScript's built-in math functions.
    """
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if abs(math.cos(pitch)) < 1e-9:
        return math.atan2(math.copysign(1.0, pitch) * R[0, 1], R[1, 1]), pitch, 0.0
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _wrench_trans(T_from_to: Any, w_from: Any) -> Vec:
    """Implement URScript's built-in function `wrench_trans`: transform a wrench (force, torque) to the axes
    and origin of another frame.
    """
    T = matrix_of(T_from_to)
    force, torque = np.asarray(w_from[:3]), np.asarray(w_from[3:])
    moved = torque + np.cross(-T[:3, 3], force)
    return Vec(float(x) for x in np.concatenate((T[:3, :3].T @ force, T[:3, :3].T @ moved)))
