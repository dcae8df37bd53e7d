"""Execution of a user's unchanged ROS script in this process; installation of the shims in place of ROS."""

from __future__ import annotations

import importlib
import importlib.util
import os
import runpy
import sys
import traceback
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from armcell import _interrupts
from armcell.cell import Cell, LiveCell
from armcell.core import InputError, UnknownNameError
from armcell.moveit.message_classes import MessageClasses
from armcell.moveit.script_hints import MESSAGES, missing_import
from armcell.moveit.session import Session, current_session
from armcell.ros import Bus, NameMap, Ros1Settings

SHIMS = {
    "rospy": "rospy",
    "actionlib": "actionlib",
    "genpy": "genpy",
    "tf": "tf",
    "tf.transformations": "transformations",
    "tf2_ros": "tf2_ros",
    "tf2_geometry_msgs": "tf2_geometry_msgs",
    "moveit_commander": "moveit_commander",
    "moveit_commander.conversions": "moveit_commander.conversions",
    "moveit_commander.exception": "moveit_commander.exception",
    "moveit_commander.move_group": "moveit_commander.move_group",
    "moveit_commander.planning_scene_interface": "moveit_commander.planning_scene_interface",
    "moveit_commander.robot": "moveit_commander.robot",
    "moveit_commander.roscpp_initializer": "moveit_commander.roscpp_initializer",
}

"""Module name that a script imports -> module in `armcell.moveit.shims`."""


class _MessageModule(types.ModuleType):
    """Module that a running ROS script imports as `<package>.msg` or `<package>.srv` of a ROS message
    package. It creates each message class on first access.
    """

    def __init__(self, name: str, classes: MessageClasses, package: str, kinds: list[str]):
        super().__init__(name)
        self._classes, self._package, self._kinds = classes, package, kinds
        self.__all__ = kinds

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        full = f"{self._package}/{name}"
        if full in MESSAGES:
            meant = MESSAGES[full]
            current_session().hint(
                full,
                f"MoveIt has no {full}; armcell takes it as {meant}: import {meant.split('/')[1]} instead",
            )
            return self._classes[meant]
        if self.__name__.endswith(".msg") and full in self._classes.schema.services:
            current_session().hint(
                full, f"{name} is a service; in ROS, write: from {self._package}.srv import {name}"
            )
            return _service_class(self._classes, full)
        if name not in self._kinds:
            known = [k for k in self._kinds if not k.startswith("_")]
            raise AttributeError(str(UnknownNameError(f"type of {self.__name__}", name, known)))
        value = (
            _service_class(self._classes, f"{self._package}/{name}")
            or self._classes[f"{self._package}/{name}"]
        )
        setattr(self, name, value)
        return value

    def __dir__(self) -> list[str]:
        return self._kinds


def _service_class(classes: MessageClasses, name: str) -> type | None:
    """Return the class of a ROS service for a module that a running script imports. It contains the request
    class and the response class of the service.

    Returns:
        The class, or None if the name is not a service.
    """
    if name not in classes.schema.services:
        return None
    request, response = classes[f"{name}Request"], classes[f"{name}Response"]
    return type(
        name.split("/")[1], (),
        {
            "_type": name, "_md5sum": classes.schema.md5(name),
            "_request_class": request, "_response_class": response, "Request": request, "Response": response,
        },
    )  # fmt: skip


def message_modules(classes: MessageClasses) -> dict[str, types.ModuleType]:
    """Create the modules of all ROS message packages that a script can import when it is run, with their
    `.msg` and `.srv` submodules.
    """
    schema = classes.schema
    parts = {f"{s}{end}" for s in schema.services for end in ("Request", "Response")}
    found: dict[str, types.ModuleType] = {}
    for kind, names in (
        ("msg", [n for n in schema.messages if n not in parts]),
        ("srv", [*schema.services, *parts]),
    ):
        for package in sorted({n.split("/")[0] for n in names}):
            own = sorted(n.split("/")[1] for n in names if n.split("/")[0] == package)
            outer = found.setdefault(package, types.ModuleType(package))
            outer.__path__ = []  # type: ignore[attr-defined]  # marks the module as a package
            inner = _MessageModule(f"{package}.{kind}", classes, package, own)
            found[inner.__name__] = inner
            setattr(outer, kind, inner)
    return found


@contextmanager
def shims_installed(classes: MessageClasses) -> Iterator[list[str]]:
    """Install the ROS shims (rospy, moveit_commander, tf, ...) in `sys.modules` during a `with` block that
    runs a script.

    The previous modules are restored after the block.

    Yields:
        Names of installed packages that the shims hide during the block.
    """
    modules: dict[str, types.ModuleType] = message_modules(classes)
    for name, file in SHIMS.items():
        modules[name] = importlib.import_module(f"armcell.moveit.shims.{file}")
    before = {n: sys.modules[n] for n in modules if n in sys.modules}
    hidden = sorted(n for n in modules if "." not in n and (n in before or importlib.util.find_spec(n)))
    sys.modules.update(modules)
    try:
        yield hidden
    finally:
        for name in modules:
            sys.modules.pop(name, None)
        sys.modules.update(before)


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
