"""`armcell look` on a cell and on files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image
from tests.cli.helpers import call

CELL = """
robot: parallel_gripper
objects:
  table: {box: [1, 1, 0.04], pose: [0.8, 0, -0.02]}
  cube: {box: [0.05, 0.05, 0.05], pose: [0.8, 0.1, 0.025], movable: true}
cameras:
  eye: {eye: [0.4, -0.3, 0.6], target: [0.8, 0, 0], width: 320, height: 240, noise: stereo}
  plain: {eye: [0.4, -0.3, 0.6], target: [0.8, 0, 0], width: 64, height: 48, depth: false}
markers:
  tag: {family: apriltag_36h11, id: 5, size: 0.06, on: table, pose: [0, -0.1, 0.02]}
"""


@pytest.mark.slow
def test_a_cell_and_the_files_of_its_picture(tmp_path, capsys):
    (tmp_path / "cell.yaml").write_text(CELL)
    said = call(
        capsys, "look", tmp_path, "--camera", "eye", "--picture", tmp_path / "seen.png", "--save",
        tmp_path / "shot", "--json", tmp_path / "out.json",
    )  # fmt: skip
    assert said.status == 0, said.err
    assert "cube box" in said.words and "1 seen" in said.words and "deg" in said.words
    (seen,) = json.loads((tmp_path / "out.json").read_text())["seen"]
    assert seen["known"] and seen["off_m"] < 0.002 and np.rad2deg(seen["off_rad"]) < 2
    assert Image.open(tmp_path / "seen.png").size == (320, 240)
    again = call(capsys, "look", tmp_path / "shot.yaml", "--json", tmp_path / "again.json")
    assert again.status == 0, again.err
    (box,) = json.loads((tmp_path / "again.json").read_text())["seen"]
    np.testing.assert_allclose(box["position"], seen["position"], atol=0.002)
    np.testing.assert_allclose(box["size"], 0.05, atol=0.003)


@pytest.mark.slow
def test_markers_of_a_cell(tmp_path, capsys):
    (tmp_path / "cell.yaml").write_text(CELL)
    said = call(
        capsys, "look", tmp_path, "--camera", "eye", "--markers", "apriltag_36h11", "--marker-size", 0.06,
        "--json", tmp_path / "out.json",
    )  # fmt: skip
    assert said.status == 0 and "marker 5" in said.words
    (tag,) = json.loads((tmp_path / "out.json").read_text())["seen"]
    np.testing.assert_allclose(tag["position"], [0.8, -0.1, 0.0005], atol=0.002)


@pytest.mark.slow
def test_what_cannot_be_seen_is_one_line_with_a_cure(tmp_path, capsys):
    (tmp_path / "cell.yaml").write_text(CELL)

    def fails(*arguments: object) -> str:
        said = call(capsys, "look", *arguments)
        assert said.status == 1, said
        return said.words + " " + " ".join(said.err.split())

    assert "depth: true" in fails(tmp_path, "--camera", "plain")
    assert "known: eye, plain" in fails(tmp_path, "--camera", "ey")
    assert "no marker of aruco_4x4_50" in fails(tmp_path, "--camera", "eye", "--markers", "aruco_4x4_50")
    assert "give a cell" in fails()
    assert "--place" in fails(tmp_path / "cloud.ply")
    assert "--depth FILE" in fails("--info", tmp_path / "cell.yaml")
    assert "unknown cell" in fails("no_such_cell")
    (tmp_path / "x.mcap").write_bytes(b"nothing")
    assert "x.mcap" in fails(tmp_path / "x.mcap")
