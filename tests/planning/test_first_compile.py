"""The second process and the progress line of the first compilation."""

from __future__ import annotations

import io
import sys

import pytest

from armcell.planning import first_compile, warm_up


def test_the_other_process_runs_its_statements_before_the_block_is_left(tmp_path):
    file = tmp_path / "done"
    with first_compile.in_another_process("from pathlib import Path", f"Path({str(file)!r}).touch()"):
        pass
    assert file.exists()


def test_an_error_in_the_other_process_has_no_effect():
    with first_compile.in_another_process("raise SystemExit(3)"):
        pass


def test_an_error_in_the_block_ends_the_other_process():
    with pytest.raises(KeyboardInterrupt), first_compile.in_another_process("import time", "time.sleep(600)"):
        raise KeyboardInterrupt


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("terminal", "shown"), [(_Terminal(), True), (io.StringIO(), False)])
def test_the_progress_line_is_only_for_terminals(monkeypatch, terminal, shown):
    monkeypatch.setattr(sys, "stderr", terminal)
    with first_compile.progress_line("compiling"):
        pass
    assert ("compiling: 0 s" in terminal.getvalue()) is shown


def test_a_compiled_planner_starts_no_other_process(monkeypatch):
    warm_up()
    monkeypatch.setattr(first_compile, "in_another_process", lambda *_: pytest.fail("started a process"))
    warm_up.cache_clear()
    warm_up()
