"""Write-behind file: a background thread writes to the disk, so the caller never waits."""

from __future__ import annotations

import errno
import os
import threading
from collections import deque
from pathlib import Path

MOST_WAITING = 256 << 20  # [bytes] about one hour of recording; a disk this far behind counts as failed


class WriteBehindFile:
    """Binary file that a background thread writes sequentially (write-behind), for example for the `mcap`
    writer.

    `write` and `flush` never wait for the disk. The next call of either raises the error of a failed write.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, file: Path):
        self._file = file.open("wb", buffering=0)
        self._wake = threading.Condition()
        self._open: list[bytes] = []  # data queued until the next flush
        self._waiting: deque[bytes] = deque()
        self._bytes = self._position = 0
        self._closing = False
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._run, name="armcell-record", daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> int:
        """Queue data for the thread that writes the write-behind file to disk. Return the number of bytes.

        Raises:
            OSError: the disk is full, or too much data is waiting for it.
        """
        self._raise()
        if self._bytes + len(data) > MOST_WAITING:
            self._failed(OSError(errno.ETIMEDOUT, f"the disk is {self._bytes >> 20} MB behind"))
            self._raise()
        self._open.append(bytes(data))
        self._position += len(data)
        with self._wake:
            self._bytes += len(data)
        return len(data)

    @property
    def waiting(self) -> int:
        """Return how many bytes of a write-behind file are still waiting to be written to disk."""
        return self._bytes

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Pass all buffered data to the background thread, which writes it to the file (write-behind).

        Raises:
            OSError: an earlier write failed.
        """
        self._raise()
        if self._open:
            whole = b"".join(self._open)
            self._open.clear()
            with self._wake:
                self._waiting.append(whole)
                self._wake.notify()

    def wait(self) -> None:
        """Pass all buffered data to the background thread and wait until it has written the data to disk.

        Raises:
            OSError: a write failed.
        """
        self.flush()
        with self._wake:
            self._wake.wait_for(lambda: not self._bytes or self._error is not None)
        self._raise()

    def fileno(self) -> int:
        return self._file.fileno()

    def close(self) -> None:
        """Close the write-behind file after all data has been written to disk. Repeated calls have no effect.

        Raises:
            OSError: a write failed.
        """
        if self._file.closed:
            return
        try:
            if self._error is None:
                self.flush()
        finally:
            with self._wake:
                self._closing = True
                self._wake.notify()
            self._thread.join()
            self._file.close()
        self._raise()

    def _failed(self, error: OSError) -> None:
        """Store an error that occurred while the background thread was writing to disk.
        Discard the waiting data and end the thread.
        """
        with self._wake:
            self._error, self._closing = error, True
            self._waiting.clear()
            self._wake.notify_all()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                data = self._waiting.popleft()
            try:
                rest = memoryview(data)
                while rest:
                    rest = rest[os.write(self._file.fileno(), rest) :]
            except OSError as error:
                self._failed(error)
                return
            with self._wake:
                self._bytes -= len(data)
                self._wake.notify_all()
