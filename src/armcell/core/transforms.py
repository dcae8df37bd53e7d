"""Rigid transforms: rotations `SO3` and poses `SE3` as values.

This module and the wire codecs are the only places that know a quaternion's component order.
`T_a_b` maps coordinates in frame b to frame a, so `T_a_b @ T_b_c == T_a_c`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import float_array
from armcell.core.errors import InputError

Array = NDArray[np.float64]

_IDENTITY = np.eye(3)
_ORTHOGONAL = 1e-4 + 1e-5 * _IDENTITY
"""Largest deviation of R @ R.T from the identity that counts as rounding."""

_ROWS = 1 << 14
"""Number of points that one matrix product transforms. OpenBLAS distributes larger products (more than 2^18
multiplications) among threads, whose spinning costs up to 0.1 s if the processor's cores are busy."""

QUAT_NORM_TOLERANCE = 1e-3
"""Largest deviation of a quaternion's norm from 1 that counts as rounding, not as a mistake."""


def skew(v: ArrayLike) -> Array:
    """Return the skew-symmetric matrix (3, 3) of a vector, from which rotations are computed: `skew(v) @ w ==
    cross(v, w)`.
    """
    x, y, z = np.asarray(v, dtype=float)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _length(v: Array) -> float:
    """Return the Euclidean length of a vector (n,) for computing
    transforms; this is three times as fast as `np.linalg.norm`.

    Both results have the same bits.
    """
    return math.sqrt(v.dot(v))


def _finite(values: ArrayLike, count: int, what: str) -> Array:
    return float_array(values, (count,), what)


