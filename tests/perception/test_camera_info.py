"""Camera info files, and rectifying by them, against OpenCV."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from armcell.core import SE3, CameraImage, InputError, Pinhole
from armcell.perception import load_camera_info, rectified, save_camera_info

LENS = Pinhole(160, 120, 150.0, 148.0, 81.0, 57.0, (-0.2, 0.05, 0.001, -0.002, 0.01))


def test_round_trip(tmp_path):
    save_camera_info(tmp_path / "a.yaml", "a", LENS)
    found = load_camera_info(tmp_path / "a.yaml")
    assert found.name == "a" and found.pinhole == LENS and found.rectified().distortion == ()


def test_a_file_of_ros(tmp_path):
    """As camera_calibration_parsers writes it, cut short."""
    (tmp_path / "ost.yaml").write_text(
        "image_width: 640\nimage_height: 480\ncamera_name: narrow_stereo\n"
        "camera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.0, 0.0, 1.0]\n"
        "distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
        "  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]\n"
    )
    found = load_camera_info(tmp_path / "ost.yaml")
    assert found.name == "narrow_stereo" and found.pinhole.fy == 437.302876
    assert found.pinhole.distortion[0] == -0.361976


def test_rectifying_is_opencvs():
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(0)
    rgb = cv2.GaussianBlur(rng.integers(0, 255, (120, 160, 3), dtype=np.uint8), (9, 9), 3)
    depth = rng.uniform(0.5, 1, (120, 160)).astype(np.float32)
    mine = rectified(CameraImage("c", LENS, SE3.identity(), 0.0, rgb, depth))
    assert mine.pinhole.distortion == ()
    theirs = cv2.undistort(rgb, LENS.matrix, np.array(LENS.distortion))
    assert np.abs(mine.rgb.astype(int) - theirs)[3:-3, 3:-3].max() <= 3
    assert set(np.unique(mine.depth)) <= {0.0, *np.unique(depth)}  # depths are taken, never mixed


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"image_width": "wide"}, "image_width: needs a whole number"),
        ({"image_height": 0}, "160 x 0 pixels"),
        ({"camera_matrix": {"data": [1, 2, 3]}}, "camera_matrix: needs 9 numbers"),
        ({"camera_matrix": {"data": [0] * 9}}, "focal length"),
        ({"distortion_model": "equidistant"}, "'equidistant' is not known.*rectify"),
        ({"distortion_coefficients": {"data": [1, 2]}}, "distortion_coefficients: needs"),
    ],
)
def test_broken_files_are_named(tmp_path, change, text):
    save_camera_info(tmp_path / "a.yaml", "a", LENS)
    data = yaml.safe_load((tmp_path / "a.yaml").read_text()) | change
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match=text) as error:
        load_camera_info(tmp_path / "a.yaml")
    assert "a.yaml" in str(error.value)
