"""Cooperative scheduling of several programs on one robot clock; one program runs at a time.

Each program gets its own `ArmDriver`. A program that lets time pass yields to the next one; when all programs
wait, the robot's clock advances to the earliest wake-up time. Programs for several arms can therefore run
concurrently as plain blocking code, and in simulation the same programs always produce the same run.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Self

from armcell.drivers import Driver, DriverProxy

EPSILON = 1e-9  # [s]


class _Ended(BaseException):
    """Exception that ends a waiting program of the cooperative scheduler after another program has failed.

    It is a BaseException, so that no handler in the program stops it.
    """


class CooperativeScheduler:
    """Scheduler for several programs that share the clock of one driver; only one program runs at a time.

    See `run_cooperatively`.
    """

    def __init__(self, driver: Driver, names: Iterable[str]):
        self.driver = driver
        self.names = tuple(names)
        self._wake = dict.fromkeys(self.names, driver.now)
        # A program waits by acquiring its lock, which another thread releases: faster than a semaphore.
        self._turns = {name: threading.Lock() for name in self.names}
        for turn in self._turns.values():
            turn.acquire()
        self._done = threading.Event()
        self.failed: BaseException | None = None

    def start(self) -> None:
        self._turns[self.names[0]].release()

    def wait_until_scheduled(self, name: str) -> None:
        self._turns[name].acquire()
        if self.failed is not None:
            raise _Ended

    def sleep(self, name: str, duration: float) -> None:
        """Suspend one program of the scheduler for `duration` [s] of driver time, and let the other programs
        run.
        """
        self._wake[name] = self.driver.now + duration
        self._pass_on(name)
        self.wait_until_scheduled(name)

    def finish(self, name: str, error: BaseException | None = None) -> None:
        """Remove a finished program from the cooperative scheduler. If it ended with an error, all other
        programs end, too.
        """
        if error is not None and not isinstance(error, _Ended) and self.failed is None:
            self.failed = error
        del self._wake[name]
        if not self._wake:
            self._done.set()
        elif self.failed is not None:
            self._turns[next(iter(self._wake))].release()
        else:
            try:
                self._pass_on(name)
            except BaseException as broken:  # the driver failed: the other programs must end too
                self.failed = broken
                self._turns[next(iter(self._wake))].release()

    def wait_until_done(self) -> None:
        self._done.wait()

    def _pass_on(self, name: str) -> None:
        soonest, now = min(self._wake.values()), self.driver.now
        if soonest > now + EPSILON:
            self.driver.advance(soonest - now)
            now = max(self.driver.now, soonest)
        due = now + EPSILON
        at = self.names.index(name)
        for other in (*self.names[at + 1 :], *self.names[: at + 1]):
            if self._wake.get(other, math.inf) <= due:
                self._turns[other].release()
                return


class ArmDriver(DriverProxy):
    """Driver proxy for one of several programs that run concurrently on the same robot. The cooperative
    scheduler creates one proxy per program.

    A sleep lets time pass for all programs; `stop` acts on the program's own joints.
    """

    def __init__(self, scheduler: CooperativeScheduler, name: str, joint_names: tuple[str, ...]):
        super().__init__(scheduler.driver)
        self._scheduler, self._me, self._joints = scheduler, name, joint_names

    def __enter__(self) -> Self:
        return self  # the driver is connected

    def __exit__(self, *exc: object) -> None:
        return None

    def advance(self, duration: float) -> None:
        self._scheduler.sleep(self._me, duration)

    def stop(self) -> None:
        self.hold(self._joints)


def run_cooperatively(
    driver: Driver, joints: Mapping[str, tuple[str, ...]], programs: Mapping[str, Callable[[ArmDriver], None]]
) -> None:
    """Run several programs on one driver by cooperative scheduling, and return when all of them have ended.

    Args:
        joints: program name to the joints that its `stop` holds.
        programs: program name to the function to run, called with its driver.
    Raises:
        BaseException: the first exception that a program raised, after the robot has been stopped.
    """
    scheduler = CooperativeScheduler(driver, programs)

    def run(name: str) -> None:
        error: BaseException | None = None
        try:
            scheduler.wait_until_scheduled(name)
            programs[name](ArmDriver(scheduler, name, joints[name]))
        except BaseException as raised:
            error = raised
        scheduler.finish(name, error)

    threads = [threading.Thread(target=run, args=(n,), name=f"armcell {n}", daemon=True) for n in programs]
    for thread in threads:
        thread.start()
    scheduler.start()
    try:
        scheduler.wait_until_done()
    except BaseException as error:  # an interrupt: every program ends at its next sleep
        scheduler.failed = scheduler.failed or error
        scheduler.wait_until_done()
    for thread in threads:
        thread.join()
    if scheduler.failed is not None:
        driver.stop()
        raise scheduler.failed
