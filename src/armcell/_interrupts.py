"""Orderly shutdown of the program on SIGINT (Ctrl-C) and SIGTERM.

The module imports nothing slow, so signals are handled from the start of the program. The command line calls
`install`. A program that uses armcell as a library keeps its own signal handlers, and the functions of this
module then have no effect.

A signal raises `Interrupted` in the main thread. Python swallows an exception that is raised in a destructor,
a garbage-collection callback or a ctypes callback, and so does a bare `except:`. Therefore a watcher thread,
which the C-level signal handler wakes through a pipe, also sets an event that `sleep` and `wait` observe,
raises the exception again while the main thread does not handle it, and ends the process if the orderly
shutdown takes too long. A second signal ends the process at once.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

GRACE = 1.5  # [s] for the main thread to handle the exception; it may run compiled code
WITH_ARMS = 15.0  # [s] for arms to come to rest, and for a record and its report to be written
SCRIPT = 3.0  # [s] for a user's script to end by itself
LAST = 2.0  # [s] for all last-will actions together
ONE_SIGNAL = 0.5  # [s]: `timeout`, systemd and docker send a signal to a process and again to its group
LOOK = 0.05  # [s] between two checks whether the exception was swallowed
UNHANDLED = 3  # checks in a row without the exception: it was swallowed
SIGNALS = (signal.SIGINT, signal.SIGTERM)
WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGPIPE: ""}


class Interrupted(KeyboardInterrupt):
    """Exception that is raised in the main thread after a signal (SIGINT, SIGTERM) has asked the program to
    end.
    """


class _Will:
    """Action of last resort (last will), which runs if the orderly shutdown of an interrupted program takes
    too long.
    """

    def __init__(self, act: Callable[[], object], urgent: bool):
        self.act, self.urgent = act, urgent


class _State:
    def __init__(self) -> None:
        self.event = threading.Event()  # set by the watcher: a handler must not take a lock
        self.signal = 0  # number of the first signal
        self.at = 0.0  # [s, monotonic] time of the first signal
        self.raised = False  # the exception was raised in the main thread
        self.again = False  # the watcher asks the handler to raise again
        self.sent = 0  # signals that the watcher itself sent and `_count` has not yet seen
        self.swallowed = False  # Python reported that it swallowed the exception
        self.limit: float | None = None  # [s, monotonic] time limit of an orderly shutdown, see `take_time`
        self.held, self.due = 0, False  # depth of `deferred`; whether an exception is deferred
        self.owner: Callable[[], object] | None = None
        self.wills: list[_Will] = []
        self.wake = -1  # file descriptor that wakes the watcher


_state = _State()


def install() -> None:
    """Install handlers for SIGINT and SIGTERM in the main thread,
    so that these signals shut the program down cleanly.
    """
    wakes, _state.wake = os.pipe()
    os.set_blocking(_state.wake, False)
    threading.Thread(target=_watch, args=(wakes,), name="armcell-signals", daemon=True).start()
    signal.set_wakeup_fd(_state.wake, warn_on_full_buffer=False)
    for number in SIGNALS:
        signal.signal(number, _handler)
    sys.unraisablehook = _unraisable


def uninstall() -> None:
    """Restore the default effect of SIGINT and SIGTERM after a command has finished: these signals then end
    the process at once.
    """
    if _state.wake >= 0:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_DFL)


# --- queries of the program ---
def asked() -> int:
    """Return the number of the signal that interrupted the program, or 0 if no signal has arrived."""
    return _state.signal


def status() -> int:
    """Return the exit status of an interrupted program: 130 after SIGINT, 143 after SIGTERM."""
    return 128 + (_state.signal or signal.SIGINT)


def check() -> None:
    """Raise `Interrupted` again in the main thread if Python or a library has swallowed this exception.

    Nothing is raised after `take_time`, inside `owned` or `deferred`, or while the exception is being
    handled.
    """
    if (
        _state.signal
        and _state.limit is None
        and _state.owner is None
        and not _state.held
        and threading.current_thread() is threading.main_thread()
        and not _is_ours(sys.exc_info()[1])
    ):
        _state.raised = True  # the handler, which may still run, need not raise
        raise Interrupted


def sleep(seconds: float) -> None:
    """Sleep like `time.sleep`, but wake up early when the program is interrupted (SIGINT or SIGTERM).

    Raises:
        Interrupted: see `check`.
    """
    if _state.wake < 0 or threading.current_thread() is not threading.main_thread():
        time.sleep(seconds)
        return
    check()
    if _state.event.is_set():  # an orderly shutdown may sleep
        time.sleep(seconds)
    else:
        _state.event.wait(seconds)
        check()


def wait(condition: Callable[[float], bool], timeout: float | None = None) -> bool:
    """Call `condition(seconds)`, for example `Event.wait`, repeatedly until it returns a true value, the
    timeout passes or a signal interrupts the wait.

    Signals interrupt the wait.

    Raises:
        Interrupted: see `check`.
    """
    end = None if timeout is None else time.monotonic() + timeout
    while True:
        check()
        left = LOOK if end is None else min(LOOK, max(end - time.monotonic(), 0.0))
        if condition(left):
            return True
        if end is not None and time.monotonic() >= end:
            check()
            return False


# --- requests and declarations of the program ---
def ask(number: int) -> None:
    """Interrupt the program from any thread as if a signal had arrived, so that it shuts down cleanly.

    Without a command line, the function has no effect.
    """
    if _state.wake >= 0:
        _request(number)
        _wake()


def take_time(seconds: float = WITH_ARMS) -> None:
    """Extend the time limit of the orderly shutdown; call this function after catching `Interrupted`.

    Without a signal, the function has no effect.
    """
    if _state.signal:
        _state.limit = time.monotonic() + seconds


@contextlib.contextmanager
def owned(on_signal: Callable[[], object]) -> Iterator[None]:
    """Let signals interrupt a user's script that runs inside the `with` block.
    After a signal, the script has `SCRIPT` seconds to end.

    The script may catch `Interrupted`.

    Args:
        on_signal: called in another thread when a signal arrives; must return quickly.
    """
    _state.owner = on_signal
    try:
        yield
    finally:
        _state.owner = None
        if _state.signal and _state.limit is None:
            take_time()


@contextlib.contextmanager
def deferred() -> Iterator[None]:
    """Defer the exception `Interrupted` to the end of the `with` block."""
    main = threading.current_thread() is threading.main_thread()
    _state.held += main
    try:
        yield
    finally:
        _state.held -= main
    if main and _state.due and not _state.held:
        _state.due = False
        check()


@contextlib.contextmanager
def unsignaled() -> Iterator[None]:
    """Protect child processes from signals: SIGINT and SIGTERM do not reach processes that are started inside
    the `with` block.

    Ctrl-C sends SIGINT to the whole process group, but this program decides when its helper processes end.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def silent_helpers() -> Iterator[None]:
    """Protect processes that are started inside the `with` block from interrupts (SIGINT, SIGTERM), and
    discard their error output.

    The import of glfw starts a process for each library that it finds, and the process prints a traceback if
    this process ends first. glfw starts no process if PYGLFW_LIBRARY names a library, such as the one in
    glfw's wheel.
    """
    import subprocess
    from importlib.util import find_spec

    class Silent(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *args: Any, **kwargs: Any):
            super().__init__(*args, **{"stderr": subprocess.DEVNULL, **kwargs})

    glfw = find_spec("glfw")
    bundled = os.path.join(os.path.dirname((glfw and glfw.origin) or ""), "x11", "libglfw.so")
    unset = "PYGLFW_LIBRARY" not in os.environ and os.path.isfile(bundled)
    before = subprocess.Popen
    subprocess.Popen = Silent  # type: ignore[misc]
    if unset and os.environ.get("XDG_SESSION_TYPE") != "wayland":
        os.environ["PYGLFW_LIBRARY"] = bundled
    try:
        with unsignaled():
            yield
    finally:
        subprocess.Popen = before  # type: ignore[misc]
        if unset:
            os.environ.pop("PYGLFW_LIBRARY", None)


