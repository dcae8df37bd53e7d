"""Hand-eye calibration from views of a marker in several robot poses.

Eye in hand: the camera is on the hand, the marker is stationary. Eye to hand: the camera is stationary, the
marker is on the hand. A closed-form solution (Park and Martin, IEEE Transactions on Robotics and Automation
10(5), 1994) is refined by least squares over both unknown poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, ErrorCode, InputError, Outcome

F64 = NDArray[np.float64]

IN_HAND, TO_HAND = "in_hand", "to_hand"
LEAST_POSES = 4
LEAST_TURN = np.deg2rad(15.0)  # [rad] minimum rotation between some pair of poses
LEAST_SPREAD = 0.1  # minimum spread of the rotation axes: 0 parallel, 1/3 isotropic
HALF_TURN = np.deg2rad(165.0)  # [rad] beyond it, noise determines the sign of the rotation axis
LEVER = 0.3  # [m] weight of a rotation error of 1 rad


@dataclass(frozen=True, repr=False)
class HandEye(Outcome):
    """Result of a hand-eye calibration: the camera pose T_hand_camera
    (eye in hand) or T_base_camera (eye to hand).

    Residuals are the deviations of each view's marker pose from the mean of all views.
    """

    mount: str = IN_HAND
    T_mount_camera: SE3 | None = None
    T_other_marker: SE3 | None = None  # marker pose in the base frame (in hand) or hand frame (to hand)
    position_residuals: tuple[float, ...] = ()  # [m] per view
    rotation_residuals: tuple[float, ...] = ()  # [rad] per view
    outliers: tuple[int, ...] = ()  # indices of views with much larger residuals

    @property
    def rms(self) -> tuple[float, float]:
        """Return the rms residuals of a hand-eye calibration: position [m] and rotation [rad]."""
        p, r = np.array(self.position_residuals), np.array(self.rotation_residuals)
        return float(np.sqrt(np.mean(p**2))), float(np.sqrt(np.mean(r**2)))


def calibrate_hand_eye(
    hands: Sequence[SE3],
    markers: Sequence[SE3],
    mount: str = IN_HAND,
    most_position: float = 0.005,
    most_rotation: float = 0.02,
) -> HandEye:
    """Find the pose of a camera from several views of a marker (hand-eye calibration).
    The camera is on the hand or beside the robot.

    Args:
        hands: T_base_hand of each view.
        markers: T_camera_marker of each view.
        mount: "in_hand" or "to_hand".
        most_position, most_rotation: [m], [rad] maximum rms residuals of a valid result.
    Returns:
        SUCCESS; or FAILURE with the cause (too few views, views too similar, contradictory views) and a
        remedy. A contradictory result contains its pose for inspection.
    Raises:
        InputError: the lists have different lengths, or the mount is unknown.
    """
    if mount not in (IN_HAND, TO_HAND):
        raise InputError(f"mount is {mount!r}", hint=f"{IN_HAND!r} or {TO_HAND!r}")
    if len(hands) != len(markers):
        raise InputError(f"{len(hands)} poses of the hand, but {len(markers)} of the marker")
    refused = _refused(hands)
    if refused:
        return HandEye(ErrorCode.FAILURE, refused, {"views": len(hands)}, mount=mount)
    # in hand: base_hand X = base_marker; to hand: hand_base X camera_marker = hand_marker
    A = list(hands) if mount == IN_HAND else [T.inverse() for T in hands]
    X = _park_martin(A, list(markers))
    X, Y = _refined(A, list(markers), X)
    errors = [(Y.inverse() @ a @ X @ b) for a, b in zip(A, markers, strict=True)]
    p = tuple(float(np.linalg.norm(e.translation)) for e in errors)
    r = tuple(float(np.linalg.norm(e.rotation.log())) for e in errors)
    score = np.array(p) + LEVER * np.array(r)
    outliers = tuple(int(i) for i in np.flatnonzero(score > 4 * np.median(score) + 1e-4))
    rms = float(np.sqrt(np.mean(np.square(p)))), float(np.sqrt(np.mean(np.square(r))))
    code, message = ErrorCode.SUCCESS, ""
    if rms[0] > most_position or rms[1] > most_rotation:
        code = ErrorCode.FAILURE
        named = f"; view {', '.join(map(str, outliers))} worst: take it out" if outliers else ""
        message = (
            f"the views contradict each other by {rms[0] * 1000:.1f} mm and {np.rad2deg(rms[1]):.2f} deg"
            f"{named} (is the marker's size right, did it move, is the mount right, is the robot at rest?)"
        )
    return HandEye(
        code, message, {"rms_m": rms[0], "rms_rad": rms[1]}, mount=mount, T_mount_camera=X, T_other_marker=Y,
        position_residuals=p, rotation_residuals=r, outliers=outliers,
    )  # fmt: skip


def _refused(hands: Sequence[SE3]) -> str:
    """Return the reason why the views are not sufficient for a hand-eye calibration.
    It is empty if they are sufficient.
    """
    if len(hands) < LEAST_POSES:
        return f"{len(hands)} views are too few (take {LEAST_POSES} or more, better 10 to 15)"
    turns = [(a.rotation.inverse() @ b.rotation).log() for a, b in combinations(hands, 2)]
    angles = np.linalg.norm(turns, axis=1)
    if angles.max() < LEAST_TURN:
        return (
            f"the poses are too much alike: turned by at most {np.rad2deg(angles.max()):.1f} deg "
            f"(turn the hand by {np.rad2deg(LEAST_TURN):.0f} deg and more between views, about two axes)"
        )
    axes = np.array(
        [turn / angle for turn, angle in zip(turns, angles, strict=True) if angle > LEAST_TURN / 3]
    )
    spread = np.linalg.eigvalsh(axes.T @ axes / len(axes))
    if spread[1] < LEAST_SPREAD:
        return (
            "the hand was turned about one axis only, so the camera's position along it cannot be determined "
            "(turn it about another axis as well: tilt it forward and to the side)"
        )
    return ""


def _park_martin(A: list[SE3], B: list[SE3]) -> SE3:
    """Solve the hand-eye equation A_i^-1 A_k X = X B_i B_k^-1 in closed form:
    first for the rotation, then for the translation.
    """
    pairs = [(A[i].inverse() @ A[k], B[i] @ B[k].inverse()) for i, k in combinations(range(len(A)), 2)]
    turns = [(b.rotation.log(), a.rotation.log()) for a, b in pairs]
    clear = [t for t in turns if np.linalg.norm(t, axis=1).max() < HALF_TURN]
    M = np.zeros((3, 3))
    for b, a in clear or turns:
        M += np.outer(b, a)
    U, _, Vt = np.linalg.svd(M.T)  # rotation that maps b to a (Kabsch)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    rows = np.vstack([a.rotation.matrix - np.eye(3) for a, _ in pairs])
    right = np.concatenate([R @ b.translation - a.translation for a, b in pairs])
    t = np.linalg.lstsq(rows, right, rcond=None)[0]
    return SE3(SO3(R), np.asarray(t, dtype=float))


def _refined(A: list[SE3], B: list[SE3], X: SE3) -> tuple[SE3, SE3]:
    """Refine the two unknown poses X and Y of a hand-eye calibration by robust least squares.

    The optimization minimizes the errors of the equations A_i X B_i = Y for all views i.
    """
    from scipy.optimize import least_squares

    Y = A[0] @ X @ B[0]

    def moved(T: SE3, by: F64) -> SE3:
        return SE3(T.rotation @ SO3.exp(by[:3]), T.translation + by[3:])

    def residuals(p: F64) -> F64:
        x, y = moved(X, p[:6]), moved(Y, p[6:]).inverse()
        errors = [y @ a @ x @ b for a, b in zip(A, B, strict=True)]
        return np.concatenate([np.r_[LEVER * e.rotation.log(), e.translation] for e in errors])

    best = least_squares(residuals, np.zeros(12), loss="soft_l1", f_scale=0.005, x_scale="jac").x
    return moved(X, best[:6]), moved(Y, best[6:])
