"""Execution of a user's unchanged ROS script in this process, with shims in place of ROS."""

from __future__ import annotations

import os
import runpy
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from armcell import _interrupts
from armcell.cell import Cell, LiveCell
from armcell.core import InputError
from armcell.moveit.install_shims import shims_installed
from armcell.moveit.script_hints import missing_import
from armcell.moveit.session import Session
from armcell.ros import Bus, NameMap, Ros1Settings


def run_script(
    script: Path, live: LiveCell | Cell, arguments: Sequence[str] = (), rate: float = 100.0,
    auto_grip: bool = False, quiet: bool = False, ros1: Ros1Settings | None = None,
    ended: Callable[[int, Session], None] = lambda status, session: None,
    began: Callable[[Session], None] = lambda session: None, bus: Bus | None = None,
    names: NameMap | None = None,
) -> tuple[int, Session]:  # fmt: skip
    """Run an unchanged ROS script to its end, wait for the motions that the script started, and close its
    session.

    Args:
        live: a cell that is not connected yet, or a cell whose robot is another program on the bus (see
            `Session`).
        arguments: the script's command-line arguments, `sys.argv[1:]`.
        rate: rate [Hz] of the published states and clock.
        auto_grip: close a gripper that rests with an object between its open fingers.
        quiet: do not print the script's log lines.
        ros1: join the cell and the script to a ROS 1 graph.
        ended: called with the exit status after the run, while the cell is still connected.
        began: called before the script starts, when the cell is ready and joined.
        bus: the session's bus, if transports are connected to it already.
        names: maps the ROS names of the cell and the script to names on the bus.
    Returns:
        The script's exit status (130 after Ctrl-C, 143 after SIGTERM), and its closed session.
    Raises:
        InputError: the script does not exist.
    """
    if not os.path.isfile(script):
        raise InputError("there is no such script", file=script)
    session = Session(live, rate, auto_grip, quiet, ros1, bus, names)
    argv, path, modules = sys.argv, list(sys.path), set(sys.modules)
    folder = script.resolve().parent
    with session, shims_installed(session.messages) as hidden:
        if hidden:
            session.hint("hidden", f"the installed {', '.join(hidden)} are not used in this run")
        began(session)
        sys.argv = [str(script), *arguments]
        sys.path.insert(0, str(folder))
        try:
            with _interrupts.owned(session.interrupt):
                status = _status(script, session)
            session.hint_at_gripper()
            session.served.stop_motions()
            ended(status, session)
            return status, session
        finally:
            sys.argv, sys.path[:] = argv, path
            _forget(folder, set(sys.modules) - modules)


def _forget(folder: Path, names: set[str]) -> None:
    """Unload the modules that a ROS script imported from its own folder, because the next script may use the
    same module names.
    """

    def beside(name: str) -> bool:
        file = getattr(sys.modules[name.partition(".")[0]], "__file__", None)
        if file is None:
            return False
        where = Path(file).resolve()
        return folder == (where.parent.parent if where.name == "__init__.py" else where.parent)

    for name in [n for n in names if beside(n)]:
        del sys.modules[name]


def _status(script: Path, session: Session) -> int:
    try:
        status = _run(script, session)
    except KeyboardInterrupt:
        session.interrupted = True
    return _interrupts.status() if session.interrupted else status


def _run(script: Path, session: Session) -> int:
    try:
        runpy.run_path(str(script), run_name="__main__")
    except SystemExit as end:
        _finish(session)
        return end.code if isinstance(end.code, int) else 0 if end.code is None else _said(end.code)
    except KeyboardInterrupt:  # includes rospy's ROSInterruptException, which is also an Exception
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        mine = [i for i, f in enumerate(frames) if Path(f.filename).resolve() == script.resolve()]
        shown = frames[mine[0] : mine[-1] + 1] if mine else frames  # hide armcell's own frames from the user
        text = "".join(traceback.format_list(shown))
        print(f"Traceback (most recent call last):\n{text}{type(error).__name__}: {error}", file=sys.stderr)  # noqa: T201
        name = error.name if isinstance(error, NameError) else None
        if name and (line := missing_import(name, session.bus.schema)):
            session.hint(f"import {name}", f"the script uses {name} without importing it: {line}")
        return 1
    _finish(session)
    return 0


def _finish(session: Session) -> None:
    """Wait after running a ROS script until the motions that it started have ended, unless the user pressed
    Ctrl-C.

    The script may have caught the Ctrl-C and ended normally.
    """
    if not session.interrupted:
        session.wait_for_motions()


def _said(text: object) -> int:
    print(text, file=sys.stderr)  # noqa: T201
    return 1
