"""Xacro scopes: properties, macro parameters, text with `${...}`, and substitution arguments `$(...)`.

The supported forms of a macro's `params` are `name`, `name:=default`, `name:=^`, `name:=^|default` and
`*block`. The substitution arguments are `$(arg)`, `$(find)`, `$(env)`, `$(optenv)`, `$(eval)`,
`$(dirname)` and `$(cwd)`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armcell.model.xacro.budget import Budget, Function, XacroError
from armcell.model.xacro.elements import Element
from armcell.model.xacro.expressions import Names, NameSpace, evaluate
from armcell.model.xacro.files import RobotFiles
from armcell.model.xacro.functions import BASIC, MATH, MAX_DIGITS, plain, text_of

TOKEN = re.compile(
    r"(?P<escaped>\$\$+[{(])"  # $${ is an escaped ${
    r"|\$\{(?P<expression>[^}]*)\}"
    r"|\$\((?P<extension>[^)]*)\)"
    r"|(?P<text>[^$]+|\$[^{($]+|\$$)"
)

Substitute = Callable[[str, "Scope"], str]
MAX_PARAMETERS = 10_000  # characters
# Every alternative is one character or one quoted text, so matching never backtracks for long.
_WITH_DEFAULT = re.compile(
    r"\s*(?P<name>[^\s:=]+)\s*:?=\s*(?P<forward>\^\|?)?"
    r"(?P<default>\$\{.*?\}(?=\s|$)|\$\(.*?\)(?=\s|$)|(?:'[^']*'|\"[^\"]*\"|[^\s'\"])*)(?=\s|$)"
)
_NAME = re.compile(r"\s*(?P<name>\S+)")
ENV_CURE = "if you trust this file: armcell --allow-env COMMAND ..., or allow_env=True in Python"
ARGUMENT = re.compile(r"\$\(arg\s+([^\s)]+)\s*\)")


class Scope:
    """Properties of a xacro file or of one macro call. Missing properties are looked up in the outer scopes.

    Args:
        budget: remaining operations of the robot file.
        substitute: function that evaluates the inside of `$(...)`.
        around: the outer scope: that of the file or of the macro's caller. None for the built-in names.
        name_space: whether the scope belongs to a file that is included with `ns`.
    """

    def __init__(
        self,
        budget: Budget,
        substitute: Substitute,
        around: Scope | None = None,
        name_space: bool = False,
    ):
        self.budget, self.substitute, self.around, self.name_space = budget, substitute, around, name_space
        self.values: dict[str, Any] = {}
        self._texts: set[str] = set()  # lazy properties that are not evaluated yet
        self._open: list[str] = []  # lazy properties that are being evaluated

    def inner(self, name_space: bool = False) -> Scope:
        return Scope(self.budget, self.substitute, self, name_space)

    @property
    def outermost(self) -> Scope:
        """Return the outermost xacro scope. It belongs to the file itself and not to a macro."""
        scope = self
        while scope.around is not None and scope.around.around is not None:
            scope = scope.around
        return scope

    def __contains__(self, name: str) -> bool:
        return self._holder(name) is not None

    def _holder(self, name: str) -> Scope | None:
        scope: Scope | None = self
        while scope is not None and name not in scope.values:
            scope = scope.around
        return scope

    def lookup(self, name: str) -> Any:
        """Return the value of a xacro property from this scope or from an outer scope.

        A lazy property's text is evaluated at its first use, in the scope that holds the property.

        Raises:
            KeyError: the property does not exist.
            XacroError: the definition of the property refers to itself.
        """
        scope = self._holder(name)
        if scope is None:
            raise KeyError(name)
        if name in scope._texts:
            if name in scope._open:
                circle = " -> ".join([*scope._open, name])
                raise XacroError(
                    f"circular variable definition: {circle}", 'lazy_eval="false" takes the value of now'
                )
            scope._open.append(name)
            scope.values[name] = literal(evaluate_text(scope.values[name], scope))
            scope._texts.discard(name)
            scope._open.pop()
        return scope.values[name]

    def put(self, name: str, value: Any, lazy: bool = False) -> None:
        """Set a xacro property in this scope. If `lazy`, its text is evaluated at the first use."""
        value = literal(value)
        self.values[name] = value
        if lazy and isinstance(value, str):
            self._texts.add(name)
        else:
            self._texts.discard(name)

    def remove(self, name: str) -> None:
        scope: Scope | None = self
        while scope is not None and scope.around is not None:
            scope.values.pop(name, None)
            scope = scope.around


def evaluate_text(text: str, scope: Scope) -> Any:
    """Evaluate a text that contains `${...}` and `$(...)` with the names of a xacro scope. A text that is a
    single expression keeps the type of its value.

    Raises:
        XacroError: an expression fails (see `evaluate`), or a `$` starts neither form.
    """
    scope.budget.charge(1 + len(text) // 64)
    found, at = [], 0
    while at < len(text):
        token = TOKEN.match(text, at)
        if token is None:
            raise XacroError(f"invalid expression: {text[at : at + 40]}")
        at = token.end()
        if token["escaped"]:
            found.append(token["escaped"][1:])
        elif token["expression"] is not None:
            inside = evaluate_text(token["expression"], scope)
            found.append(evaluate(text_of(inside), scope, scope.budget))
        elif token["extension"] is not None:
            found.append(scope.substitute(text_of(evaluate_text(token["extension"], scope)), scope))
        else:
            found.append(token["text"])
    if len(found) == 1:
        return found[0]
    scope.budget.charge(len(found))
    return scope.budget.charge_value("".join(text_of(each) for each in found))


def literal(value: Any) -> Any:
    """Convert the text of a property in a xacro scope to an int, float or bool if possible."""
    if not isinstance(value, str):
        return value
    if len(value) >= 2 and value[0] == value[-1] == "'":
        return value[1:-1]
    if "_" in value or len(value) > MAX_DIGITS:  # Python would parse 1_000 as a number
        return value
    for read in (int, float, truth):
        try:
            return read(value)
        except (ValueError, XacroError):
            pass
    return value


def truth(value: Any, text: str | None = None) -> bool:
    """Return the condition of a xacro element, evaluated in its scope, as a boolean.

    Args:
        value: the evaluated condition.
        text: the condition as written in the file, for the error message.
    Raises:
        XacroError: the value is a text other than true, false or an integer.
    """
    if not isinstance(value, str):
        return bool(value)
    if value in ("true", "True", "false", "False"):
        return value in ("true", "True")
    try:
        return bool(int(value))
    except ValueError:
        raise XacroError(
            f"condition {text or value!r} is {value!r}, which is neither true nor false"
        ) from None


class Arguments:
    """Names that an expression `$(eval ...)` can use in its xacro scope: built-in names, and the values of
    `$(arg NAME)`.
    """

    def __init__(self, scope: Names, values: dict[str, str]):
        self.scope, self.values = scope, values

    def lookup(self, name: str) -> Any:
        try:
            return self.scope.lookup(name)
        except KeyError:
            return typed(self.values[name])


def typed(value: str) -> Any:
    """Convert the value of an argument `$(arg)`, for its use in a xacro scope, to an int, float or bool if
    possible.
    """
    if len(value) <= MAX_DIGITS:
        try:
            return float(value) if "." in value else int(value)
        except ValueError:
            pass
    return value.lower() == "true" if value.lower() in ("true", "false") else value


@dataclass(frozen=True)
class Parameter:
    """Parameter that a xacro macro adds to its scope (an item of `params`), with its default value.

    Attributes:
        name: name of the parameter; a block parameter's name starts with `*`.
        default: text that is evaluated in the caller's scope. None: the caller must pass the parameter.
        forwarded: whether the parameter takes the caller's property of the same name, if it exists.
    """

    name: str
    default: str | None = None
    forwarded: bool = False

    @property
    def is_block(self) -> bool:
        return self.name.startswith("*")


def parameters_of(text: str) -> tuple[Parameter, ...]:
    """Parse the attribute `params` of a xacro macro, which declares the parameters in the macro's scope.

    Raises:
        XacroError: the text is too long.
    """
    if len(text) > MAX_PARAMETERS:
        raise XacroError(f"params has more than {MAX_PARAMETERS:,} characters")
    found, at = [], 0
    while text[at:].strip():
        given = _WITH_DEFAULT.match(text, at)
        token = given or _NAME.match(text, at)
        assert token is not None  # the loop condition guarantees a character that is not white space
        at = token.end()
        if given is None:
            found.append(Parameter(token["name"]))
        else:
            found.append(Parameter(given["name"], given["default"] or None, given["forward"] is not None))
    return tuple(found)


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
    """Evaluator that the scopes of a xacro file use for substitution arguments, which are the texts inside
    `$(...)`.

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


