"""Standard output and standard error of the command line, with handling of write errors.

A failed write raises no exception. If the reader of the output has closed the pipe (`armcell cells | head
-1`), the program is asked to end, as SIGPIPE would. If the output cannot be written (a full disk), the
program prints a message at its end and returns exit status 1. Failures of standard error are ignored, because
they cannot be reported anywhere.
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import signal
import sys
from typing import TextIO

from armcell import _interrupts


class _Raw(io.FileIO):
    """Raw file behind the standard output stream. It remembers the first write error and discards all later
    output.
    """

    error: OSError | None = None

    def write(self, data) -> int:  # bytes-like
        if self.error is None:
            try:
                return super().write(data)
            except BlockingIOError:
                raise
            except OSError as error:
                self.error = error
                if self.fileno() == 1 and isinstance(error, BrokenPipeError):
                    _interrupts.ask(signal.SIGPIPE)
        return memoryview(data).nbytes


_out: _Raw | None = None


def install() -> None:
    """Replace `sys.stdout` and `sys.stderr` with streams that survive write errors, and reopen standard
    streams that the parent process has closed.
    """
    global _out
    for number in (0, 1, 2):  # otherwise the next opened file would receive the output of libraries
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    _out, sys.stdout = _stream(1, sys.stdout)
    _, sys.stderr = _stream(2, sys.stderr)
    logging.raiseExceptions = False  # logging would print a traceback if standard error cannot be written


def close() -> int:
    """Flush the standard output streams at the end of the program.
    Return 0, or a nonzero exit status if output could not be written.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()
    if _out is None or _out.error is None:
        return 0
    if isinstance(_out.error, BrokenPipeError):
        return 128 + signal.SIGPIPE
    with contextlib.suppress(Exception):
        sys.stderr.write(f"armcell: standard output cannot be written: {_out.error.strerror}\n")
        sys.stderr.flush()
    return 1


def _stream(number: int, before: TextIO | None) -> tuple[_Raw, io.TextIOWrapper]:
    """Return a text stream for a standard file descriptor; the stream has the encoding that Python chose for
    it.

    A character that the terminal does not have is written as "?".
    """
    raw = _Raw(number, "w", closefd=False)
    made = io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=getattr(before, "encoding", None) or "utf-8",
        errors="replace" if number == 1 else "backslashreplace",
        line_buffering=number == 2 or raw.isatty(),
        write_through=number == 2,
    )
    return raw, made
