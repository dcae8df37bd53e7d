"""Which ways through the code have been taken: what tells a fuzzer that an input did something new.

Python 3.12 and later tell of lines and branches by `sys.monitoring`, where a place that has nothing new to
tell is switched off and costs nothing more. Python 3.11 has `sys.settrace`, which costs at every line.
"""

from __future__ import annotations

import sys
import threading
from collections import Counter
from pathlib import Path
from types import CodeType
from typing import Any, cast

import armcell.ros

ROOM = str(Path(armcell.ros.__file__).parent)
ENOUGH = 1000  # times that one way is followed: whatever comes of the other shows in its lines
ONE_IN = 32  # 3.11: calls of a function that are followed after that
GENERATED = "<string>"  # rosbags' decoders are made and compiled when a type is first used


def is_watched(code: CodeType) -> bool:
    return code.co_filename.startswith(ROOM) or code.co_filename == GENERATED


class Edges:
    """Counts, in every thread that starts while `with` lasts.

    Attributes:
        count: lines and branches taken (3.12 and later), or pairs of lines (3.11).
    """

    def __init__(self) -> None:
        self.count = 0
        self._have: dict[tuple[int, int], set[int]] = {}
        self._times: Counter[tuple[int, int]] = Counter()
        self._codes: dict[int, CodeType] = {}  # kept, lest another code get the number of one that is gone

    def _new(self, code: CodeType, at: int, to: int) -> int:
        """Note a way; how many ways lead from this place now."""
        self._codes[id(code)] = code
        have = self._have.setdefault((id(code), at), set())
        if to not in have:
            have.add(to)
            self.count += 1
        return len(have)

    if sys.version_info >= (3, 12):

        def __enter__(self) -> Edges:
            on, tool = sys.monitoring, sys.monitoring.COVERAGE_ID
            on.use_tool_id(tool, "armcell fuzz")
            on.register_callback(tool, on.events.LINE, self._line)
            on.register_callback(tool, on.events.BRANCH, self._branch)
            on.set_events(tool, on.events.LINE | on.events.BRANCH)
            on.restart_events()
            return self

        def __exit__(self, *exc: object) -> None:
            sys.monitoring.set_events(sys.monitoring.COVERAGE_ID, 0)
            sys.monitoring.free_tool_id(sys.monitoring.COVERAGE_ID)

        def _line(self, code: CodeType, line: int) -> object:
            if is_watched(code):
                self._new(code, -line, 0)
            return sys.monitoring.DISABLE

        def _branch(self, code: CodeType, at: int, to: int) -> object:
            if is_watched(code) and self._new(code, at, to) < 2:
                self._times[id(code), at] += 1
                if self._times[id(code), at] < ENOUGH:
                    return None  # the other way may still come
            return sys.monitoring.DISABLE

    else:

        def __enter__(self) -> Edges:
            self._before = sys.gettrace()
            sys.settrace(self._call)
            threading.settrace(self._call)
            return self

        def __exit__(self, *exc: object) -> None:
            sys.settrace(self._before)
            threading.settrace(cast(Any, self._before))  # None, too: the stub does not know

        def _call(self, frame, event, arg):
            code = frame.f_code
            if not is_watched(code):
                return None
            self._times[id(code), 0] += 1
            if (times := self._times[id(code), 0]) > ENOUGH and times % ONE_IN:
                return None
            last = 0

            def local(frame, event, arg):
                nonlocal last
                if event == "line":
                    self._new(code, last, frame.f_lineno)
                    last = frame.f_lineno
                return local

            return local