@dataclass(frozen=True, eq=False)
class Macro:
    """Definition of a xacro macro, which a scope stores by name: its body and its parameters."""

    body: Element
    parameters: tuple[Parameter, ...]


def find_macro(name: str, macros: Scope, scope: Scope) -> tuple[Scope, Scope, Macro]:
    """Find a xacro macro by its name, which can contain namespaces, as in `ns.macro`.

    Returns:
        The macro scope and the property scope in which the macro must be expanded, and the macro.
    Raises:
        XacroError: the macro does not exist.
    """
    try:
        found = macros.lookup(name)
    except KeyError:
        *spaces, last = name.split(".")
        try:
            for space in spaces:
                macros, scope = macros.lookup(space), scope.lookup(space)
            found = macros.lookup(last)
        except (KeyError, AttributeError):
            raise XacroError(f"unknown macro name: xacro:{name}") from None
    if not isinstance(found, Macro):
        raise XacroError(f"unknown macro name: xacro:{name}")
    return macros, scope, found


def parent_of(scope: Scope) -> Scope:
    """Return the scope of the code that calls a xacro macro. In the macro, `scope="parent"` refers to it.

    For an included file with a namespace, the caller is the file that includes it.
    """
    target = scope.around
    if target is None or target.around is None:
        return scope
    while not scope.name_space and target.name_space and target.around is not None:
        target = target.around
    return target
