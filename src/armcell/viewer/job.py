"""One piece of work at a time beside a panel that goes on answering."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from armcell.core import ArmcellError, InputError

logger = logging.getLogger(__name__)


@dataclass(eq=False)
class Job:
    """A piece of work that runs in a thread of its own."""

    kind: str  # "planning", "explaining", "executing"
    cancel: threading.Event = field(default_factory=threading.Event)
    thread: threading.Thread | None = None


class Jobs:
    """Runs a job unless another one runs.

    Args:
        lock: of whoever owns this; it is held where the current job changes.
        failed: told under the lock what went wrong in a job.
        ended: told of a job's end, without the lock.
    """

    def __init__(self, lock: threading.RLock, failed: Callable[[str], None], ended: Callable[[], None]):
        self._lock, self._failed, self._ended = lock, failed, ended
        self.current: Job | None = None

    @property
    def busy(self) -> str:
        """The kind of the current job or nothing."""
        job = self.current
        return job.kind if job is not None else ""

    def begin(self, kind: str, work: Callable[[Job], None]) -> None:
        """Start a thread for some work, under the lock.

        Raises:
            InputError: something else is being done.
        """
        if self.busy == "explaining":  # of interest no more
            self._abandon()
        if self.busy:
            raise InputError(f"the session is {self.busy}", cure="stop it, or wait for its end")
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
        except Exception as error:  # said in the panel; the server lives on
            logger.exception("%s failed", job.kind)
            message = f"internal error: {type(error).__name__}: {error}"
        with self._lock:
            if self.current is not job:
                return
            self.current = None
            if message is not None:
                self._failed(message)
        self._ended()

    def stop(self) -> bool:
        """Cancel what runs; whether anything did."""
        with self._lock:
            job = self.current
            if job is None:
                return False
            job.cancel.set()
            if job.kind == "explaining":  # nothing in it can be interrupted: its answer is not waited for
                self._abandon()
        return True

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until nothing is being done; whether that came within the time [s]."""
        job = self.current
        if job is not None and job.thread is not None:
            job.thread.join(timeout)
        return not self.busy

    def _abandon(self) -> None:
        job, self.current = self.current, None
        if job is not None:
            job.cancel.set()
