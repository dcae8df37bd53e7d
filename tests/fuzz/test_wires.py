"""The fuzzer itself: it knows what is new, stops what crashes, and finds nothing in a short run."""

import struct

import pytest
from tests.fuzz import __main__ as fuzzing
from tests.fuzz.decoders import Decoders
from tests.fuzz.edges import Edges
from tests.fuzz.ros_tcp import RosTcp

from armcell.ros.tcp.framing import FrameError, FrameReader
from armcell.ros.tcp.peer import Peer


def test_edges_tell_what_is_new():
    def read(data):
        before = edges.count
        FrameReader().feed(data)
        return edges.count - before

    with Edges() as edges:
        assert read(b"") > 0
        assert read(b"") == 0
        assert read(struct.pack("<I2sI1s", 2, b"/a", 1, b"x")) > 0
        assert read(struct.pack("<I2sI1s", 2, b"/b", 1, b"y")) == 0
        before = edges.count
        with pytest.raises(FrameError):
            FrameReader().feed(b"\xff" * 8)
        assert edges.count > before
    before = edges.count
    FrameReader(max_body=1)
    assert edges.count == before


@pytest.mark.slow
def test_a_crash_is_found(monkeypatch):
    handle = Peer.on_frame

    def clumsy(peer, frame):
        if frame.destination.startswith("__topic_list"):
            raise KeyError("a fault of ours")
        handle(peer, frame)

    monkeypatch.setattr(Peer, "on_frame", clumsy)
    monkeypatch.setattr(fuzzing, "TARGETS", (RosTcp,))
    report = fuzzing.fuzz(frames=2000, seed=1, seconds=60)
    assert any("a fault of ours" in fault for fault in report.faults)


@pytest.mark.long
def test_a_decoder_that_says_another_thing_is_found(monkeypatch):
    from armcell.ros.codec import Codec

    decode = Codec.decode
    monkeypatch.setattr(fuzzing, "TARGETS", (Decoders,))
    monkeypatch.setattr(Codec, "decode", lambda self, name, data: decode(self, name, data[: len(data) // 2]))
    assert fuzzing.fuzz(frames=500, seed=1, seconds=20).faults


@pytest.mark.long
def test_a_short_run_over_everything_finds_nothing():
    report = fuzzing.fuzz(frames=3000, seed=4)
    assert report.faults == []
    assert report.frames >= 3000
    assert all(sum(r.frames for r in report.rounds if r.target == t.name) > 100 for t in fuzzing.TARGETS)
    assert report.rounds[-1].edges > report.rounds[3].edges  # it learnt after its first round
