"""The recorder keeps what it is told, samples by the cell's clock and leaves a whole file."""

from datetime import datetime

import numpy as np
import pytest
from tests.records.synthetic import STAGES, panda_scene, play

from armcell.core import SE3, Event, InputError, JointState, StateSample
from armcell.records import RunRecorder, new_run_folder, read_record
from armcell.records import recorder as recorder_module
from armcell.records.reader import StageSpan, stage_spans


@pytest.fixture(scope="module")
def scene():
    return panda_scene()


def _sample(scene, time, **more):
    return StateSample(time, JointState(scene.model.joint_names, scene.positions, time=time), **more)


def test_run_folder_is_named_after_time_and_cell_and_never_reused(tmp_path):
    now = datetime(2026, 3, 4, 5, 6, 7)
    first = new_run_folder(tmp_path / "runs", "panda_pick", now)
    second = new_run_folder(tmp_path / "runs", "cells/panda_pick.yaml", now)
    assert first.name == "20260304-050607-panda_pick" and first.is_dir()
    assert second.name == "20260304-050607-panda_pick-2" and second.is_dir()


def test_series_has_every_hundredth_of_a_second_and_the_last_sample(scene, tmp_path):
    with RunRecorder(tmp_path, scene) as recorder:
        for k in range(252):  # 2 ms steps, ends between two kept samples
            recorder.on_state(
                _sample(scene, 0.002 * k, gripper_width={"hand": 0.08}, gripper_force={"hand": float(k)})
            )
    series = recorder.series()
    np.testing.assert_allclose(series.times[:-1], np.arange(51) * 0.01, atol=1e-9)
    assert series.times[-1] == pytest.approx(0.502)
    assert series.gripper_force["hand"][-1] == 251.0
    assert series.positions.shape == (len(series.times), scene.model.dof)
    assert np.isnan(series.velocities).all()


def test_joints_are_sorted_by_name_and_missing_ones_are_nan(scene, tmp_path):
    names = scene.model.joint_names
    with RunRecorder(tmp_path, scene) as recorder:
        recorder.on_state(StateSample(0.0, JointState(names[::-1], np.arange(len(names)) * 0.1)))
        recorder.on_state(
            StateSample(0.1, JointState(names[:2], np.array([0.5, 0.6])), {"cube": SE3.identity()})
        )
    series = recorder.series()
    np.testing.assert_allclose(series.positions[0], np.arange(len(names))[::-1] * 0.1)
    np.testing.assert_allclose(series.positions[1, :2], [0.5, 0.6])
    assert np.isnan(series.positions[1, 2:]).all()
    assert np.isnan(series.object_heights["cube"][0]) and series.object_heights["cube"][1] == 0.0


def test_a_clock_set_back_is_recorded_again(scene, tmp_path):
    with RunRecorder(tmp_path, scene) as recorder:
        for time in (5.0, 5.5, 0.0, 0.5):
            recorder.on_state(_sample(scene, time))
    assert recorder.series().times.tolist() == [5.0, 5.5, 0.0, 0.5]


def test_of_a_long_run_the_record_keeps_all_and_memory_an_even_part(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_module, "MOST_SAMPLES", 100)
    times = np.arange(0, 1001) / 100
    with RunRecorder(tmp_path, scene) as recorder:
        for time in times:
            recorder.on_state(_sample(scene, time))
        recorder.on_state(_sample(scene, times[-1] + 0.001))
    series = recorder.series()
    assert 50 < len(series.times) <= 102 and series.times[-1] == pytest.approx(10.001)
    gaps = np.diff(series.times)[:-1]
    assert gaps.min() == pytest.approx(gaps.max()) and gaps[0] == pytest.approx(0.16)
    assert len(read_record(tmp_path).states) == 1002


def test_the_record_appears_when_closed_even_after_an_error_and_closing_twice_is_fine(scene, tmp_path):
    with pytest.raises(RuntimeError), RunRecorder(tmp_path / "new" / "run", scene) as recorder:
        recorder.on_state(_sample(scene, 0.0))
        assert not recorder.mcap_file.exists()
        raise RuntimeError("the arm fell off")
    recorder.close()
    assert [p.name for p in recorder.folder.iterdir()] == ["run.mcap"]
    recorder.on_state(_sample(scene, 1.0))  # late calls do no harm
    recorder.on_event(Event(1.0, "note", "late"))


def test_bad_pictures_are_refused(scene, tmp_path):
    with RunRecorder(tmp_path, scene) as recorder:
        recorder.add_picture(0.0, "fine", np.zeros((4, 5, 3), np.uint8))
        for bad in (np.zeros((4, 5), np.uint8), np.zeros((4, 5, 3)), np.zeros((0, 5, 3), np.uint8)):
            with pytest.raises(InputError, match="picture 'bad'"):
                recorder.add_picture(0.0, "bad", bad)
    assert len(recorder.pictures) == 1


@pytest.mark.slow
def test_stage_spans_follow_begin_and_end_events(scene, tmp_path):
    with RunRecorder(tmp_path, scene) as recorder:
        end = play(scene, recorder, rate=50.0)
    spans = stage_spans(recorder.events, end)
    assert [s.name for s in spans] == [name for name, *_ in STAGES]
    np.testing.assert_allclose([s.end - s.begin for s in spans], [stage[2] for stage in STAGES])


def test_stage_spans_without_end_events_and_without_data():
    events = [Event(1.0, "stage", "lift"), Event(0.0, "stage", "grasp"), Event(0.5, "note", "x")]
    assert stage_spans(events, 3.0) == [StageSpan("grasp", 0.0, 1.0), StageSpan("lift", 1.0, 3.0)]
    assert stage_spans([], 1.0) == []
