"""A queue that runs several motions on one driver, with one thread that advances time.

Motions of different joints run in parallel. A motion that shares joints with an earlier one waits until the
earlier one ends, and by default stops it. Only the thread that calls `step` uses the driver.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, TypeVar

from armcell.core import ErrorCode, ExecutionResult, InputError, JointTrajectory
from armcell.core.checks import require
from armcell.drivers import Driver, DriverProxy
from armcell.execution import ExecutionSteps

T = TypeVar("T")
logger = logging.getLogger(__name__)
MAX_WORKS = 16  # maximum number of waiting and running motions
SETTLE = 3.0  # [s] for canceled motions to end when the cell closes; a real arm takes at most 2 s
STOPPED = ExecutionResult(ErrorCode.PREEMPTED, "cancelled before it began")


class MotionHandle:
    """Motion in the motion queue. The motion is either a generator function `steps`, which runs step by step,
    or a blocking function `job`.

    Attributes:
        joints: the joints of the motion; motions that share a joint never run at the same time.
        cancel: event that ends the motion early; `stop` also records the reason.
        gives_way: if True, a newer motion of the same joints stops this one; if False, the newer motion
            waits.
        trajectory: the planned trajectory, if known in advance, for conflict checks with other motions.
    """

    def __init__(
        self,
        name: str,
        joints: Iterable[str],
        steps: Callable[[Driver, threading.Event], ExecutionSteps] | None = None,
        job: Callable[[threading.Event], ExecutionResult] | None = None,
        gives_way: bool = True,
        trajectory: JointTrajectory | None = None,
    ):
        self.name, self.joints, self.gives_way = name, frozenset(joints), gives_way
        self.make, self.job, self.trajectory = steps, job, trajectory
        self.cancel = threading.Event()
        self._why_stopped = ""
        self.began: float | None = None  # start time [s, driver's clock]
        self.moving = False  # True after the first step was executed without rejection
        self.steps: ExecutionSteps | None = None
        self.result: ExecutionResult | None = None
        self.error: BaseException | None = None
        self._over = threading.Event()
        self._listeners: list[Callable[[MotionHandle], None]] = []

    @property
    def is_over(self) -> bool:
        return self._over.is_set()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait up to `timeout` [s] for a motion of the motion queue to end. Return False on timeout."""
        return self._over.wait(timeout)

    def stop(self, why: str) -> None:
        """Stop a motion of the motion queue early. The result of the motion then contains the text `why`."""
        if not self.cancel.is_set():
            self._why_stopped = why
        self.cancel.set()

    def outcome(self) -> ExecutionResult:
        """Return the result of a motion of the motion queue, after the motion has ended.

        Raises:
            InputError: the motion could not be executed as requested.
        """
        if self.error is not None:
            raise self.error
        result = STOPPED if self.result is None else self.result
        if result.code is ErrorCode.PREEMPTED and self._why_stopped not in result.message:
            return replace(result, message=f"{self._why_stopped}: {result.message}")
        return result

    def add_done_callback(self, listener: Callable[[MotionHandle], None]) -> MotionHandle:
        """Register a function that the driver's thread calls when this motion of the motion queue has ended.

        Call this method before the motion is queued.
        """
        self._listeners.append(listener)
        return self

    def end(self, result: ExecutionResult | None, error: BaseException | None = None) -> None:
        self.result, self.error = result, error
        for listener in self._listeners:
            listener(self)
        self._over.set()


