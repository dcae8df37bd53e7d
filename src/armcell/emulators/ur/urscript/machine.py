"""Execution of compiled URScript programs, all threads in turn up to the next control step."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Mapping
from functools import partial
from typing import Any

from armcell.core import ArmcellError
from armcell.emulators.ur.urscript.compiler import compile_script
from armcell.emulators.ur.urscript.parser import parse
from armcell.emulators.ur.urscript.values import Pose, Vec, copy_value

log = logging.getLogger(__name__)

Thread = Generator[None, None, Any]
MAX_TURNS = 20_000  # largest number of loop iterations between two control steps


class ProgramError(ArmcellError):
    """Runtime error in the URScript machine, which stops the program.

    Attributes:
        line: line in the script's text, from 1.
    """

    def __init__(self, reason: str, line: int = 0):
        self.line = line
        super().__init__(f"line {line}: {reason}" if line else reason)


class _Halt(Exception):
    pass


def _takes_time(name: str, *_: Any, **__: Any) -> Thread:
    raise ProgramError(f"{name} takes time, which a secondary program must not")


class Machine:
    """Machine that runs a compiled URScript program with its threads and variables.

    If the script consists of a single function definition without parameters, that function is the program
    (as on UR's controllers); otherwise the statements of the script are.

    Attributes:
        secondary: True for a `sec` program, which runs next to the main program and must not take time.
        line: line that is being executed, from 1.
    """

    def __init__(
        self,
        text: str,
        blocking: Mapping[str, Callable[..., Thread]],
        instant: Mapping[str, Callable[..., Any]],
    ):
        statements = parse(text)
        self.name = "unnamed"
        self.secondary = len(statements) == 1 and statements[0][0] == "def" and statements[0][1] == "sec"
        if len(statements) == 1 and statements[0][0] == "def" and not statements[0][3]:
            self.name = statements[0][2]
            statements = statements[0][4]
        if self.secondary:
            blocking = {name: partial(_takes_time, name) for name in blocking}
        code = compile_script(statements, blocking, instant)
        space: dict[str, Any] = {
            "Vec": Vec, "Pose": Pose, "copied": copy_value, "bool": bool, "__builtins__": {},
        }  # fmt: skip
        exec(code, space)  # safe: the code comes from compiler.py, and script names cannot reach Python names
        self.line = 0
        self._turns = 0
        self.variables: dict[str, Any] = {}
        self._threads: dict[int, Thread] = {1: space["main"](self.variables, {}, blocking, instant, self)}
        self._next, self.running = 2, True

    def step(self) -> None:
        """Run every thread of the program in the URScript machine up to its next control step.

        Raises:
            ProgramError: a runtime error, with its line.
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
            except ProgramError as error:
                raise (error if error.line else ProgramError(str(error), self.line)) from None
            except KeyError as error:
                raise ProgramError(f"variable {error.args[0]!r} has no value", self.line) from None
            except Exception as error:  # no program error may stop the controller
                raise ProgramError(str(error), self.line) from None
            if 1 not in self._threads:  # the program ends with its main thread
                break
        self.running = 1 in self._threads
        if not self.running:
            self._threads.clear()

    # --- called by compiled code ---
    def count(self) -> None:
        self._turns += 1
        if self._turns > MAX_TURNS:
            raise ProgramError("a loop without a wait (add sync() or sleep())", self.line)

    def spawn(self, thread: Thread) -> int:
        if len(self._threads) > 50:
            raise ProgramError("more than 50 threads", self.line)
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

    def fail_unknown_function(self, name: str) -> None:
        raise ProgramError(f"this emulator does not have the function {name!r}", self.line)
