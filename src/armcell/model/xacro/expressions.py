"""Interpreter for the expressions in `${...}` of xacro files, without Python's `eval`.

The module parses the text with `ast`, interprets the node types that it lists, and rejects all others. Values
are plain data (numbers, strings, lists, tuples, dictionaries) and the functions of `functions.py`. No value
is a Python object with its own attributes, so an expression cannot reach Python's internals: an attribute is
a key of a YAML dictionary, a name in a namespace, or a listed method.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

from armcell.model.xacro.budget import (
    MAX_BITS,
    MAX_SIZE,
    Budget,
    Function,
    XacroError,
    check_key,
    check_repeated,
    size,
)
from armcell.model.xacro.functions import items_of, method_of, percent

MAX_EXPRESSION = 10_000  # characters


class Names(Protocol):
    """Names that a xacro expression can use, and their values."""

    def lookup(self, name: str) -> Any:
        """Return the value of a name in a xacro expression. Raise KeyError if the name is unknown."""
        ...


class AttributeDict(dict[Any, Any]):
    """Dictionary whose keys xacro expressions can also use as attributes, as in `limits.lower`. It holds the
    content of a YAML file.
    """


class NameSpace:
    """Namespace that xacro expressions can use, such as `math` in `math.pi`."""

    def __init__(self, names: Mapping[str, Any]):
        self._names = names

    def lookup(self, name: str) -> Any:
        return self._names[name]


class _Local:
    """Names available inside a comprehension in a xacro expression:
    its loop variables and the outer names.
    """

    def __init__(self, around: Names):
        self.around, self.values = around, {}

    def lookup(self, name: str) -> Any:
        return self.values[name] if name in self.values else self.around.lookup(name)


def evaluate(text: str, names: Names, budget: Budget) -> Any:
    """Evaluate a xacro expression `${...}` without Python's `eval`.

    Args:
        text: the expression, without `${` and `}`.
        names: values of the names in the expression.
        budget: remaining operations of the robot file.
    Raises:
        XacroError: a syntax error, an unknown name, a forbidden operation, a wrong type, or more work than
            the budget allows.
    """
    if len(text) > MAX_EXPRESSION:
        raise XacroError(f"an expression has more than {MAX_EXPRESSION:,} characters")
    budget.charge(1 + len(text) // 8)
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else "nested too deeply"
        raise XacroError(f"{_shown(text)} is not an expression: {reason}") from None
    try:
        return _Evaluator(budget).value(tree.body, names)
    except XacroError as error:
        error.reason = f"{error.reason} in {_shown(text)}"
        raise  # the same type: a missing file or argument gets a hint
    except RecursionError:
        raise XacroError(f"{_shown(text)} is nested too deeply") from None
    except KeyError as error:
        raise XacroError(f"no key {error.args[0]!r} in {_shown(text)}") from None
    except (TypeError, ValueError, ArithmeticError, LookupError) as error:
        raise XacroError(f"{error} in {_shown(text)}") from None


def _shown(text: str) -> str:
    short = " ".join(text.split())
    return "${" + (short if len(short) <= 80 else short[:77] + "...") + "}"


class _Evaluator:
    def __init__(self, budget: Budget):
        self.budget = budget

    def value(self, node: ast.expr, names: Names) -> Any:
        self.budget.charge(1)
        visit = _VISITS.get(type(node))
        if visit is None:
            raise XacroError(f"{_WORDS.get(type(node), type(node).__name__)} is not allowed")
        return visit(self, node, names)

    # --- names and literals ---
    def constant(self, node: ast.Constant, names: Names) -> Any:
        if node.value is not None and not isinstance(node.value, int | float | str):
            raise XacroError(f"a literal of type {type(node.value).__name__} is not allowed")
        return self.budget.charge_value(node.value)

    def name(self, node: ast.Name, names: Names) -> Any:
        try:
            return names.lookup(node.id)
        except KeyError:
            raise XacroError(f"name {node.id!r} is not defined") from None

    def attribute(self, node: ast.Attribute, names: Names) -> Any:
        value = self.value(node.value, names)
        if not node.attr.startswith("_"):
            if hasattr(type(value), "lookup"):  # a namespace
                try:
                    return value.lookup(node.attr)
                except KeyError:
                    raise XacroError(f"name {ast.unparse(node)!r} is not defined") from None
            found = method_of(value, node.attr)
            if found is not None:
                return found
            if isinstance(value, AttributeDict) and node.attr in value:
                return value[node.attr]
        if isinstance(value, AttributeDict):
            raise XacroError(f"the YAML dictionary has no key {node.attr!r}")
        raise XacroError(f"attribute {node.attr!r} of {_kind(value)} is not allowed")

    def subscript(self, node: ast.Subscript, names: Names) -> Any:
        value = self.value(node.value, names)
        if not isinstance(value, str | list | tuple | dict):
            raise XacroError(f"{_kind(value)} has no items")
        if isinstance(node.slice, ast.Slice):
            parts = (node.slice.lower, node.slice.upper, node.slice.step)
            return self.budget.charge_value(value[slice(*(p and self.value(p, names) for p in parts))])
        return value[self.value(node.slice, names)]

    def sequence(self, node: ast.List | ast.Tuple, names: Names) -> Any:
        found = [self.value(item, names) for item in node.elts]
        return self.budget.charge_value(found if isinstance(node, ast.List) else tuple(found))

    def dictionary(self, node: ast.Dict, names: Names) -> Any:
        found = {}
        for key, item in zip(node.keys, node.values):
            if key is None:
                raise XacroError("** is not allowed")
            self.put(found, self.value(key, names), self.value(item, names))
        return self.budget.charge_value(found)

    def put(self, found: dict[Any, Any], key: Any, value: Any) -> None:
        check_key(key)
        found[key] = value

    # --- operators ---
    def binary(self, node: ast.BinOp, names: Names) -> Any:
        left, right = self.value(node.left, names), self.value(node.right, names)
        operate = _BINARY.get(type(node.op))
        if operate is None:
            raise XacroError(f"operator {type(node.op).__name__} is not allowed")
        self.data(left, right)
        return self.budget.charge_value(operate(left, right))

    def unary(self, node: ast.UnaryOp, names: Names) -> Any:
        value = self.value(node.operand, names)
        self.data(value)
        return self.budget.charge_value(_UNARY[type(node.op)](value))

    def both(self, node: ast.BoolOp, names: Names) -> Any:
        value = None
        for item in node.values:
            value = self.value(item, names)
            if bool(value) is isinstance(node.op, ast.Or):
                break
        return value

    def compare(self, node: ast.Compare, names: Names) -> Any:
        left, answer = self.value(node.left, names), True
        for compare, item in zip(node.ops, node.comparators):
            right = self.value(item, names)
            self.data(left, right)
            answer = _COMPARE[type(compare)](left, right)
            if not answer:
                break
            left = right
        return answer

    def data(self, *values: Any) -> None:
        """Check the operands of an operator in a xacro expression, and deduct their size from the budget.

        Numbers and None are free.

        Raises:
            XacroError: the budget is exhausted, an operand is too large, or an operand is a namespace or
                another value that has no operators.
        """
        for value in values:
            if not isinstance(value, int | float) and value is not None:
                self.budget.charge(size(value))

    def choice(self, node: ast.IfExp, names: Names) -> Any:
        return self.value(node.body if self.value(node.test, names) else node.orelse, names)

    # --- comprehensions and calls ---
    def comprehension(self, node: ast.ListComp | ast.GeneratorExp, names: Names) -> Any:
        found: list[Any] = []
        total = 0
        for local in self.rows(node.generators, names):
            found.append(self.value(node.elt, local))
            total += size(found[-1])
            if total > MAX_SIZE:
                raise XacroError(f"a list has more than {MAX_SIZE:,} items")
        return self.budget.charge_value(found)

    def dict_comprehension(self, node: ast.DictComp, names: Names) -> Any:
        found: dict[Any, Any] = {}
        for local in self.rows(node.generators, names):
            self.put(found, self.value(node.key, local), self.value(node.value, local))
            self.budget.charge(size(list(found.items())[-1:]))
        return self.budget.charge_value(found)

    def rows(self, loops: list[ast.comprehension], names: Names) -> Iterator[Names]:
        loop, rest = loops[0], loops[1:]
        if loop.is_async:
            raise XacroError("an asynchronous loop is not allowed")
        local = _Local(names)
        for item in items_of(self.value(loop.iter, names)):
            self.budget.charge(1)
            self.assign(loop.target, item, local)
            if all(self.value(test, local) for test in loop.ifs):
                if rest:
                    yield from self.rows(rest, local)
                else:
                    yield local

    def assign(self, target: ast.expr, item: Any, local: _Local) -> None:
        if isinstance(target, ast.Name):
            local.values[target.id] = item
        elif isinstance(target, ast.Tuple | ast.List):
            items = items_of(item)
            if len(items) != len(target.elts):
                raise XacroError(f"{len(items)} items for {len(target.elts)} variables")
            for each, part in zip(target.elts, items):
                self.assign(each, part, local)
        else:
            raise XacroError(f"a loop variable {ast.unparse(target)} is not allowed")

    def call(self, node: ast.Call, names: Names) -> Any:
        function = self.value(node.func, names)
        if not isinstance(function, Function):
            raise XacroError(f"{_kind(function)} cannot be called")
        arguments = [self.value(argument, names) for argument in node.args]
        keywords = {}
        for keyword in node.keywords:
            if keyword.arg is None:
                raise XacroError("** is not allowed")
            keywords[keyword.arg] = self.value(keyword.value, names)
        return self.budget.charge_value(function.run(self.budget, *arguments, **keywords))


def _kind(value: Any) -> str:
    if isinstance(value, Function):
        return f"function {value.name}"
    return f"a value of type {type(value).__name__}"


# --- operators ---
def _multiplied(left: Any, right: Any) -> Any:
    for items, times in ((left, right), (right, left)):
        if isinstance(items, str | list | tuple) and isinstance(times, int):
            check_repeated(items, times)
    if isinstance(left, int) and isinstance(right, int):
        _check_bits(left.bit_length() + right.bit_length())
    return left * right


def _power(left: Any, right: Any) -> Any:
    if isinstance(left, int) and isinstance(right, int):
        _check_bits(left.bit_length() * abs(right) if abs(left) > 1 else 0)
    return left**right


def _shifted(left: Any, right: Any) -> Any:
    if isinstance(left, int) and isinstance(right, int):
        _check_bits(left.bit_length() + right)
    return left << right


def _check_bits(bits: int) -> None:
    if bits > MAX_BITS:
        raise XacroError(f"an integer would have more than {MAX_BITS} bits")


def _remainder(left: Any, right: Any) -> Any:
    return percent(left, right) if isinstance(left, str) else left % right


def _contains(left: Any, right: Any) -> bool:
    if not isinstance(right, str | list | tuple | dict):
        raise XacroError(f"{_kind(right)} has no items")
    return left in right


_BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: _multiplied, ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv, ast.Mod: _remainder, ast.Pow: _power, ast.LShift: _shifted,
    ast.RShift: operator.rshift, ast.BitAnd: operator.and_, ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}  # fmt: skip
_UNARY: dict[type, Callable[[Any], Any]] = {
    ast.UAdd: operator.pos, ast.USub: operator.neg, ast.Not: operator.not_, ast.Invert: operator.invert,
}  # fmt: skip
_COMPARE: dict[type, Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Is: operator.is_, ast.IsNot: operator.is_not,
    ast.In: _contains, ast.NotIn: lambda left, right: not _contains(left, right),
}  # fmt: skip
_VISITS: dict[type, Callable[[_Evaluator, Any, Names], Any]] = {
    ast.Constant: _Evaluator.constant, ast.Name: _Evaluator.name, ast.Attribute: _Evaluator.attribute,
    ast.Subscript: _Evaluator.subscript, ast.List: _Evaluator.sequence, ast.Tuple: _Evaluator.sequence,
    ast.Dict: _Evaluator.dictionary, ast.BinOp: _Evaluator.binary, ast.UnaryOp: _Evaluator.unary,
    ast.BoolOp: _Evaluator.both, ast.Compare: _Evaluator.compare, ast.IfExp: _Evaluator.choice,
    ast.ListComp: _Evaluator.comprehension, ast.GeneratorExp: _Evaluator.comprehension,
    ast.DictComp: _Evaluator.dict_comprehension, ast.Call: _Evaluator.call,
}  # fmt: skip
_WORDS: dict[type, str] = {
    ast.Lambda: "lambda", ast.NamedExpr: "an assignment", ast.Starred: "*", ast.JoinedStr: "an f-string",
    ast.Set: "a set", ast.SetComp: "a set", ast.Await: "await", ast.Yield: "yield",
    ast.YieldFrom: "yield",
}  # fmt: skip
