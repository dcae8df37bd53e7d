"""Shim of tf.transformations: rotations and transforms as quaternions and matrices.

Quaternions are (x, y, z, w), matrices 4 x 4, and Euler axes are named like "sxyz". Names and conventions:
transformations.py by Christoph Gohlke, which tf contains. This is an independent implementation; Euler axes
and their order follow K. Shoemake, "Euler angle conversion", Graphics Gems IV, 1994.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
EPS = 1e-12

_FIRST = {"x": 0, "y": 1, "z": 2}
_AXES = ["xyz", "xyx", "xzy", "xzx", "yzx", "yzy", "yxz", "yxy", "zxy", "zxz", "zyx", "zyz"]


def _axes(axes: str | Sequence[int]) -> tuple[list[int], bool]:
    """Convert an Euler axis sequence of tf.transformations, such as "sxyz" or "rzyx", to the equivalent order
    of rotations about fixed axes.

    Returns:
        The axes (0 to 2) in order, and whether the name describes a rotating frame.
    """
    if not isinstance(axes, str):
        first, parity, repetition, frame = axes
        i, j, k = first, (first + 1 + parity) % 3, (first + 2 - parity) % 3
        order = [i, j, i if repetition else k]
        return (order[::-1] if frame else order), bool(frame)
    if len(axes) != 4 or axes[0] not in "sr" or axes[1:] not in _AXES:
        raise KeyError(axes)
    order = [_FIRST[c] for c in axes[1:]]
    return (order if axes[0] == "s" else order[::-1]), axes[0] == "r"


def _about(axis: int, angle: float) -> Array:
    """Return the (3, 3) matrix of a rotation about the x, y or z axis, for the shim of tf.transformations."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    M = np.eye(3)
    M[i, i] = M[j, j] = c
    M[i, j], M[j, i] = -s, s
    return M


def _square(R: Array) -> Array:
    M = np.eye(4)
    M[:3, :3] = R
    return M


# --- Euler angles ---
def euler_matrix(ai: float, aj: float, ak: float, axes: Any = "sxyz") -> Array:
    order, turning = _axes(axes)
    angles = [ak, aj, ai] if turning else [ai, aj, ak]
    R = np.eye(3)
    for axis, angle in zip(order, angles):
        R = _about(axis, angle) @ R
    return _square(R)


def euler_from_matrix(matrix: ArrayLike, axes: Any = "sxyz") -> tuple[float, float, float]:
    order, turning = _axes(axes)
    R = np.asarray(matrix, dtype=float)[:3, :3]
    i, j, k = order
    if i == k:  # repeated axis, such as x y x
        third = 3 - i - j
        sign = 1.0 if (j - i) % 3 == 1 else -1.0
        sy = np.hypot(R[i, j], R[i, third])
        if sy > EPS:
            a = np.arctan2(R[i, j], sign * R[i, third])
            b = np.arctan2(sy, R[i, i])
            c = np.arctan2(R[j, i], -sign * R[third, i])
        else:
            a = np.arctan2(-sign * R[j, third], R[j, j])
            b = np.arctan2(sy, R[i, i])
            c = 0.0
    else:
        sign = 1.0 if (j - i) % 3 == 1 else -1.0
        cy = np.hypot(R[i, i], R[j, i])
        if cy > EPS:
            a = np.arctan2(sign * R[k, j], R[k, k])
            b = np.arctan2(-sign * R[k, i], cy)
            c = np.arctan2(sign * R[j, i], R[i, i])
        else:
            a = np.arctan2(-sign * R[j, k], R[j, j])
            b = np.arctan2(-sign * R[k, i], cy)
            c = 0.0
    found = (float(a), float(b), float(c))
    return (found[2], found[1], found[0]) if turning else found


def euler_from_quaternion(quaternion: ArrayLike, axes: Any = "sxyz") -> tuple[float, float, float]:
    return euler_from_matrix(quaternion_matrix(quaternion), axes)


def quaternion_from_euler(ai: float, aj: float, ak: float, axes: Any = "sxyz") -> Array:
    order, turning = _axes(axes)
    angles = [ak, aj, ai] if turning else [ai, aj, ak]
    q = np.array([0.0, 0.0, 0.0, 1.0])
    for axis, angle in zip(order, angles):
        q = quaternion_multiply(quaternion_about_axis(angle, np.eye(3)[axis]), q)
    return q


