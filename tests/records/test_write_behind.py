"""A slow disk makes nobody wait: the record is put down by a thread of its own."""

from __future__ import annotations

import fcntl
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from tests.records.synthetic import panda_scene

from armcell.core import JointState, StateSample
from armcell.records import RunRecorder, read_record, write_behind
from armcell.records.write_behind import WriteBehindFile

LONGEST = 0.5  # [s] that a step may wait, besides for a processor


@pytest.fixture(scope="module")
def scene():
    return panda_scene()


class Hung:
    """Puts a pipe that nobody reads into a file's place: a disk that hangs until `goes_on`."""

    def __init__(self, descriptor: int):
        self._descriptor, self._file = descriptor, os.dup(descriptor)
        self._read, write = os.pipe()
        fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, 4096)
        os.dup2(write, descriptor)
        os.close(write)

    def goes_on(self) -> None:
        """What has gone into the pipe goes into the file, where it was meant to go."""
        threading.Thread(target=self._copy, daemon=True).start()

    def _copy(self) -> None:
        while data := os.read(self._read, 1 << 16):
            os.write(self._file, data)


def waited() -> float:
    """Time [s], from any moment on, in which this thread neither ran nor waited for a processor."""
    ran, ready, _ = Path("/proc/thread-self/schedstat").read_text().split()
    return time.monotonic() - 1e-9 * (int(ran) + int(ready))


def sample(scene, k: int) -> StateSample:
    q = scene.positions + 1e-3 * np.random.default_rng(k).random(len(scene.positions))
    return StateSample(0.01 * k, JointState(scene.model.joint_names, q))


@pytest.mark.slow
def test_a_disk_that_hangs_makes_no_step_wait_and_loses_nothing(scene, tmp_path):
    recorder = RunRecorder(tmp_path, scene)
    hung = Hung(recorder._mcap._stream.fileno())
    longest = 0.0
    for k in range(1500):  # MB: far more than the pipe holds
        before = waited()
        recorder.on_state(sample(scene, k))
        longest = max(longest, waited() - before)
    assert longest < LONGEST
    assert recorder._mcap._stream.waiting > 100_000
    hung.goes_on()
    end = time.monotonic() + 120
    while recorder._mcap._stream.waiting > 200_000 and time.monotonic() < end:
        time.sleep(0.01)
    recorder.finish({"success": True})
    del hung
    end = time.monotonic() + 60
    while time.monotonic() < end:  # the test's own thread copies the last bytes
        record = read_record(tmp_path)
        if not record.cut:
            break
        time.sleep(0.05)
    assert len(record.states) == 1500 and not record.cut


@pytest.mark.slow
def test_a_disk_too_far_behind_ends_the_record_and_not_the_run(scene, tmp_path, monkeypatch, caplog):
    others = set(threading.enumerate())
    monkeypatch.setattr(write_behind, "MOST_WAITING", 1 << 20)
    recorder = RunRecorder(tmp_path, scene)
    hung = Hung(recorder._mcap._stream.fileno())
    for k in range(6000):
        recorder.on_state(sample(scene, k))
    assert caplog.text.count("ends here: the disk is") == 1
    hung.goes_on()
    recorder.close()
    end = time.monotonic() + 60
    while (left := [t for t in set(threading.enumerate()) - others if t.name == "armcell-record"]) and (
        time.monotonic() < end
    ):
        time.sleep(0.01)
    assert not left


def test_what_is_written_is_there_in_order_and_close_waits(tmp_path):
    others = set(threading.enumerate())
    file = WriteBehindFile(tmp_path / "x")
    expected = b""
    for k in range(200):
        data = bytes([k]) * (k * 37)
        assert file.tell() == len(expected)
        file.write(data)
        expected += data
        if k % 7 == 0:
            file.flush()
    file.close()
    file.close()
    assert (tmp_path / "x").read_bytes() == expected
    assert not any(t.name == "armcell-record" for t in set(threading.enumerate()) - others)
