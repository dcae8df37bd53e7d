"""Helpers for the first compilation of the kernels: a second process and a progress line."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def in_another_process(*statements: str) -> Iterator[None]:
    """Run Python statements in a second process during a `with` block, so that kernels are compiled in
    parallel.

    Machines with one core start no second process. The statements must be optional work: an error in the
    second process has no effect.
    """
    process, none, call = None, subprocess.DEVNULL, [sys.executable, "-c", "; ".join(statements)]
    if (os.cpu_count() or 1) > 1 and sys.executable:
        with suppress(OSError):
            process = subprocess.Popen(call, stdin=none, stdout=none, stderr=none)
    try:
        yield
        if process is not None:
            process.wait()
    finally:
        if process is not None and process.poll() is None:
            process.kill()
            process.wait()


@contextmanager
def progress_line(text: str) -> Iterator[None]:
    """Show a line on the terminal that reports the progress and the elapsed seconds of the first
    compilation.
    """
    if not sys.stderr.isatty():
        yield
        return
    done, began = threading.Event(), time.monotonic()

    def show() -> None:
        while True:
            sys.stderr.write(f"\r{text}: {time.monotonic() - began:.0f} s")
            sys.stderr.flush()
            if done.wait(1.0):
                sys.stderr.write("\r\033[K")  # clear the line
                sys.stderr.flush()
                return

    thread = threading.Thread(target=show, name="armcell-compile-progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