# --- quaternions ---
def quaternion_about_axis(angle: float, axis: ArrayLike) -> Array:
    v = np.asarray(axis, dtype=float)[:3]
    length = float(np.linalg.norm(v))
    if length > EPS:
        v = v * np.sin(angle / 2.0) / length
    return np.array([*v, np.cos(angle / 2.0)])


def quaternion_matrix(quaternion: ArrayLike) -> Array:
    q = np.array(quaternion, dtype=float)[:4]
    n = float(q @ q)
    if n < EPS:
        return np.eye(4)
    x, y, z, w = q
    s = 2.0 / n
    R = np.array([
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ])  # fmt: skip
    return _square(R)


def quaternion_from_matrix(matrix: ArrayLike) -> Array:
    R = np.asarray(matrix, dtype=float)[:3, :3]
    trace = float(np.trace(R))
    if trace > 0:
        w = np.sqrt(trace + 1.0) / 2
        v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4 * w)
        return np.array([*v, w])
    i = int(np.argmax(np.diag(R)))
    j, k = (i + 1) % 3, (i + 2) % 3
    q = np.empty(4)
    q[i] = np.sqrt(max(1.0 + R[i, i] - R[j, j] - R[k, k], 0.0)) / 2
    q[j] = (R[j, i] + R[i, j]) / (4 * q[i])
    q[k] = (R[k, i] + R[i, k]) / (4 * q[i])
    q[3] = (R[k, j] - R[j, k]) / (4 * q[i])
    return q


def quaternion_multiply(quaternion1: ArrayLike, quaternion0: ArrayLike) -> Array:
    x1, y1, z1, w1 = np.asarray(quaternion1, dtype=float)
    x0, y0, z0, w0 = np.asarray(quaternion0, dtype=float)
    return np.array([
        x1 * w0 + y1 * z0 - z1 * y0 + w1 * x0,
        -x1 * z0 + y1 * w0 + z1 * x0 + w1 * y0,
        x1 * y0 - y1 * x0 + z1 * w0 + w1 * z0,
        -x1 * x0 - y1 * y0 - z1 * z0 + w1 * w0,
    ])  # fmt: skip


def quaternion_conjugate(quaternion: ArrayLike) -> Array:
    x, y, z, w = np.asarray(quaternion, dtype=float)
    return np.array([-x, -y, -z, w])


def quaternion_inverse(quaternion: ArrayLike) -> Array:
    return quaternion_conjugate(quaternion) / float(np.dot(quaternion, quaternion))


def quaternion_slerp(
    quat0: ArrayLike, quat1: ArrayLike, fraction: float, spin: int = 0, shortestpath: bool = True
) -> Array:
    q0, q1 = unit_vector(np.asarray(quat0)[:4]), unit_vector(np.asarray(quat1)[:4])
    if fraction in (0.0, 1.0):
        return q0 if fraction == 0.0 else q1
    d = float(q0 @ q1)
    if abs(abs(d) - 1.0) < EPS:
        return q0
    if shortestpath and d < 0.0:
        d, q1 = -d, -q1
    angle = np.arccos(d) + spin * np.pi
    if abs(angle) < EPS:
        return q0
    return (np.sin((1.0 - fraction) * angle) * q0 + np.sin(fraction * angle) * q1) / np.sin(angle)


def random_quaternion(rand: ArrayLike | None = None) -> Array:
    r = np.random.default_rng().random(3) if rand is None else np.asarray(rand, dtype=float)
    a, b = np.sqrt(1.0 - r[0]), np.sqrt(r[0])
    t1, t2 = 2 * np.pi * r[1], 2 * np.pi * r[2]
    return np.array([np.sin(t1) * a, np.cos(t1) * a, np.sin(t2) * b, np.cos(t2) * b])


# --- matrices ---
def identity_matrix() -> Array:
    return np.eye(4)


def translation_matrix(direction: ArrayLike) -> Array:
    M = np.eye(4)
    M[:3, 3] = np.asarray(direction, dtype=float)[:3]
    return M


