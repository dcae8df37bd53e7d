"""Background work of a panel: one job at a time, and a worker for only the newest request.

The panel stays responsive. Requests come, e.g., from a dragged control.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from armcell.core import ArmcellError, InputError

log = logging.getLogger(__name__)


@dataclass(eq=False)
class Job:
    """Background job of a browser panel, which runs in its own thread and can be canceled."""

    kind: str  # "planning", "explaining", "executing"
    cancel: threading.Event = field(default_factory=threading.Event)
    thread: threading.Thread | None = None


class Jobs:
    """Runner for the background jobs of a browser panel.
    It runs one job at a time and rejects others in the meantime.

    Args:
        lock: lock of the owner; held whenever the current job changes.
        failed: called with the error message of a failed job, while the lock is held.
        ended: called when a job has ended, without the lock.
    """

    def __init__(self, lock: threading.RLock, failed: Callable[[str], None], ended: Callable[[], None]):
        self._lock, self._failed, self._ended = lock, failed, ended
        self.current: Job | None = None

    @property
    def busy(self) -> str:
        """Return the kind of background job that the panel is running, or an empty string if there is
        none.
        """
        job = self.current
        return job.kind if job is not None else ""

    def begin(self, kind: str, work: Callable[[Job], None]) -> None:
        """Start a background job of the panel in a new thread. The caller must hold the lock.

        Raises:
            InputError: another job is running.
        """
        if self.busy == "explaining":  # its answer is no longer needed
            self._abandon()
        if self.busy:
            raise InputError(f"the session is {self.busy}", hint="stop it, or wait for its end")
        job = Job(kind)
        job.thread = threading.Thread(target=self._run, args=(job, work), name=f"armcell-{kind}", daemon=True)
        self.current = job
        job.thread.start()

    def _run(self, job: Job, work: Callable[[Job], None]) -> None:
        message = None
        try:
            work(job)
        except ArmcellError as error:
            message = str(error)
        except Exception as error:  # the panel reports the error; the server keeps running
            log.exception("%s failed", job.kind)
            message = f"internal error: {type(error).__name__}: {error}"
        with self._lock:
            if self.current is not job:
                return
            self.current = None
            if message is not None:
                self._failed(message)
        self._ended()

    def stop(self) -> bool:
        """Cancel the background job of the panel and return whether one was running."""
        with self._lock:
            job = self.current
            if job is None:
                return False
            job.cancel.set()
            if job.kind == "explaining":  # not interruptible: discard its answer instead of waiting
                self._abandon()
        return True

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until no background job of the panel is running.
        Return False if `timeout` [s] expires first.
        """
        job = self.current
        if job is not None and job.thread is not None:
            job.thread.join(timeout)
        return not self.busy

    def _abandon(self) -> None:
        job, self.current = self.current, None
        if job is not None:
            job.cancel.set()


class LatestTaskWorker:
    """Background thread of a panel that runs only the latest function submitted under each name. Older
    functions that have not started yet are dropped.
    """

    def __init__(self) -> None:
        self._wake = threading.Condition()
        self._waiting: dict[str, Callable[[], None]] = {}
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="armcell-latest", daemon=True)
        self._thread.start()

    def submit(self, name: str, work: Callable[[], None]) -> None:
        with self._wake:
            self._waiting[name] = work
            self._wake.notify()

    def close(self) -> None:
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._closing or self._waiting)
                if self._closing:
                    return
                work = self._waiting.pop(next(iter(self._waiting)))
            try:
                work()
            except Exception:  # the next request may succeed
                log.exception("could not follow a drag")
