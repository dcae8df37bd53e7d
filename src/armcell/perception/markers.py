"""Poses of ArUco markers and AprilTags in a picture (OpenCV, extra `vision`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
    SO3,
    CameraImage,
    ErrorCode,
    InputError,
    MissingExtraError,
    Outcome,
    UnknownNameError,
)
from armcell.perception.usable import stale

F64 = NDArray[np.float64]

FAMILIES = {
    **{
        f"aruco_{n}x{n}_{count}": f"DICT_{n}X{n}_{count}"
        for n in (4, 5, 6, 7)
        for count in (50, 100, 250, 1000)
    },
    "aruco_original": "DICT_ARUCO_ORIGINAL",
    "apriltag_16h5": "DICT_APRILTAG_16h5",
    "apriltag_25h9": "DICT_APRILTAG_25h9",
    "apriltag_36h10": "DICT_APRILTAG_36h10",
    "apriltag_36h11": "DICT_APRILTAG_36h11",
}
QUIET = 1  # cells of white around a marker's picture
AMBIGUOUS = 2.0  # a pose tilted the other way fits nearly as well if its error is so many times at most
CORNER_PX = 0.2  # [px] and so much more: corners are not better known, so a smaller error may be chance
CROOKED_PX = 0.3  # [px] median distance of an edge from its line, from which it counts as partly hidden


@dataclass(frozen=True, eq=False)
class SeenMarker:
    """A marker's pose. Its frame: x right, y up in its picture, z out of it; the origin in its middle."""

    id: int
    T_world_marker: SE3
    T_camera_marker: SE3
    corners: F64  # (4, 2) [px] from the picture's upper left corner, clockwise
    error_px: float  # root mean square of the corners' reprojection
    ambiguous: bool  # small or far: a pose tilted the other way fits nearly as well
    hidden: bool  # an edge is no straight line: something covers a part of it, the pose may be far off


@dataclass(frozen=True)
class MarkerSight(Outcome):
    """The markers of one picture, by number."""

    markers: tuple[SeenMarker, ...] = ()
    missing: tuple[int, ...] = ()  # wanted and not seen
    time: float = 0.0  # [s] of the picture

    def __getitem__(self, number: int) -> SeenMarker:
        for marker in self.markers:
            if marker.id == number:
                return marker
        raise UnknownNameError("seen marker", number, [str(m.id) for m in self.markers])


def find_markers(
    image: CameraImage,
    family: str,
    size: float | Mapping[int, float],
    wanted: Iterable[int] = (),
    now: float | None = None,
    max_age: float = 0.5,
) -> MarkerSight:
    """Find the markers of a family in a picture with colour.

    Args:
        size: [m] edge of the black square, of all or by number; others are left out.
        wanted: numbers that must be there.
        now: [s] of the picture's clock; a picture older than `max_age` is refused.
    Returns:
        SUCCESS when every wanted marker is seen, or at least one where none is named; FAILURE, and what is
        seen; UNABLE_TO_AQUIRE_SENSOR_DATA without colour; SENSOR_INFO_STALE for an old picture.
    Raises:
        MissingExtraError: OpenCV is not installed.
        UnknownNameError: no such family.
        InputError: a size that is not positive.
    """
    sizes = size if isinstance(size, Mapping) else None
    for value in sizes.values() if sizes is not None else (size,):
        if not (isinstance(value, int | float) and np.isfinite(value) and value > 0):
            raise InputError(f"marker size is {value}, it must be a positive number of metres")
    cv2, dictionary = _dictionary(family)
    expected = tuple(sorted(set(wanted)))
    name = f"camera {image.camera!r}"
    old = stale(image, max_age, now)
    if old is not None:
        return MarkerSight(old.code, old.message, old.evidence, missing=expected, time=image.time)
    if image.rgb is None:
        return MarkerSight(
            ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA, f"{name} gave no colour, markers need it",
            missing=expected, time=image.time,
        )  # fmt: skip
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    grey = cv2.cvtColor(image.rgb, cv2.COLOR_RGB2GRAY)
    corners, ids, rejected = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    found = []
    cells = dictionary.markerSize + 2
    for quad, number in zip(corners, [] if ids is None else np.ravel(ids), strict=True):
        edge = sizes.get(int(number)) if sizes is not None else size
        if isinstance(edge, int | float):
            about = np.asarray(quad, float).reshape(4, 2)
            exact, crooked = refined_corners(grey.astype(float), about, cells)
            found.append(_pose(cv2, image, int(number), exact, float(edge), crooked > CROOKED_PX))
    found.sort(key=lambda marker: marker.id)
    missing = tuple(n for n in expected if n not in {m.id for m in found})
    ok = bool(found) and not missing
    return MarkerSight(
        ErrorCode.SUCCESS if ok else ErrorCode.FAILURE,
        "" if ok else _why(name, family, missing, found, len(rejected)),
        markers=tuple(found), missing=missing, time=image.time,
    )  # fmt: skip


def _why(name: str, family: str, missing: tuple[int, ...], found: list[SeenMarker], rejected: int) -> str:
    what = f"marker {', '.join(map(str, missing))}" if missing else "no marker"
    seen = ", ".join(str(m.id) for m in found) or "none"
    return (
        f"{name}: {what} of {family} {'not ' if missing else ''}in view (seen: {seen}; {rejected} squares "
        "that are none: turn the camera to it, come nearer, light it, or check the family and its white rim)"
    )


