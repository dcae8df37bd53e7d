"""What every room's tests share: a fixed Hypothesis profile and a guard against hanging."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("armcell", derandomize=True, deadline=None, max_examples=80, database=None)
settings.load_profile("armcell")

# What a shell starts in the background ignores Ctrl-C, its children too; some tests are about it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


ROOT = Path(__file__).parents[1]
_known = set(os.listdir(ROOT))


@pytest.fixture(autouse=True)
def _clean_root() -> Iterator[None]:
    """Fail a test that leaves a file in the repository's root; tests write into `tmp_path`."""
    yield
    left = {name for name in set(os.listdir(ROOT)) - _known if not name.startswith((".", "__pycache__"))}
    _known.update(left)  # reported once
    assert not left, f"left in {ROOT} by this test (or one that ran beside it): {sorted(left)}"


@contextmanager
def _within(seconds: float) -> Iterator[None]:
    def stop(*_):
        raise AssertionError(f"took longer than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture
def within() -> Callable[[float], AbstractContextManager[None]]:
    """`with within(seconds):` fails a block that takes longer, even one that would never end."""
    return _within
