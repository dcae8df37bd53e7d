"""Maps of heights from made pictures."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.core import SE3, Box, CameraImage, Pinhole
from armcell.model import load_robot
from armcell.perception import height_map, label_pieces
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, SimWorld, look_at, take_image

MODEL = load_robot("ur10_gripper")


def seen_from_above(*objects, eye=(0.9, 0.0, 1.0)):
    scene = PlanningScene.of(MODEL, objects=objects)
    scene = scene.with_state(MODEL.named_state("arm", "up"))
    camera = Camera("above", look_at(eye, (0.9, 0.001, 0.0)), 320, 240, 45.0)
    return take_image(SimWorld(scene), camera, rgb=False), scene


def box(name, x, y, size):
    return CollisionObject.single(name, Box(*size), SE3.from_xyz(x, y, size[2] / 2))


@pytest.mark.slow
def test_two_boxes_are_two_pieces_of_their_size_and_height():
    table = CollisionObject.single("table", Box(2, 2, 0.02), SE3.from_xyz(0.5, 0, -0.01))
    image, scene = seen_from_above(
        table, box("a", 0.85, -0.1, (0.06, 0.04, 0.05)), box("b", 0.95, 0.1, (0.05, 0.05, 0.08))
    )
    seen = height_map(image, scene, (0.7, -0.25), (1.1, 0.25), 0.0)
    labels = label_pieces(seen, np.ones_like(seen.seen), 0.007)
    numbers = []
    for x, y, height, area in ((0.85, -0.1, 0.05, 0.0024), (0.95, 0.1, 0.08, 0.0025)):
        i, j = np.round((np.array([x, y]) - seen.origin) / seen.resolution).astype(int)
        assert seen.heights[i, j] == pytest.approx(height, abs=1e-3)
        numbers.append(labels[i, j])
        assert (labels == labels[i, j]).sum() * seen.resolution**2 == pytest.approx(area, rel=0.25)
    assert sorted(numbers) == [0, 1]  # the largest two


@pytest.mark.slow
def test_what_is_hidden_counts_as_filled():
    table = CollisionObject.single("table", Box(2, 2, 0.02), SE3.from_xyz(0.5, 0, -0.01))
    image, scene = seen_from_above(table, box("a", 0.9, 0.0, (0.05, 0.2, 0.1)), eye=(0.5, 0.0, 0.6))
    seen = height_map(image, scene, (0.8, -0.1), (1.1, 0.1), 0.0)
    i, j = np.round((np.array([0.96, 0.0]) - seen.origin) / seen.resolution).astype(int)
    assert not seen.seen[i, j]  # behind the box
    assert seen.heights[i, j] > 0.05


def test_the_robot_is_no_height():
    scene = PlanningScene.of(MODEL).with_state(MODEL.named_state("arm", "home"))
    wrist = scene.frame_pose("wrist_3_link").translation
    pinhole = Pinhole(2, 2, 100.0, 100.0, 0.5, 0.5)
    eye = look_at(wrist + np.array([0, 0, 1.0]), wrist)
    image = CameraImage("c", pinhole, eye, depth=np.full((2, 2), 1.0, np.float32))
    seen = height_map(image, scene, tuple(wrist[:2] - 0.05), tuple(wrist[:2] + 0.05), 0.0)
    assert not seen.seen.any() and np.all(seen.heights == 0.0)
