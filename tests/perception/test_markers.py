"""Markers drawn in the simulator and found by OpenCV, against where they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from armcell.core import (
    SE3,
    SO3,
    Box,
    CameraImage,
    ErrorCode,
    InputError,
    Pinhole,
    UnknownNameError,
)
from armcell.model import load_robot
from armcell.perception import FAMILIES, find_markers, marker_picture, picture_size
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, Decal, SimWorld, has_gl, look_at, take_image

pytest.importorskip("cv2")
TABLE = CollisionObject.single("table", Box(1.2, 1.2, 0.04), SE3.from_xyz(0.6, 0, -0.02))
SIZE = 0.06


def world(family: str, poses: dict[int, SE3]) -> SimWorld:
    """Markers on the table, given in the world's frame."""
    under = TABLE.T_world_object.inverse()
    decals = [
        Decal(f"m{n}", "table", under @ T, picture_size(family, SIZE), marker_picture(family, n))
        for n, T in poses.items()
    ]
    return SimWorld(PlanningScene.of(load_robot("parallel_gripper"), objects=[TABLE]), decals=decals)


def flat(x: float, y: float, yaw: float) -> SE3:
    return SE3(SO3.exp([0, 0, yaw]), np.array([x, y, 0.0]))


@pytest.mark.slow
@pytest.mark.cases("apriltag_36h11-True", "aruco_4x4_50-False")
@pytest.mark.parametrize("gl", [False, True] if has_gl() else [False])
@pytest.mark.parametrize("family", ["apriltag_36h11", "aruco_4x4_50"])
def test_poses_end_to_end(family, gl):
    rng = np.random.default_rng(0)
    truth = {n: flat(0.5 + 0.12 * (n % 3), -0.12 + 0.12 * (n // 3), rng.uniform(-3, 3)) for n in range(9)}
    there = world(family, truth)
    off = []
    for eye in ([0.3, -0.4, 0.6], [1.1, 0.2, 0.5], [0.62, 0.05, 0.75]):
        camera = Camera("eye", look_at(eye, [0.6, 0, 0]), 640, 480, 45.0)
        sight = find_markers(take_image(there, camera, gl), family, SIZE, range(9))
        assert sight.ok, sight.message
        drawn = {n: T @ SE3.from_xyz(0, 0, 0.0005) for n, T in truth.items()}  # so far off the table
        off += [sight[n].T_world_marker.distance_to(T) for n, T in drawn.items()]
        assert max(m.error_px for m in sight.markers) < 1.0
    position, angle = np.array(off).T
    # rays take one sample a pixel, so that edges are stairs; OpenGL's four make them ramps
    assert np.median(position) < (0.0002 if gl else 0.001) and position.max() < 0.005
    assert np.rad2deg(np.median(angle)) < (0.1 if gl else 0.7)


@pytest.mark.slow
def test_a_pose_that_may_be_tilted_the_other_way_is_told():
    """Markers of 20 pixels with edges like stairs: for some the wrong one of two poses fits better."""
    rng, truth = np.random.default_rng(0), {}
    for n in range(12):
        turn = SO3.exp(np.r_[rng.normal(size=2) * 0.45, 0]) @ SO3.exp([0, 0, rng.uniform(-3, 3)])
        truth[n] = SE3(turn, np.array([0.35 + 0.17 * (n % 4), -0.2 + 0.2 * (n // 4), 0.1]))
    camera = Camera("eye", look_at([0.6, -0.05, 1.6], [0.6, 0, 0.1]), 640, 480, 45.0)
    sight = find_markers(take_image(world("apriltag_36h11", truth), camera, False), "apriltag_36h11", SIZE)
    wrong = [m for m in sight.markers if m.T_world_marker.distance_to(truth[m.id])[1] > 0.15]
    assert len(wrong) >= 2 and all(m.ambiguous for m in wrong)


def test_a_covered_edge_is_told():
    """Something dark along one side moves a corner by 6 pixels; the error of the pose alone is small."""
    rows = np.pad(np.kron(marker_picture("apriltag_36h11", 0), np.ones((12, 12), np.uint8)), 60, "edge")
    size = len(rows)
    v, u = np.mgrid[0:size, 0:size]
    right, low, high = size - 60 - 12, 60 + 12, size - 60 - 12  # sides of the black square
    covered = rows.copy()
    middle = (low + high) / 2
    covered[
        (v > middle) & (v < high) & (u >= right - 1) & (u < right + 6 * (v - middle) / (high - middle))
    ] = 0
    pinhole = Pinhole.of_fov(size, size, 30.0)
    seen = {}
    for what, picture in (("clean", rows), ("covered", covered)):
        image = CameraImage("eye", pinhole, SE3.identity(), 0.0, np.repeat(picture[:, :, None], 3, 2))
        seen[what] = find_markers(image, "apriltag_36h11", SIZE)[0]
    assert not seen["clean"].hidden and seen["covered"].hidden


@pytest.mark.slow
def test_a_marker_that_is_not_there():
    there = world("apriltag_36h11", {3: flat(0.6, 0, 0.4)})
    image = take_image(there, Camera("eye", look_at([0.3, -0.3, 0.5], [0.6, 0, 0]), 320, 240))
    sight = find_markers(image, "apriltag_36h11", SIZE, [3, 7])
    assert sight.code is ErrorCode.FAILURE and sight.missing == (7,) and sight[3].id == 3
    assert "marker 7 of apriltag_36h11 not in view (seen: 3" in sight.message
    with pytest.raises(UnknownNameError, match="seen marker '7'"):
        sight[7]
    assert find_markers(image, "apriltag_36h11", {3: SIZE}).ok
    other = find_markers(image, "aruco_4x4_50", SIZE)
    assert not other.ok and "no marker" in other.message and "check the family" in other.message


@pytest.mark.slow
def test_pictures_that_cannot_be_used():
    there = world("apriltag_36h11", {3: flat(0.6, 0, 0.4)})
    image = take_image(there, Camera("eye", look_at([0.3, -0.3, 0.5], [0.6, 0, 0]), 320, 240))
    stale = find_markers(image, "apriltag_36h11", SIZE, [3], now=9.0)
    assert stale.code is ErrorCode.SENSOR_INFO_STALE and stale.missing == (3,)
    grey = find_markers(replace(image, rgb=None), "apriltag_36h11", SIZE)
    assert grey.code is ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA and "no color" in grey.message
    with pytest.raises(UnknownNameError, match="apriltag_36h11"):
        find_markers(image, "apriltag_36h12", SIZE)
    with pytest.raises(InputError, match="marker size"):
        find_markers(image, "apriltag_36h11", 0.0)
    with pytest.raises(InputError, match="no marker 50"):
        marker_picture("aruco_4x4_50", 50)


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_is_known_to_opencv(family):
    picture = marker_picture(family, 1)
    assert picture[0].min() == 255 and picture[1].max() > 0 and picture[1, 1:-1].max() == 0
    assert picture_size(family, 1.0) == pytest.approx(len(picture) / (len(picture) - 2))
