"""Pictures of failed trials, taken as they are run again."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import armcell
from armcell.campaigns import CampaignSpec, begin, take_pictures
from armcell.campaigns.failure_frames import failure_frame, picture_file
from armcell.campaigns.trial import Trial, failed, run_trial

OFFSET = {"disturbances.joint_offset_deg.panda_joint2": 3.0, "objects.cube.friction": 0.36}  # meets the cube


@pytest.fixture(scope="module")
def touched() -> dict:
    row = run_trial(armcell.load("panda_pick"), Trial(1, 1, OFFSET))
    assert not row["success"] and "cube" in row["pair"]
    return row


@pytest.mark.slow
def test_the_moment_is_that_of_the_first_contact(touched, monkeypatch):
    cell = armcell.load("panda_pick")
    first = failure_frame(cell, touched)
    assert first is not None and first.shape == (480, 640, 3) and first.std() > 20  # something is on it
    monkeypatch.setattr("armcell.cell.pictures.Pictures.on_event", lambda self, event: None)
    last = failure_frame(cell, touched)
    assert last is not None and np.abs(first.astype(int) - last).max() > 60  # else that of the end


@pytest.mark.slow
def test_a_trial_that_succeeds_has_none():
    row = run_trial(armcell.load("panda_pick"), Trial(0, 0, {}))
    assert row["success"] and failure_frame(armcell.load("panda_pick"), row) is None


@pytest.mark.slow
def test_which_get_one(touched, tmp_path):
    """Those that can be run again; a picture that is there is not taken twice."""
    store = begin(CampaignSpec("panda_pick", {}, trials=4), tmp_path)
    store.append(failed(Trial(0, 0, {}), "CRASHED", "the worker died"))
    store.append(touched)
    store.append({**touched, "trial": 2, "wall_s": 1e3})
    told: list[tuple[int, int]] = []
    take_pictures(store, lambda done, of: told.append((done, of)))
    assert told == [(0, 1), (1, 1)]
    assert [f.name for f in (store.folder / "pictures").iterdir()] == ["trial_1.png"]
    file = picture_file(store.folder, 1)
    assert Image.open(file).size == (640, 480)
    file.write_bytes(b"mine")
    take_pictures(store)
    assert file.read_bytes() == b"mine"
    store.close()
