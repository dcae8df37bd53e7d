"""URScript's tree to Python source: every function becomes a generator that yields once a control step.

Nothing of a script reaches Python but through the nodes here: names get a prefix, constants go by `repr`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import CodeType
from typing import Any

from armcell.control.ur_controller.urscript.parser import Node, ScriptError


class _Scope:
    def __init__(self, names: set[str] | None):
        self.local = names  # None: the program's own body, whose variables all others see


def compiled(
    statements: list[Node], blocking: Iterable[str], instant: Mapping[str, Callable[..., Any]]
) -> CodeType:
    """Python code that defines `main(G, F)`: a generator function with the program's global variables.

    Args:
        blocking: functions that take time, called as `B[name](...)`.
        instant: functions that do not, called as `I[name](...)`.
    """
    return compile(_Compiler(blocking, instant).source(statements), "<urscript>", "exec")


class _Compiler:
    def __init__(self, blocking: Iterable[str], instant: Mapping[str, Callable[..., Any]]):
        self._blocking, self._instant = frozenset(blocking), frozenset(instant)
        self._lines: list[str] = []
        self._globals: set[str] = set()
        self._functions: dict[str, str] = {}

    def source(self, statements: list[Node]) -> str:
        self._find(statements, top=True)
        self._emit(0, "def main(G, F, B, I, M):")
        functions: list[Node] = []
        self._take_functions(statements, functions)
        for node in functions:
            self._function(node)
        self._body(statements, 1, _Scope(None))
        self._emit(1, "return")
        self._emit(1, "yield")
        return "\n".join(self._lines)

    def _emit(self, depth: int, text: str) -> None:
        self._lines.append("  " * depth + text)

    def _find(self, statements: list[Node], top: bool) -> None:
        """Global names: declared so anywhere, or assigned in the program's own body."""
        for node in statements:
            if node[0] == "assign" and node[1][0] == "name" and (node[3] == "global" or top):
                self._globals.add(node[1][1])
            elif node[0] == "if":
                for _, body in node[1]:
                    self._find(body, top)
            elif node[0] == "while":
                self._find(node[2], top)
            elif node[0] == "def":
                self._functions[node[2]] = node[1]
                self._find(node[4], False)

    def _take_functions(self, statements: list[Node], found: list[Node]) -> None:
        for node in statements:
            if node[0] == "def":
                found.append(node)
                self._take_functions(node[4], found)
            elif node[0] == "if":
                for _, body in node[1]:
                    self._take_functions(body, found)
            elif node[0] == "while":
                self._take_functions(node[2], found)

    def _function(self, node: Node) -> None:
        _, _, name, parameters, body, _ = node
        names = {p for p, _ in parameters}
        locals_: set[str] = set(names)
        self._find_locals(body, locals_)
        scope = _Scope(locals_)
        given = ", ".join(
            f"v_{p}" + ("" if default is None else f"={self._value(default, _Scope(None))}")
            for p, default in parameters
        )
        self._emit(1, f"def u_{name}({given}):")
        for variable in sorted(locals_ - names):
            self._emit(2, f"v_{variable} = None")
        self._body(body, 2, scope)
        self._emit(2, "return None")
        self._emit(2, "yield")
        self._emit(1, f"F[{name!r}] = u_{name}")

    def _find_locals(self, statements: list[Node], found: set[str]) -> None:
        for node in statements:
            if node[0] == "assign" and node[1][0] == "name":
                name = node[1][1]
                if node[3] == "local" or (node[3] == "" and name not in self._globals):
                    found.add(name)
            elif node[0] == "if":
                for _, body in node[1]:
                    self._find_locals(body, found)
            elif node[0] == "while":
                self._find_locals(node[2], found)

    def _body(self, statements: list[Node], depth: int, scope: _Scope) -> None:
        self._emit(depth, "pass")
        for node in statements:
            kind, line = node[0], node[-1]
            if kind == "def":
                continue
            if kind not in ("break", "continue"):
                self._emit(depth, f"M.line = {line}")
            if kind == "assign":
                self._emit(depth, f"{self._target(node[1], scope)} = copied({self._value(node[2], scope)})")
            elif kind == "do":
                self._emit(depth, self._value(node[1], scope))
            elif kind == "if":
                for i, (condition, body) in enumerate(node[1]):
                    word = "if" if i == 0 else "elif"
                    head = "else:" if condition is None else f"{word} {self._value(condition, scope)}:"
                    self._emit(depth, head)
                    self._body(body, depth + 1, scope)
            elif kind == "while":
                self._emit(depth, f"while {self._value(node[1], scope)}:")
                self._emit(depth + 1, "M.count()")
                self._body(node[2], depth + 1, scope)
            elif kind == "return":
                self._emit(depth, f"return {'None' if node[1] is None else self._value(node[1], scope)}")
            elif kind in ("break", "continue"):
                self._emit(depth, kind)
            elif kind == "halt":
                self._emit(depth, "M.halt(); yield")
            elif kind == "kill":
                self._emit(depth, f"M.kill({self._value(node[1], scope)})")
            elif kind == "join":
                self._emit(depth, f"yield from M.join({self._value(node[1], scope)})")

    def _target(self, node: Node, scope: _Scope) -> str:
        if node[0] == "index":
            return f"{self._target(node[1], scope)}[{self._value(node[2], scope)}]"
        if node[0] != "name":
            raise ScriptError("only a variable or its item can be given a value")
        return self._name(node[1], scope)

    def _name(self, name: str, scope: _Scope) -> str:
        if scope.local is not None and name in scope.local:
            return f"v_{name}"
        return f"G[{name!r}]"

    def _value(self, node: Node, scope: _Scope) -> str:
        kind = node[0]
        if kind == "const":
            return repr(node[1])
        if kind == "name":
            return self._name(node[1], scope)
        if kind in ("list", "pose"):
            items = ", ".join(self._value(v, scope) for v in node[1])
            return f"{'Vec' if kind == 'list' else 'Pose'}(({items}{',' if node[1] else ''}))"
        if kind == "index":
            return f"{self._value(node[1], scope)}[{self._value(node[2], scope)}]"
        if kind == "neg":
            return f"(-{self._value(node[1], scope)})"
        if kind == "not":
            return f"(not {self._value(node[1], scope)})"
        if kind == "op":
            sign, left, right = node[1], self._value(node[2], scope), self._value(node[3], scope)
            if sign == "xor":
                return f"(bool({left}) != bool({right}))"
            return f"({left} {sign} {right})"
        if kind == "run":
            _, name, arguments = node[1]
            self._known(name)
            return f"M.spawn(u_{name}({self._arguments(arguments, scope, 'v_')}))"
        return self._call(node, scope)

    def _call(self, node: Node, scope: _Scope) -> str:
        _, name, arguments = node
        if name in self._functions:
            return f"(yield from u_{name}({self._arguments(arguments, scope, 'v_')}))"
        given = self._arguments(arguments, scope)
        if name in self._blocking:
            return f"(yield from B[{name!r}]({given}))"
        if name in self._instant:
            return f"I[{name!r}]({given})"
        return f"M.unknown({name!r})"  # said when it is called: a script may hold calls it never makes

    def _arguments(self, arguments: list[tuple[str | None, Node]], scope: _Scope, prefix: str = "") -> str:
        return ", ".join(
            (f"{prefix}{keyword}=" if keyword else "") + self._value(value, scope)
            for keyword, value in arguments
        )

    def _known(self, name: str) -> None:
        if name not in self._functions:
            raise ScriptError(f"thread {name!r} is not defined")
