"""Cameras in the cell file."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.cell import load
from armcell.cli.check import findings
from armcell.core import InputError, Pinhole
from armcell.kinematics import kinematic_tree
from armcell.perception import save_camera_info
from armcell.sim import DepthNoise

CELL = """
robot: panda
start: {arm: home, hand: open}
objects:
  cube: {box: [0.05, 0.05, 0.05], pose: [0.5, 0, 0.025], movable: true}
cameras:
"""


def cell(tmp_path, camera: str):
    (tmp_path / "cell.yaml").write_text(CELL + f"  eye: {camera}\n")
    return load(tmp_path)


def test_all_that_can_be_said(tmp_path):
    save_camera_info(tmp_path / "lens.yaml", "lens", Pinhole(320, 240, 300.0, 301.0, 160.5, 118.0))
    found = cell(
        tmp_path,
        "{on: panda_hand, pose: {xyz: [0.05, 0, 0.03]}, info: lens.yaml, rate: 15, noise: stereo}",
    )
    (camera,) = found.cameras
    assert camera.model == Pinhole(320, 240, 300.0, 301.0, 160.5, 118.0)
    assert camera.rate == 15 and camera.link == "panda_hand" and camera.noise == DepthNoise.for_stereo()
    hand = kinematic_tree(found.model).link_pose(found.scene().positions, "panda_hand")
    np.testing.assert_allclose(camera.T_world_camera.translation, hand.apply([0.05, 0, 0.03]), atol=1e-12)
    other = cell(
        tmp_path,
        "{eye: [1, 0, 1], target: [0, 0, 0], width: 64, height: 48, depth: false, "
        "intrinsics: {fx: 60, fy: 61, cx: 30, cy: 20}, noise: {growth: 0.002}}",
    )
    assert other.cameras[0].model == Pinhole(64, 48, 60, 61, 30, 20)
    assert not other.cameras[0].has_depth and other.cameras[0].noise == DepthNoise(0, 0.002, farthest=1e6)


@pytest.mark.parametrize(
    ("camera", "text"),
    [
        ("{target: [0, 0, 0]}", "cameras/eye.*eye and target, or a pose"),
        ("{pose: [0, 0, 1], on: hand}", "cameras/eye.*unknown link 'hand'"),
        ("{pose: [0, 0, 1], fovy_deg: 40, intrinsics: {fx: 1, fy: 1, cx: 1, cy: 1}}", "fovy_deg"),
        ("{pose: [0, 0, 1], info: none.yaml}", "none.yaml"),
        ("{pose: [0, 0, 1], noise: loud}", "cameras/eye"),
        ("{pose: [0, 0, 1], noise: {nearest: 3, farthest: 2}}", "cameras/eye: .*nearest >= farthest"),
        ("{pose: [0, 0, 1], rate: 0}", "cameras/eye/rate"),
    ],
)
def test_wrong_entries_are_named(tmp_path, camera, text):
    with pytest.raises(InputError, match=text):
        cell(tmp_path, camera)


def test_check_tells_what_a_camera_is_and_sees(tmp_path):
    def said(camera: str) -> tuple[bool, str]:
        cell(tmp_path, camera)
        return next((ok, text) for ok, what, text in findings(load(tmp_path)) if what == "camera eye")

    ok, text = said("{eye: [1, 0, 1], target: [0.5, 0, 0], depth: false}")
    assert ok and "no depth" in text and "sees cube" in text
    ok, text = said("{eye: [1, 0, 1], target: [2, 0, 0], noise: stereo}")
    assert not ok and "depth with noise" in text and "turn it" in text