def marker_picture(family: str, number: int) -> NDArray[np.uint8]:
    """A marker (n, n) with one pixel per cell, `QUIET` cells of white around it.

    Raises:
        MissingExtraError: OpenCV is not installed.
        InputError: the family has no such number.
    """
    cv2, dictionary = _dictionary(family)
    count = len(dictionary.bytesList)
    if not 0 <= number < count:
        raise InputError(f"{family} has no marker {number}", cure=f"0 to {count - 1}")
    cells = dictionary.markerSize + 2  # with its black border
    inner = np.asarray(cv2.aruco.generateImageMarker(dictionary, number, cells))
    return np.pad(inner, QUIET, constant_values=255)


def picture_size(family: str, size: float) -> float:
    """Edge [m] of the whole picture of a marker whose black square has an edge of `size` [m]."""
    cells = _dictionary(family)[1].markerSize + 2
    return size * (cells + 2 * QUIET) / cells


def _dictionary(family: str) -> tuple[Any, Any]:
    if family not in FAMILIES:
        raise UnknownNameError("marker family", family, FAMILIES)
    try:
        import cv2
    except ImportError:
        raise MissingExtraError("opencv-python-headless", "vision") from None
    return cv2, cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILIES[family]))


def refined_corners(grey: F64, corners: F64, cells: int) -> tuple[F64, float]:
    """Corners (4, 2) [px] where lines through a marker's four edges meet, and how crooked the edges are.

    OpenCV's own refinements are 0.1 to 0.7 px too far in or out, by the size of their window, which at ten
    times the marker's size is millimetres of distance. Here an edge is where the change from black to white
    has its middle, looked for across each side at many places.

    Args:
        grey: (h, w) brightness.
        corners: (4, 2) from the upper left one, clockwise, about right.
        cells: along a side, the black border included.
    Returns:
        The corners; and of the worst edge the median distance [px] from its line, infinite (and the corners
        as they were) where an edge is not to be seen.
    """
    from scipy.ndimage import map_coordinates

    along, steps = np.linspace(0.12, 0.88, 32), np.linspace(-1.0, 1.0, 25)
    crooked = np.inf
    for _ in range(3):
        side = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        reach = float(np.clip(0.6 * side.min() / cells, 1.0, 3.0))
        lines: list[F64] = []
        crooked = 0.0
        for k in range(4):
            a, b = corners[k], corners[(k + 1) % 4]
            way = (b - a) / side[k]
            out = np.array([way[1], -way[0]])
            places = a + along[:, None] * (b - a)
            at = places[:, None] + steps[None, :, None] * reach * out
            seen = map_coordinates(grey, [at[..., 1], at[..., 0]], order=1, mode="nearest")
            rise = np.maximum(np.diff(seen, axis=1), 0.0)
            weight = rise.sum(axis=1)
            good = weight > 0.5 * weight.max()
            if weight.max() < 10 or good.sum() < 8:  # no edge to be seen: leave it to what OpenCV found
                return corners, np.inf
            middle = (steps[1:] + steps[:-1]) / 2 * reach
            edges = places[good] + ((rise @ middle) / np.maximum(weight, 1e-9))[good, None] * out
            normal, offset = _line(edges)
            off = np.abs(edges @ normal - offset)
            crooked = max(crooked, float(np.median(off)))
            normal, offset = _line(edges[off <= max(3 * float(np.median(off)), 0.05)])
            lines.append(np.r_[normal, offset])
        pairs = [(lines[k - 1], lines[k]) for k in range(4)]
        corners = np.array([np.linalg.solve(np.stack([p[:2], q[:2]]), [p[2], q[2]]) for p, q in pairs], float)
    return corners, crooked


def _line(points: F64) -> tuple[F64, float]:
    """Normal (2,) and offset of the line through points (n, 2), by least squares."""
    centre = points.mean(axis=0)
    normal = np.linalg.eigh((points - centre).T @ (points - centre))[1][:, 0]
    return normal, float(normal @ centre)


def _pose(cv2: Any, image: CameraImage, number: int, corners: F64, size: float, hidden: bool) -> SeenMarker:
    """By infinitesimal plane-based pose estimation (Collins and Bartoli, IJCV 109, 2014), then refined."""
    h = size / 2
    square = np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]])
    K, distortion = image.pinhole.matrix, np.array(image.pinhole.distortion, float)
    _, turns, shifts, _ = cv2.solvePnPGeneric(square, corners, K, distortion, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    found: list[tuple[float, SE3]] = []
    for first, second in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(square, corners, K, distortion, first, second)
        back = cv2.projectPoints(square, turn, shift, K, distortion)[0].reshape(4, 2)
        error = float(np.sqrt(np.mean(np.sum((back - corners) ** 2, axis=1))))
        found.append((error, SE3(SO3.exp(np.ravel(turn)), np.ravel(shift).astype(float))))
    found.sort(key=lambda each: each[0])
    error, T = found[0]
    ambiguous = any(
        other < AMBIGUOUS * error + CORNER_PX and T.distance_to(T_other)[1] > 0.1
        for other, T_other in found[1:]
    )
    return SeenMarker(number, image.T_world_camera @ T, T, corners, error, ambiguous, hidden)
