"""Pictures of a run."""

import logging

import pytest

from armcell.cell import load, pictures
from armcell.core import Event

END = Event(1.0, "stage", "lift", {"phase": "end"})


@pytest.mark.slow
def test_a_run_goes_on_without_pictures_where_none_can_be_drawn(monkeypatch, caplog):
    taken, tries = [], []

    def broken(*_):
        tries.append(1)
        raise RuntimeError("EGL_BAD_ACCESS")

    with load("panda_table").connect("sim", 0) as live, caplog.at_level(logging.WARNING):
        looks = pictures.Pictures(live, lambda *picture: taken.append(picture))
        looks.on_event(END)
        ((time, title, picture),) = taken
        assert (time, title) == (1.0, "lift") and picture.ndim == 3 and picture.std() > 1
        monkeypatch.setattr(pictures, "render_rgb", broken)
        looks.on_event(END)
        looks.on_event(END)
    assert len(taken) == 1 and len(tries) == 1
    assert [r.getMessage() for r in caplog.records] == ["no more pictures of this run: EGL_BAD_ACCESS"]
