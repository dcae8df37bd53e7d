"""Runs a compiled program: a main thread and those it starts, each up to its next control step at a time."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Mapping
from typing import Any

from armcell.control.ur_controller.urscript.compiler import compiled
from armcell.control.ur_controller.urscript.parser import parse
from armcell.control.ur_controller.urscript.values import Pose, Vec, copied
from armcell.core import ArmcellError

log = logging.getLogger(__name__)

Thread = Generator[None, None, Any]
MAX_TURNS = 20_000  # of loops between two control steps


class ProgramError(ArmcellError):
    """The program did something a controller stops it for."""


class _Halt(Exception):
    pass


class Machine:
    """One program.

    A script that only defines one function without parameters is that program (as UR's controllers take it);
    otherwise its statements are.
    """

    def __init__(
        self,
        text: str,
        blocking: Mapping[str, Callable[..., Thread]],
        instant: Mapping[str, Callable[..., Any]],
    ):
        statements = parse(text)
        self.name = "unnamed"
        if len(statements) == 1 and statements[0][0] == "def" and not statements[0][3]:
            self.name = statements[0][2]
            statements = statements[0][4]
        code = compiled(statements, blocking, instant)
        space: dict[str, Any] = {
            "Vec": Vec, "Pose": Pose, "copied": copied, "bool": bool, "__builtins__": {},
        }  # fmt: skip
        exec(code, space)  # only what compiler.py writes; names of a script cannot reach Python's
        self.line = 0
        self._turns = 0
        self.variables: dict[str, Any] = {}
        self._threads: dict[int, Thread] = {1: space["main"](self.variables, {}, blocking, instant, self)}
        self._next, self.running = 2, True

    def step(self) -> None:
        """Let every thread run to its next control step.

        Raises:
            ProgramError: with the line.
        """
        for key in list(self._threads):
            thread = self._threads.get(key)
            if thread is None:
                continue
            self._turns = 0
            try:
                next(thread)
            except StopIteration:
                self._threads.pop(key, None)
            except _Halt:
                self._threads.clear()
            except ProgramError:
                raise
            except KeyError as error:
                raise ProgramError(f"line {self.line}: variable {error.args[0]!r} has no value") from None
            except Exception as error:  # whatever a program does, the controller goes on
                raise ProgramError(f"line {self.line}: {error}") from None
            if 1 not in self._threads:  # with the main thread the program ends
                break
        self.running = 1 in self._threads
        if not self.running:
            self._threads.clear()

    # --- called by compiled code ---
    def count(self) -> None:
        self._turns += 1
        if self._turns > MAX_TURNS:
            raise ProgramError(f"line {self.line}: a loop without a wait (add sync() or sleep())")

    def spawn(self, thread: Thread) -> int:
        if len(self._threads) > 50:
            raise ProgramError("more than 50 threads")
        key = self._next
        self._next += 1
        self._threads[key] = thread
        return key

    def kill(self, key: Any) -> None:
        if key != 1:
            thread = self._threads.pop(key, None)
            if thread is not None and not thread.gi_running:  # type: ignore[attr-defined]
                thread.close()

    def join(self, key: Any) -> Thread:
        while key in self._threads:
            yield

    def halt(self) -> None:
        raise _Halt

    def unknown(self, name: str) -> None:
        raise ProgramError(f"line {self.line}: function {name!r} is not known to this controller")
