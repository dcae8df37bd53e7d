"""Running a user's script against a cell: unchanged, in this process, with the shims in place of ROS."""

from __future__ import annotations

import runpy
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from armcell import _interrupts
from armcell.cell import LiveCell
from armcell.core import InputError
from armcell.moveit.install import installed
from armcell.moveit.lint import closes_gripper_itself
from armcell.moveit.session import Session
from armcell.ros import Ros1Settings


def run_script(
    script: Path, live: LiveCell, arguments: Sequence[str] = (), rate: float = 100.0,
    auto_grip: bool = False, quiet: bool = False, ros1: Ros1Settings | None = None,
    ended: Callable[[int, Session], None] = lambda status, session: None,
    began: Callable[[Session], None] = lambda session: None,
) -> tuple[int, Session]:  # fmt: skip
    """Run a script to its end, with the motions that it has begun; then leave nothing running.

    Args:
        live: a cell that is not connected yet.
        arguments: its own, `sys.argv[1:]`.
        auto_grip: close a gripper that rests with an object between its open fingers.
        ros1: join the cell and the script to a ROS 1 graph.
        ended: called with the exit status when all is over, while the cell is still connected.
        began: called when the cell is ready and joined, before the script.
    Returns:
        The script's exit status (130 after Ctrl-C, 143 after SIGTERM), and the session it ran in, closed.
    Raises:
        InputError: there is no such script.
    """
    if not script.is_file():
        raise InputError("there is no such script", file=script)
    session = Session(live, rate, auto_grip, quiet, ros1)
    argv, path, modules = sys.argv, list(sys.path), set(sys.modules)
    folder = script.resolve().parent
    with session, installed(session.messages) as hidden:
        if hidden:
            session.hint("hidden", f"the installed {', '.join(hidden)} are not used in this run")
        began(session)
        sys.argv = [str(script), *arguments]
        sys.path.insert(0, str(folder))
        try:
            with _interrupts.owned(session.interrupt):
                status = _status(script, session)
            if not closes_gripper_itself(script):
                session.hint_at_gripper()
            session.served.rest()
            ended(status, session)
            return status, session
        finally:
            sys.argv, sys.path[:] = argv, path
            _forget(folder, set(sys.modules) - modules)


def _forget(folder: Path, names: set[str]) -> None:
    """Modules and packages beside the script: those of the next script may have the same names."""

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
    except KeyboardInterrupt:  # rospy's ROSInterruptException is one, and an Exception as well
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        mine = [i for i, f in enumerate(frames) if Path(f.filename).resolve() == script.resolve()]
        shown = frames[mine[0] : mine[-1] + 1] if mine else frames  # what is ours helps nobody
        text = "".join(traceback.format_list(shown))
        print(f"Traceback (most recent call last):\n{text}{type(error).__name__}: {error}", file=sys.stderr)  # noqa: T201
        return 1
    _finish(session)
    return 0


def _finish(session: Session) -> None:
    """Wait for the motions that the script has begun; not after Ctrl-C, which it may have caught."""
    if not session.interrupted:
        session.finish()


def _said(text: object) -> int:
    print(text, file=sys.stderr)  # noqa: T201
    return 1