def translation_from_matrix(matrix: ArrayLike) -> Array:
    return np.array(np.asarray(matrix, dtype=float)[:3, 3])


def rotation_matrix(angle: float, direction: ArrayLike, point: ArrayLike | None = None) -> Array:
    M = quaternion_matrix(quaternion_about_axis(angle, direction))
    if point is not None:
        p = np.asarray(point, dtype=float)[:3]
        M[:3, 3] = p - M[:3, :3] @ p
    return M


def rotation_from_matrix(matrix: ArrayLike) -> tuple[float, Array, Array]:
    """Return the angle [rad], the axis direction (3,) and a point (4,) on the axis (homogeneous coordinates)
    of the rotation in a 4x4 matrix. Equivalent of the tf.transformations function.
    """
    M = np.asarray(matrix, dtype=float)
    q = quaternion_from_matrix(M)
    length = float(np.linalg.norm(q[:3]))
    direction = q[:3] / length if length > EPS else np.array([0.0, 0.0, 1.0])
    point = np.linalg.lstsq(np.eye(3) - M[:3, :3], M[:3, 3], rcond=None)[0]
    return float(2 * np.arctan2(length, q[3])), direction, np.array([*point, 1.0])


def concatenate_matrices(*matrices: ArrayLike) -> Array:
    M = np.eye(4)
    for each in matrices:
        M = M @ np.asarray(each, dtype=float)
    return M


def inverse_matrix(matrix: ArrayLike) -> Array:
    return np.linalg.inv(np.asarray(matrix, dtype=float))


def scale_matrix(factor: float, origin: ArrayLike | None = None, direction: ArrayLike | None = None) -> Array:
    M = np.eye(4)
    if direction is None:
        M[:3, :3] *= factor
        if origin is not None:
            M[:3, 3] = np.asarray(origin, dtype=float)[:3] * (1.0 - factor)
        return M
    d = unit_vector(np.asarray(direction, dtype=float)[:3])
    M[:3, :3] -= (1.0 - factor) * np.outer(d, d)
    if origin is not None:
        M[:3, 3] = (1.0 - factor) * float(np.dot(np.asarray(origin)[:3], d)) * d
    return M


def compose_matrix(
    scale: ArrayLike | None = None, shear: ArrayLike | None = None, angles: ArrayLike | None = None,
    translate: ArrayLike | None = None, perspective: ArrayLike | None = None,
) -> Array:  # fmt: skip
    M = np.eye(4)
    if perspective is not None:
        P = np.eye(4)
        P[3] = np.asarray(perspective, dtype=float)[:4]
        M = M @ P
    if translate is not None:
        M = M @ translation_matrix(translate)
    if angles is not None:
        a, b, c = np.asarray(angles, dtype=float)
        M = M @ euler_matrix(a, b, c, "sxyz")
    if shear is not None:
        Z = np.eye(4)
        Z[0, 1], Z[0, 2], Z[1, 2] = np.asarray(shear, dtype=float)
        M = M @ Z
    if scale is not None:
        M = M @ np.diag([*np.asarray(scale, dtype=float), 1.0])
    return M / M[3, 3]


def is_same_transform(matrix0: ArrayLike, matrix1: ArrayLike) -> bool:
    a, b = np.array(matrix0, dtype=float), np.array(matrix1, dtype=float)
    return bool(np.allclose(a / a[3, 3], b / b[3, 3]))


# --- vectors ---
def vector_norm(data: ArrayLike, axis: int | None = None, out: Any = None) -> Any:
    found = np.linalg.norm(np.asarray(data, dtype=float), axis=axis)
    if out is not None:
        out[:] = found
        return None
    return float(found) if axis is None else found


def unit_vector(data: ArrayLike, axis: int | None = None, out: Any = None) -> Any:
    v = np.array(data, dtype=float)
    length = np.linalg.norm(v, axis=axis, keepdims=axis is not None)
    v = v / length
    if out is not None:
        out[:] = v
        return None
    return v


def random_vector(size: int) -> Array:
    return np.random.default_rng().random(size)


def random_rotation_matrix(rand: ArrayLike | None = None) -> Array:
    return quaternion_matrix(random_quaternion(rand))