class SteadyLock:
    """Reentrant lock that defers the exception `Interrupted` while it is held, so that the guarded work is
    completed.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._deferred: list[Any] = []

    def __enter__(self) -> None:
        block = deferred()
        block.__enter__()
        self._lock.acquire()
        self._deferred.append(block)

    def __exit__(self, *exc: object) -> None:
        block = self._deferred.pop()
        self._lock.release()
        block.__exit__(None, None, None)


def last_will(act: Callable[[], object], urgent: bool = False) -> Callable[[], None]:
    """Register an action of last resort (last will), which runs if the orderly shutdown of an interrupted
    program takes too long.

    Without a command line, nothing is registered.

    Args:
        act: called from another thread, possibly while the rest of the program still runs, or after the
            program has already done the same work.
        urgent: also run the action at a second signal; for arms that must stop.
    Returns:
        A function that revokes the action.
    """
    will = _Will(act, urgent)
    if _state.wake >= 0:
        _state.wills.append(will)

    def revoke() -> None:
        with contextlib.suppress(ValueError):
            _state.wills.remove(will)

    return revoke


def end(number: int | None = None) -> None:
    """Print which signal interrupted the program, then end the process
    without running the exit handlers of libraries.

    An exit handler could block.
    """
    if number is None:
        number = _state.signal or signal.SIGINT
    if word := WORDS.get(signal.Signals(number), ""):
        with contextlib.suppress(OSError):  # not by sys.stderr: a thread that holds its lock may be blocked
            os.write(2, f"armcell: {word}\n".encode())
    os._exit(128 + number)


# --- the handler ---
def _handler(number: int, frame: FrameType | None) -> None:
    """Handle SIGINT or SIGTERM in the main thread: raise `Interrupted`,
    or postpone it until the end of a `deferred` block.
    """
    if not _state.wills and _importing(frame):  # libraries with optional imports swallow all exceptions
        end(number)
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it logs the interrupts that it swallows
    _request(number)
    if _state.raised and not _state.again:
        return
    _state.raised, _state.again = True, False
    if _state.held:
        _state.due = True
        return
    raise Interrupted


def _request(number: int) -> None:
    if not _state.signal:
        _state.at, _state.signal = time.monotonic(), number


def _wake() -> None:
    with contextlib.suppress(OSError):
        os.write(_state.wake, b"\0")


def _importing(frame: FrameType | None) -> bool:
    """Return whether a signal interrupted the program during an import statement."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def _is_ours(error: BaseException | None) -> bool:
    """Return whether an exception is `Interrupted`, or was raised while `Interrupted` was being handled."""
    seen = 0
    while error is not None and seen < 100:
        if isinstance(error, Interrupted):
            return True
        error, seen = error.__context__, seen + 1
    return False