@dataclass(frozen=True, eq=False)
class SO3:
    """Rotation in three dimensions (SO3), stored as a 3x3 matrix."""

    matrix: Array  # (3, 3)

    def __post_init__(self) -> None:
        m = self.matrix if isinstance(self.matrix, np.ndarray) else np.array(self.matrix, dtype=object)
        if m.shape == (3, 3):
            (a, b, c), (d, e, f), (g, h, i) = m.tolist()
            if math.isfinite(a + b + c + d + e + f + g + h + i):  # half the time of sum(), a third of np.sum
                return
        raise InputError(f"a rotation needs a finite (3, 3) matrix, not {m!r}")

    @staticmethod
    def identity() -> SO3:
        return SO3(np.eye(3))

    @staticmethod
    def from_quat_wxyz(quat_wxyz: ArrayLike) -> SO3:
        """Create a rotation (SO3) from a unit quaternion in the order w, x, y, z (scalar first).

        Raises:
            InputError: not four finite numbers, or a norm further from 1 than `QUAT_NORM_TOLERANCE`.
        """
        q = _finite(quat_wxyz, 4, "a quaternion")
        norm = math.sqrt(q.dot(q))
        if abs(norm - 1.0) > QUAT_NORM_TOLERANCE:
            raise InputError(
                f"quaternion has norm {norm:.4g}, a rotation needs norm 1", hint="divide it by its norm"
            )
        w, x, y, z = (q / norm).tolist()  # Python's floats: a third of the time
        return SO3(
            np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
                ]
            )
        )

    @staticmethod
    def from_quat_xyzw(quat_xyzw: ArrayLike) -> SO3:
        """Create a rotation (SO3) from a unit quaternion in the order x, y, z, w (scalar last, as in ROS,
        SciPy and Unity).
        """
        x, y, z, w = _finite(quat_xyzw, 4, "a quaternion").tolist()
        return SO3.from_quat_wxyz(np.array((w, x, y, z)))

    @staticmethod
    def from_rpy(rpy: ArrayLike) -> SO3:
        """Create a rotation (SO3) from roll, pitch and yaw angles [rad]: `Rz(yaw) @ Ry(pitch) @ Rx(roll)`, as
        in URDF.
        """
        r, p, y = _finite(rpy, 3, "roll-pitch-yaw")
        cr, sr, cp, sp, cy, sy = np.cos(r), np.sin(r), np.cos(p), np.sin(p), np.cos(y), np.sin(y)
        return SO3(
            np.array(
                [
                    [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                    [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                    [-sp, cp * sr, cp * cr],
                ]
            )
        )

    @staticmethod
    def exp(rotvec: ArrayLike) -> SO3:
        """Create a rotation (SO3) from a rotation vector (3,) [rad] by Rodrigues' formula."""
        v = _finite(rotvec, 3, "a rotation vector")
        angle = float(np.linalg.norm(v))
        K = skew(v)
        if angle < 1e-8:
            return SO3(np.eye(3) + K + 0.5 * K @ K)
        return SO3(np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * K @ K)

    @staticmethod
    def between(a: ArrayLike, b: ArrayLike) -> SO3:
        """Return the smallest rotation (SO3) that turns direction `a` into direction `b`."""
        u, v = _finite(a, 3, "a direction"), _finite(b, 3, "a direction")
        if not (u.any() and v.any()):
            raise InputError("a direction must not be zero")
        u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
        axis, cosine = np.cross(u, v), float(np.clip(u @ v, -1, 1))
        sine = float(np.linalg.norm(axis))
        if sine < 1e-12:
            if cosine > 0:
                return SO3.identity()
            other = np.eye(3)[int(np.argmin(np.abs(u)))]
            axis = np.cross(u, other)
            return SO3.exp(np.pi * axis / np.linalg.norm(axis))
        return SO3.exp(np.arctan2(sine, cosine) * axis / sine)

    @property
    def quat_wxyz(self) -> Array:
        """Return a rotation (SO3) as a unit quaternion w, x, y, z with w >= 0, computed by Shepperd's
        method.
        """
        (a, b, c), (d, e, f), (g, h, i) = self.matrix.tolist()  # Python's floats: a fifth of numpy's time
        trace = a + e + i
        largest = max(trace, a, e, i)
        if largest == trace:
            four = 1 + trace, h - f, c - g, d - b
        elif largest == a:
            four = h - f, 1 + 2 * a - trace, b + d, c + g
        elif largest == e:
            four = c - g, b + d, 1 + 2 * e - trace, f + h
        else:
            four = d - b, c + g, f + h, 1 + 2 * i - trace
        q = np.array(four, dtype=float)
        q /= _length(q)
        return -q if q[0] < 0 else q

    @property
    def quat_xyzw(self) -> Array:
        """Return a rotation (SO3) as a unit quaternion x, y, z, w with w >= 0."""
        return np.roll(self.quat_wxyz, -1)

    @property
    def rpy(self) -> Array:
        """Return a rotation (SO3) as roll, pitch and yaw angles [rad]. If the pitch makes them ambiguous,
        roll is 0.
        """
        m = self.matrix
        pitch = np.arctan2(-m[2, 0], np.hypot(m[0, 0], m[1, 0]))
        if abs(np.cos(pitch)) < 1e-9:
            return np.array([0.0, pitch, np.arctan2(-m[0, 1], m[1, 1])])
        return np.array([np.arctan2(m[2, 1], m[2, 2]), pitch, np.arctan2(m[1, 0], m[0, 0])])

    def log(self) -> Array:
        """Return a rotation (SO3) as a rotation vector (3,) [rad], whose length is at most pi."""
        q = self.quat_wxyz
        v = q[1:].copy()
        n = _length(v)
        if n < 1e-12:
            return 2.0 * v
        return 2.0 * np.arctan2(n, q[0]) / n * v

    def inverse(self) -> SO3:
        return SO3(self.matrix.T)

    def __matmul__(self, other: SO3) -> SO3:
        return SO3(self.matrix @ other.matrix)


@dataclass(frozen=True, eq=False)
class SE3:
    """Rigid transform between two frames (SE3): a rotation and a translation [m]."""

    rotation: SO3
    translation: Array  # (3,)
    WRITTEN_AS: ClassVar[str] = "SE3.from_xyz(0.4, 0.0, 0.2)"

    def __post_init__(self) -> None:
        t = self.translation
        t = t if isinstance(t, np.ndarray) else np.array(t, dtype=object)
        if t.shape == (3,):
            x, y, z = t.tolist()
            if math.isfinite(x + y + z):
                return
        raise InputError(f"a pose needs three finite numbers [m] as its translation, not {t!r}")

    @staticmethod
    def identity() -> SE3:
        return SE3(SO3.identity(), np.zeros(3))

    @staticmethod
    def from_xyz(x: float, y: float, z: float) -> SE3:
        return SE3(SO3.identity(), _finite((x, y, z), 3, "a position"))

    @staticmethod
    def from_xyz_rpy(xyz: ArrayLike, rpy: ArrayLike = (0.0, 0.0, 0.0)) -> SE3:
        """Create a rigid transform (SE3) from a position [m] and roll, pitch, yaw angles [rad], as in URDF's
        `<origin>`.
        """
        return SE3(SO3.from_rpy(rpy), _finite(xyz, 3, "a position"))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> SE3:
        """Create a rigid transform (SE3) from a 4x4 homogeneous matrix."""
        m = float_array(matrix, (4, 4), "a homogeneous transform")
        R = m[:3, :3]
        if not (np.abs(R @ R.T - _IDENTITY) <= _ORTHOGONAL).all() or np.linalg.det(R) < 0:
            raise InputError("the upper left of a homogeneous transform is no rotation")
        return SE3(SO3(m[:3, :3].copy()), m[:3, 3].copy())

    @staticmethod
    def from_quat_wxyz(xyz: ArrayLike, quat_wxyz: ArrayLike) -> SE3:
        return SE3(SO3.from_quat_wxyz(quat_wxyz), _finite(xyz, 3, "a position"))

    @staticmethod
    def from_quat_xyzw(xyz: ArrayLike, quat_xyzw: ArrayLike) -> SE3:
        return SE3(SO3.from_quat_xyzw(quat_xyzw), _finite(xyz, 3, "a position"))

    @staticmethod
    def from_mapping(value: object, what: str = "pose") -> SE3:
        """Create a rigid transform (SE3) from a pose that is written as a list, or as a mapping with position
        and rotation.

        The forms are `[x, y, z]`, `[x, y, z, roll, pitch, yaw]` and `{xyz: [...], rpy: [...]}` / `{xyz,
        rpy_deg}` / `{xyz, quat_xyzw}`.

        Raises:
            InputError: any other form; the message names `what`.
        """
        try:
            if isinstance(value, Sequence) and not isinstance(value, str):
                if len(value) == 3:
                    return SE3.from_xyz_rpy(value)
                if len(value) == 6:
                    return SE3.from_xyz_rpy(value[:3], value[3:])
            elif isinstance(value, dict):
                unknown = set(value) - {"xyz", "rpy", "rpy_deg", "quat_xyzw"}
                if not unknown and len(value) <= 2:
                    xyz = value.get("xyz", (0.0, 0.0, 0.0))
                    if "quat_xyzw" in value:
                        return SE3.from_quat_xyzw(xyz, value["quat_xyzw"])
                    rpy = value.get("rpy", np.deg2rad(value.get("rpy_deg", (0.0, 0.0, 0.0))))
                    return SE3.from_xyz_rpy(xyz, rpy)
        except (TypeError, ValueError) as error:
            raise InputError(f"{what}: {error}") from error
        except InputError as error:
            raise InputError(f"{what}: {error}") from error
        raise InputError(
            f"{what}: {value!r} is not a pose",
            hint="write [x, y, z], [x, y, z, roll, pitch, yaw] or {xyz: [...], rpy_deg: [...]}",
        )

    @property
    def matrix(self) -> Array:
        m = np.eye(4)
        m[:3, :3] = self.rotation.matrix
        m[:3, 3] = self.translation
        return m

    @property
    def quat_wxyz(self) -> Array:
        return self.rotation.quat_wxyz

    @property
    def quat_xyzw(self) -> Array:
        return self.rotation.quat_xyzw

    def inverse(self) -> SE3:
        R = self.rotation.matrix.T
        return SE3(SO3(R), -R @ self.translation)

    def __matmul__(self, other: SE3) -> SE3:
        R = self.rotation.matrix
        return SE3(SO3(R @ other.rotation.matrix), R @ other.translation + self.translation)

    def apply(self, points: ArrayLike) -> Array:
        """Transform points (..., 3) from the child frame to the parent frame of a rigid transform (SE3)."""
        p = points if isinstance(points, np.ndarray) else float_array(points, None, "points", finite=False)
        if p.shape[-1:] != (3,):
            raise InputError(f"points must have shape (..., 3), not {p.shape}")
        R = self.rotation.matrix
        if p.ndim != 2 or len(p) <= _ROWS:
            return p @ R.T + self.translation
        moved = np.empty(p.shape)
        for first in range(0, len(p), _ROWS):
            rows = np.matmul(p[first : first + _ROWS], R.T, out=moved[first : first + _ROWS])
            rows += self.translation
        return moved

    def shifted(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> SE3:
        """Return a pose (SE3) that is translated by x, y, z [m] along the axes of its parent frame."""
        return SE3(self.rotation, self.translation + _finite((x, y, z), 3, "a shift"))

    def distance_to(self, other: SE3) -> tuple[float, float]:
        """Return the distance between the positions of two poses (SE3) [m] and the angle between their
        orientations [rad].
        """
        angle = _length((self.rotation.inverse() @ other.rotation).log())
        return _length(self.translation - other.translation), angle

    def isclose(self, other: SE3, position: float = 1e-9, rotation: float = 1e-9) -> bool:
        meters, radians = self.distance_to(other)
        return meters <= position and radians <= rotation

    def interpolate(self, other: SE3, fraction: float) -> SE3:
        """Interpolate between two poses (SE3): the position changes linearly, the orientation with constant
        angular velocity.
        """
        return self.interpolated(other, [fraction])[0]

    def interpolated(self, other: SE3, fractions: Iterable[float]) -> list[SE3]:
        """Interpolate between two poses (SE3) at many fractions of the motion in one call,
        which is faster than one call per fraction.
        """
        fractions = float_array(list(fractions), (None,), "fractions")
        f = fractions[:, None]
        positions = (1 - f) * self.translation + f * other.translation
        rotvec = (self.rotation.inverse() @ other.rotation).log()
        angle = float(np.linalg.norm(rotvec))
        if angle < 1e-12:  # less is rounding
            return [SE3(self.rotation, position) for position in positions]
        K, turned = skew(rotvec / angle), fractions[:, None, None] * angle  # Rodrigues' formula, as in `exp`
        matrices = self.rotation.matrix @ (np.eye(3) + np.sin(turned) * K + (1 - np.cos(turned)) * (K @ K))
        return [SE3(SO3(R), position) for R, position in zip(matrices, positions, strict=True)]

    def __repr__(self) -> str:
        xyz = ", ".join(f"{v:.4f}" for v in self.translation)
        rpy = ", ".join(f"{v:.1f}" for v in np.rad2deg(self.rotation.rpy))
        return f"SE3(xyz=[{xyz}] m, rpy=[{rpy}] deg)"
