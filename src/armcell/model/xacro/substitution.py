"""Xacro substitution arguments `$(arg)`, `$(find)`, `$(env)`, `$(eval)` and similar.

The module also supports `$(optenv)`, `$(dirname)` and `$(cwd)`.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from armcell.model.xacro.budget import Budget, Function, XacroError
from armcell.model.xacro.expressions import NameSpace, evaluate
from armcell.model.xacro.files import RobotFiles
from armcell.model.xacro.functions import BASIC, MATH, plain, text_of
from armcell.model.xacro.scope import Arguments, typed

ENV_CURE = "if you trust this file: armcell --allow-env COMMAND ..., or allow_env=True in Python"


ARGUMENT = re.compile(r"\$\(arg\s+([^\s)]+)\s*\)")


class MissingArgument(XacroError):
    """Error for a xacro substitution argument that has neither a value nor a default."""

    def __init__(self, name: str):
        super().__init__(f"argument {name!r} has no value", missing_hint([name]))
        self.name = name


def missing_hint(names: list[str]) -> str:
    """Return a hint on how to pass values for the substitution arguments of a xacro file."""
    options = " ".join(f"--xacro-arg {name}:=VALUE" for name in names)
    entries = ", ".join(f"{name}: VALUE" for name in names)
    return f"pass {options}, or write 'xacro_args: {{{entries}}}' in the cell file"


class Substitution:
    """Evaluator for xacro's substitution arguments, which are the texts inside `$(...)`.

    Args:
        files: reader of the robot's files, which finds packages.
        budget: remaining operations of the robot file.
        values: values of `$(arg)` by name; `<xacro:arg>` adds defaults.
        allow_env: whether the file may read environment variables, which may hold secrets.
    """

    def __init__(self, files: RobotFiles, budget: Budget, values: dict[str, str], allow_env: bool):
        self.files, self.budget, self.values, self.allow_env = files, budget, values, allow_env
        self.declared: set[str] = set()  # arguments that the file declares or uses
        functions = {
            "arg": lambda name: typed(self.arg(name)),
            "dirname": lambda: str(files.main.parent),
            "env": self.env,
            "find": lambda package: str(files.find(package)),
            "optenv": self.optional_env,
        }
        own = {name: plain(name, function) for name, function in functions.items()}
        types = {name: value for name, value in BASIC.items() if isinstance(value, Function) and value.type}
        names = {**MATH, **types, "map": BASIC["map"], **own, "true": True, "false": False}
        self._names = Arguments(NameSpace({**names, "True": True, "False": False}), values)

    def resolve(self, inside: str, folder: Path) -> str:
        """Return the text that replaces a substitution argument `$(inside)` in a xacro file.

        Args:
            inside: a command and its arguments, for example `find my_robot`.
            folder: folder of the file that contains the text.
        Raises:
            XacroError: the command, argument or package is unknown, or an environment variable is not
                permitted.
        """
        command, _, rest = inside.strip().partition(" ")
        words = rest.split()
        match command, len(words):
            case "eval", n if n > 0:
                return text_of(evaluate(rest, self._names, self.budget))
            case "arg", 1:
                return self.arg(words[0])
            case "find", 1:
                return str(self.files.find(words[0]))
            case "env", 1:
                return self.env(words[0])
            case "optenv", n if n > 0:
                return self.optional_env(words[0], " ".join(words[1:]))
            case "dirname", 0:
                return str(folder)
            case "cwd", 0:
                return str(self.files.main.parent)
        raise XacroError(
            f"$({inside}) is not a substitution argument",
            "use $(arg NAME), $(find PACKAGE), $(dirname), $(env NAME), $(optenv NAME DEFAULT), $(eval ...)",
        )

    def arg(self, name: str) -> str:
        self.declared.add(name)
        if name not in self.values:
            raise MissingArgument(name)
        return self.values[name]

    def env(self, name: str) -> str:
        found = self.optional_env(name, None)
        if found is None:
            raise XacroError(f"environment variable {name!r} is not set")
        return found

    def optional_env(self, name: str, default: Any = "") -> Any:
        if not self.allow_env:
            raise XacroError(
                f"the file reads the environment variable {name!r}, which needs permission", ENV_CURE
            )
        return os.environ.get(name, default)
