"""Poses of ArUco markers and AprilTags in an image (requires OpenCV, extra `vision`)."""

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
from armcell.perception.image_checks import check_image_age

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
QUIET = 1  # white border of a marker's image, in cells
AMBIGUOUS = 2.0  # maximum error ratio at which the opposite tilt is also plausible
CORNER_PX = 0.2  # [px] added tolerance, the accuracy of corners
CROOKED_PX = 0.3  # [px] minimum median distance from its line of a partly hidden edge


@dataclass(frozen=True, eq=False)
class DetectedMarker:
    """A detected ArUco marker or AprilTag, with its number and pose.

    The marker's frame has its origin in the center, x right, y up, z out of the marker.
    """

    id: int
    T_world_marker: SE3
    T_camera_marker: SE3
    corners: F64  # (4, 2) [px] clockwise from the marker's upper left corner
    error_px: float  # rms reprojection error of the corners
    ambiguous: bool  # small or far marker: the opposite tilt fits almost as well
    hidden: bool  # an edge is not straight because it is partly hidden; the pose may be wrong


@dataclass(frozen=True, repr=False)
class MarkerDetections(Outcome):
    """The ArUco markers or AprilTags detected in one camera image."""

    markers: tuple[DetectedMarker, ...] = ()
    missing: tuple[int, ...] = ()  # wanted but not visible
    time: float = 0.0  # [s] time of the image

    def __getitem__(self, number: int) -> DetectedMarker:
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
) -> MarkerDetections:
    """Detect the markers of an ArUco or AprilTag family in a color image.

    Args:
        size: [m] edge of the black square, for all markers or by number; other numbers are ignored.
        wanted: numbers that must be visible.
        now: [s] of the image's clock; an image older than `max_age` is rejected.
    Returns:
        SUCCESS if every wanted marker is visible, or at least one if none is wanted; else FAILURE, with the
        visible markers; UNABLE_TO_AQUIRE_SENSOR_DATA without color; SENSOR_INFO_STALE for an old image.
    Raises:
        MissingExtraError: OpenCV is not installed.
        UnknownNameError: no such family.
        InputError: a size is not positive.
    """
    sizes = size if isinstance(size, Mapping) else None
    for value in sizes.values() if sizes is not None else (size,):
        if not (isinstance(value, int | float) and np.isfinite(value) and value > 0):
            raise InputError(f"marker size is {value}, it must be a positive number of meters")
    cv2, dictionary = _dictionary(family)
    expected = tuple(sorted(set(wanted)))
    name = f"camera {image.camera!r}"
    old = check_image_age(image, max_age, now)
    if old is not None:
        return MarkerDetections(old.code, old.message, old.evidence, missing=expected, time=image.time)
    if image.rgb is None:
        return MarkerDetections(
            ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA, f"{name} gave no color, markers need it",
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
    return MarkerDetections(
        ErrorCode.SUCCESS if ok else ErrorCode.FAILURE,
        "" if ok else _why(name, family, missing, found, len(rejected)),
        markers=tuple(found), missing=missing, time=image.time,
    )  # fmt: skip


def _why(name: str, family: str, missing: tuple[int, ...], found: list[DetectedMarker], rejected: int) -> str:
    what = f"marker {', '.join(map(str, missing))}" if missing else "no marker"
    seen = ", ".join(str(m.id) for m in found) or "none"
    return (
        f"{name}: {what} of {family} {'not ' if missing else ''}in view (seen: {seen}; {rejected} squares "
        "that are none: turn the camera to it, come nearer, light it, or check the family and its white rim)"
    )


def marker_picture(family: str, number: int) -> NDArray[np.uint8]:
    """Return the image (n, n) of an ArUco or AprilTag marker, with one pixel per cell and a white border.

    The border is `QUIET` cells wide.

    Raises:
        MissingExtraError: OpenCV is not installed.
        InputError: the family has no such number.
    """
    cv2, dictionary = _dictionary(family)
    count = len(dictionary.bytesList)
    if not 0 <= number < count:
        raise InputError(f"{family} has no marker {number}", hint=f"0 to {count - 1}")
    cells = dictionary.markerSize + 2  # including the black border
    inner = np.asarray(cv2.aruco.generateImageMarker(dictionary, number, cells))
    return np.pad(inner, QUIET, constant_values=255)


def picture_size(family: str, size: float) -> float:
    """Return the edge length [m] of an ArUco marker including its white border,
    given the edge length of its black square.
    """
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
    """Refine the corners (4, 2) [px] of an ArUco marker as intersections of the lines along its edges.

    OpenCV's own refinement is 0.1 to 0.7 px off, depending on its window size, which means millimeters at a
    distance of ten times the marker's size. Here an edge is the center of the transition from black to white,
    measured across each side at many points.

    Args:
        grey: (h, w) brightness.
        corners: (4, 2) approximate corners, clockwise from the upper left.
        cells: number of cells along a side, including the black border.
    Returns:
        The corners, and the median distance [px] from its line of the worst edge; infinite (and the
        unchanged corners) if an edge is not visible.
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
            if weight.max() < 10 or good.sum() < 8:  # no visible edge: keep OpenCV's corners
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
    """Fit a line by least squares to points (n, 2) on a marker's edge. Return its normal (2,) and offset."""
    center = points.mean(axis=0)
    normal = np.linalg.eigh((points - center).T @ (points - center))[1][:, 0]
    return normal, float(normal @ center)


def _pose(
    cv2: Any, image: CameraImage, number: int, corners: F64, size: float, hidden: bool
) -> DetectedMarker:
    """Estimate an ArUco marker's pose with the method IPPE (Collins
    and Bartoli, IJCV 109, 2014) and refine it.
    """
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
    return DetectedMarker(number, image.T_world_camera @ T, T, corners, error, ambiguous, hidden)