def _unraisable(report: Any) -> None:
    """Record that Python ignored an `Interrupted` exception, for example an exception raised in a destructor.
    armcell installs this function as `sys.unraisablehook`.
    """
    if _is_ours(report.exc_value):
        _state.swallowed = True
    else:
        sys.__unraisablehook__(report)


# --- the watcher ---
def _watch(wakes: int) -> None:
    """Wait in the watcher thread for the first interrupt, then make sure that the program ends."""
    while not _state.signal:
        for number in os.read(wakes, 64):
            if _ours(number):
                _request(number)
    _state.event.set()
    threading.Thread(target=_count, args=(wakes,), name="armcell-signals-2", daemon=True).start()
    if (owner := _state.owner) is not None:
        with contextlib.suppress(Exception):
            owner()
    unhandled = 0
    while time.monotonic() < _deadline():
        time.sleep(LOOK)
        handled = _handled()
        unhandled = 0 if handled else unhandled + 1
        lost = _state.swallowed or (unhandled >= UNHANDLED and _state.owner is None)
        if lost and _state.limit is None and not _state.held:
            _state.swallowed, unhandled = False, 0
            _raise_again()
    _do(lambda will: True, LAST)
    end()


def _ours(number: int) -> bool:
    """Return whether a byte from the signal wake-up pipe stands for a signal that armcell handles."""
    return number in SIGNALS and signal.getsignal(number) is _handler


def _count(wakes: int) -> None:
    """End the process when the second interrupt arrives. Signals that `_raise_again` sends do not count."""
    while True:
        for number in os.read(wakes, 64):
            if _ours(number):
                if _state.sent > 0:
                    _state.sent -= 1
                elif time.monotonic() > _state.at + ONE_SIGNAL:
                    _do(lambda will: will.urgent, ONE_SIGNAL)
                    end()


def _deadline() -> float:
    if _state.limit is not None:
        return _state.limit
    if _state.owner is not None:
        return _state.at + SCRIPT
    return _state.at + (WITH_ARMS if _state.held or _handled() else GRACE)


def _handled() -> bool:
    """Return whether the main thread is currently handling the exception `Interrupted`.

    The thread is then in an `except`, a `finally` or an `__exit__`.
    """
    now = sys._current_exceptions().get(threading.main_thread().ident or 0)
    return _is_ours(now[1] if isinstance(now, tuple) else now)  # a tuple until Python 3.11


def _raise_again() -> None:
    """Send a signal to the main thread, so that the handler of interrupts raises `Interrupted` again."""
    number = next((n for n in SIGNALS if signal.getsignal(n) is _handler), None)
    if number is not None:
        _state.again = True
        _state.sent += 1
        signal.pthread_kill(threading.main_thread().ident or 0, number)


def _do(which: Callable[[_Will], bool], seconds: float) -> None:
    """Run the selected cleanup actions of an interrupted program in parallel threads. Wait for them at most
    `seconds` [s].
    """

    def run(act: Callable[[], object]) -> threading.Thread:
        def quietly() -> None:
            with contextlib.suppress(Exception):
                act()

        thread = threading.Thread(target=quietly, name="armcell-last-will", daemon=True)
        thread.start()
        return thread

    until = time.monotonic() + seconds
    acts = [will.act for will in _state.wills if which(will)]
    for thread in [run(act) for act in (*acts, sys.stdout.flush)]:
        thread.join(max(until - time.monotonic(), 0.0))