class MotionQueue(DriverProxy):
    """Queue that runs the motions of several clients in parallel on one driver.

    It forwards the driver's own methods, for jobs and in `call`. `advance` also steps the other motions and
    calls `after_step`.
    """

    def __init__(self, driver: Driver, after_step: Callable[[], None] = lambda: None):
        super().__init__(driver)
        self._after_step = after_step
        self._lock = threading.Lock()
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._waiting: list[MotionHandle] = []
        self._running: list[MotionHandle] = []
        self._thread: threading.Thread | None = None
        self._closed = self._ending = False

    # --- from any thread ---
    def put(self, work: MotionHandle) -> MotionHandle:
        """Add a motion to the motion queue. The motion starts after earlier motions of the same joints have
        ended.

        Raises:
            InputError: too many motions wait, or the cell is closed.
        """
        with self._lock:
            require(not (self._closed or self._ending), "the cell is closed")
            if len(self._waiting) + len(self._running) >= MAX_WORKS:
                raise InputError(f"{MAX_WORKS} motions wait already", hint="wait for one to end")
            for other in (*self._waiting, *self._running):
                if other.gives_way and other.joints & work.joints:
                    other.stop(f"preempted by a newer motion ({work.name})")
            self._waiting.append(work)
        return work

    def motions(self, joints: Iterable[str] | None = None) -> list[MotionHandle]:
        """Return the waiting and running motions in the motion queue. If joints are given, return only
        motions of these joints.
        """
        with self._lock:
            every = [*self._running, *self._waiting]
        return every if joints is None else [w for w in every if w.joints & frozenset(joints)]

    def stop(self, for_good: bool = False) -> None:
        """Stop all waiting and running motions in the motion queue.

        Args:
            for_good: if True, also reject later motions, for example of goals that are still being planned.
        """
        with self._lock:
            self._ending |= for_good
        for work in self.motions():
            work.cancel.set()

    def call(self, function: Callable[[], T]) -> T:
        """Run a function in the thread that steps the motion queue, between two steps, and return the
        function's result.
        """
        if threading.current_thread() is self._thread:
            return function()
        answer: queue.SimpleQueue[tuple[bool, Any]] = queue.SimpleQueue()

        def run() -> None:
            try:
                answer.put((True, function()))
            except BaseException as error:
                answer.put((False, error))

        with self._lock:
            require(not self._closed, "the cell is closed")
            self._calls.put(run)
        ok, value = answer.get()
        if not ok:
            raise value
        return value

    def call_soon(self, function: Callable[[], None]) -> None:
        """Schedule a function to run between two steps, in the thread that steps the motion queue. The call
        does not wait.

        Exceptions of the function are only logged.
        """

        def run() -> None:
            try:
                function()
            except Exception:
                logger.exception("an event could not be delivered")

        with self._lock:
            if not self._closed:
                self._calls.put(run)

    # --- the driver's thread ---
    def step(self) -> None:
        """Advance the motion queue's driver by one period, or run one blocking job from beginning to end."""
        self._thread = threading.current_thread()
        with self._lock:
            job = next((w for w in self._ready() if w.job is not None), None)
            if job is not None:
                self._waiting.remove(job)
                self._running.append(job)
        if job is None:
            self.advance(self._driver.period)
            return
        job.began = self._driver.now
        result, error = None, None
        try:
            assert job.job is not None
            result = STOPPED if job.cancel.is_set() else job.job(job.cancel)
        except Exception as failure:
            error = failure
        self._finish(job, result, error)

    def advance(self, duration: float) -> None:
        """Advance the driver by `duration` [s], and with it all running motions of the motion queue."""
        driver, end = self._driver, self._driver.now + duration
        while driver.now < end - 1e-9:
            while not self._calls.empty():
                self._calls.get()()
            self._step_all()
            driver.advance(min(driver.period, end - driver.now))
            self._after_step()

    def stop_and_drain(self) -> None:
        """Stop all motions in the motion queue, step the driver until the motions have ended, and reject new
        motions.
        """
        with self._lock:
            self._closed = True
        self.stop()
        end = time.monotonic() + SETTLE
        while self.motions() and time.monotonic() < end:
            self.step()

    def close(self) -> None:
        """End all motions in the motion queue, release all waiting callers, and reject new motions."""
        with self._lock:
            self._closed = True
            works = [*self._running, *self._waiting]
            self._running, self._waiting = [], []
        for work in works:
            work.end(ExecutionResult(ErrorCode.PREEMPTED, "the cell was closed"))
        while not self._calls.empty():
            self._calls.get()()

    def _ready(self) -> list[MotionHandle]:
        """Return the waiting motions in the motion queue that can start, because no earlier motion uses their
        joints.
        """
        taken = {joint for w in self._running for joint in w.joints}
        ready = []
        for work in self._waiting:
            if not work.joints & taken:
                ready.append(work)
            taken |= work.joints
        return ready

    def _begin(self) -> None:
        with self._lock:
            cancelled = [w for w in self._waiting if w.cancel.is_set()]
            self._waiting = [w for w in self._waiting if not w.cancel.is_set()]
            begun = [w for w in self._ready() if w.job is None]
            for work in begun:
                self._waiting.remove(work)
                self._running.append(work)
        for work in cancelled:
            work.end(STOPPED)
        for work in begun:
            assert work.make is not None
            work.began = self._driver.now
            try:
                work.steps = work.make(_DriverForMotion(self._driver, work.joints), work.cancel)
            except Exception as error:
                self._finish(work, None, error)

    def _step_all(self) -> None:
        """Advance every running motion of the motion queue by one step. If a motion ends, start the motions
        that waited for it, and step them too.

        A motion that waits for another one starts in the driver period in which the other one ends.
        """
        stepped: list[MotionHandle] = []
        while True:
            self._begin()
            due = [w for w in self._running if w.steps is not None and w not in stepped]
            if not due:
                return
            for work in due:
                self._step(work)
            stepped += due

    def _step(self, work: MotionHandle) -> None:
        assert work.steps is not None
        try:
            next(work.steps)
            work.moving = True
        except StopIteration as end:
            self._finish(work, end.value)
        except Exception as error:
            self._finish(work, None, error)

    def _finish(
        self, work: MotionHandle, result: ExecutionResult | None, error: Exception | None = None
    ) -> None:
        with self._lock:
            if work in self._running:
                self._running.remove(work)
        work.end(result, error)


class _DriverForMotion(DriverProxy):
    """Driver proxy that the motion queue passes to one motion. Its method `stop` holds only the joints of
    this motion.

    The other joints continue their motions.
    """

    def __init__(self, driver: Driver, joints: frozenset[str]):
        super().__init__(driver)
        self._joints = joints

    def stop(self) -> None:
        mine = tuple(n for n in self._driver.joint_state().joint_names if n in self._joints)
        if mine:
            self._driver.hold(mine)
