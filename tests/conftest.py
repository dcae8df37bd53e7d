"""What every room's tests share: a fixed Hypothesis profile and a guard against hanging."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

settings.register_profile("armcell", derandomize=True, deadline=None, max_examples=80, database=None)
settings.load_profile("armcell")

# What a shell starts in the background ignores Ctrl-C, its children too; some tests are about it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makeitem(name: str) -> Generator[None, Any, Any]:
    """Mark the cases of a parametrized test as `long` that its marker `cases` does not name.

    Raises:
        pytest.UsageError: A name matches no case; a typo would otherwise move a case to `make test-long`.
    """
    items = yield
    marker = items[0].get_closest_marker("cases") if isinstance(items, list) and items else None
    if marker is not None:
        ids = [item.name[len(name) + 1 : -1] for item in items]
        named = {p: [case for case in ids if case == p or fnmatchcase(case, p)] for p in marker.args}
        if unknown := [p for p, found in named.items() if not found]:
            raise pytest.UsageError(f"{name}: no case matches {unknown}. Cases: {ids}")
        for item, case in zip(items, ids, strict=True):
            if not any(case in found for found in named.values()):
                item.add_marker(pytest.mark.long)
    return items


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
