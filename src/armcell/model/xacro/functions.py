"""Functions and methods that xacro expressions may call: the harmless ones of plain xacro.

Excluded on purpose are functions that return a Python type, module or other object instead of plain data
(`type`, `vars`), functions that change their argument (`append`, `update`), and sets, whose order differs
from run to run.
"""

from __future__ import annotations

import functools
import math
import re
import string
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from armcell.model.xacro.budget import MAX_SIZE, Budget, Function, XacroError, check_key, check_repeated, size

MAX_WIDTH = 1000  # characters of a padded text
MAX_DIGITS = 2000  # digits of an integer written as text
MAX_ARGUMENT = 500  # largest argument of factorial, comb and perm
PERCENT = re.compile(r"%(?:\((?P<key>[^)]*)\))?[#0\- +]*(?P<width>\*|\d*)(?:\.(?P<digits>\*|\d*))?")


def plain(name: str, function: Callable[..., Any], kind: Any = None) -> Function:
    """Wrap a Python function so that xacro expressions can call it. Each call deducts the size of its
    arguments from the operations that the xacro file may still use.

    The budget assumes that the function's run time is at most proportional to the size of its arguments.
    """

    def run(budget: Budget, /, *arguments: Any, **keywords: Any) -> Any:
        budget.charge(sum(size(argument) for argument in (*arguments, *keywords.values())))
        return function(*arguments, **keywords)

    return Function(name, run, kind)


def text_of(value: Any) -> str:
    """Return a value as the text that xacro and its functions write into the URDF.

    Raises:
        XacroError: the value is a function or a namespace, which have no text.
    """
    if isinstance(value, str):
        return value
    size(value)
    if isinstance(value, Function):
        raise XacroError(f"{value.name} is a function, not a value", f"write {value.name}(...)")
    return str(value)


def items_of(value: Any) -> Sequence[Any]:
    """Return the items of a xacro value as a sequence over which functions and loops in expressions can
    iterate. A dictionary yields its keys.

    Raises:
        XacroError: the value is not a string, list, tuple or dictionary.
    """
    if isinstance(value, str | list | tuple):
        return value
    if isinstance(value, dict):
        return list(value)
    raise XacroError(f"a value of type {type(value).__name__} has no items")


# --- conversions ---
def _int(value: Any = 0, base: int | None = None) -> int:
    if isinstance(value, str) and len(value) > MAX_DIGITS:
        raise XacroError(f"a number has more than {MAX_DIGITS} digits")
    return int(value) if base is None else int(value, base)


def _list(value: Any = ()) -> list[Any]:
    return list(items_of(value))


def _tuple(value: Any = ()) -> tuple[Any, ...]:
    return tuple(items_of(value))


def _dict(value: Any = (), /, **entries: Any) -> dict[Any, Any]:
    pairs = value.items() if isinstance(value, dict) else [_tuple(pair) for pair in items_of(value)]
    return {**_checked_dict(pairs), **entries}


def _checked_dict(pairs: Iterable[Any]) -> dict[Any, Any]:

    found = {}
    for key, value in pairs:
        check_key(key)
        found[key] = value
    return found


def _range(*arguments: int) -> list[int]:
    found = range(*arguments)
    if len(found) > MAX_SIZE:
        raise XacroError(f"range{arguments} has more than {MAX_SIZE:,} items")
    return list(found)


def _round(number: float, ndigits: int | None = None) -> float:
    if ndigits is not None and abs(ndigits) > 400:
        raise XacroError(f"round to {ndigits} digits")
    return round(number, ndigits)


# --- sequences ---
def _map(budget: Budget, function: Function, *lists: Any) -> list[Any]:
    return [_called(budget, function, *row) for row in zip(*(items_of(each) for each in lists))]


def _filter(budget: Budget, function: Function | None, items: Any) -> list[Any]:
    return [x for x in items_of(items) if (x if function is None else _called(budget, function, x))]


def _called(budget: Budget, function: Any, *arguments: Any) -> Any:
    if not isinstance(function, Function):
        raise XacroError(f"a value of type {type(function).__name__} cannot be called")
    budget.charge(1)
    return budget.charge_value(function.run(budget, *arguments))


def _keyed(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap `min`, `max` or `sorted` so that a xacro expression can pass a xacro function as `key`."""

    def run(budget: Budget, /, *arguments: Any, key: Function | None = None, **keywords: Any) -> Any:
        of_item = None if key is None else functools.partial(_called, budget, key)
        budget.charge(sum(size(argument) for argument in arguments))
        given = [items_of(arguments[0])] if len(arguments) == 1 else arguments
        return function(*given, key=of_item, **keywords)

    return run


def _sum(items: Any, start: Any = 0) -> Any:
    found = [start, *items_of(items)]
    if not all(isinstance(item, int | float) for item in found):
        raise XacroError("sum() adds numbers only")
    return sum(found)


def _prod(items: Any) -> Any:
    found = 1
    for item in items_of(items):
        found = found * item if isinstance(item, int | float) else float("nan")
        size(found)
    return found


def _isinstance(value: Any, kind: Any) -> bool:
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if not all(isinstance(each, Function) and each.type is not None for each in kinds):
        raise XacroError("isinstance() needs one of str, int, float, bool, list, dict, tuple")
    return any(isinstance(value, each.type) for each in kinds)


def _small(function: Callable[..., int]) -> Callable[..., int]:
    def run(*arguments: int) -> int:
        if any(abs(argument) > MAX_ARGUMENT for argument in arguments):
            raise XacroError(f"{function.__name__} of more than {MAX_ARGUMENT}")
        return function(*arguments)

    return run


def _types() -> dict[str, Function]:
    """Return the functions for xacro expressions that are also type names, such as `str` and `int`."""
    return {
        "str": plain("str", lambda value="": text_of(value), str),
        "int": plain("int", _int, int),
        "float": plain("float", lambda value=0.0: float(value), float),
        "bool": plain("bool", lambda value=False: bool(value), bool),
        "list": plain("list", _list, list),
        "tuple": plain("tuple", _tuple, tuple),
        "dict": plain("dict", _dict, dict),
    }


BASIC: dict[str, Any] = {
    **_types(),
    "len": plain("len", lambda value: len(items_of(value))),
    "round": plain("round", _round),
    "map": Function("map", _map),
    "min": Function("min", _keyed(min)),
    "max": Function("max", _keyed(max)),
    "sorted": Function("sorted", _keyed(sorted)),
    "range": plain("range", _range),
    "True": True,
    "False": False,
}
"""Functions and constants that need no prefix, as in plain xacro.

Plain xacro still supports `sorted` and `range`, although they are deprecated.
"""

PYTHON: dict[str, Any] = {
    **BASIC,
    "abs": plain("abs", abs),
    "all": plain("all", lambda items: all(items_of(items))),
    "any": plain("any", lambda items: any(items_of(items))),
    "divmod": plain("divmod", divmod),
    "enumerate": plain("enumerate", lambda items, start=0: list(enumerate(items_of(items), start))),
    "filter": Function("filter", _filter),
    "isinstance": plain("isinstance", _isinstance),
    "ord": plain("ord", ord),
    "repr": plain("repr", lambda value: repr(value)),
    "reversed": plain("reversed", lambda items: list(items_of(items))[::-1]),
    "sum": plain("sum", _sum),
    "zip": plain("zip", lambda *lists: list(zip(*(items_of(each) for each in lists)))),
}
"""Functions of the namespace `python`, by name."""

MATH: dict[str, Any] = {
    **{name: getattr(math, name) for name in ("pi", "e", "tau", "inf", "nan")},
    **{
        name: plain(name, getattr(math, name))
        for name in (
            "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "copysign", "cos",
            "cosh", "degrees", "dist", "erf", "erfc", "exp", "exp2", "expm1", "fabs", "floor", "fmod",
            "frexp", "fsum", "gamma", "gcd", "hypot", "isclose", "isfinite", "isinf", "isnan", "isqrt",
            "lcm", "ldexp", "lgamma", "log", "log10", "log1p", "log2", "modf", "pow", "radians",
            "remainder", "sin", "sinh", "sqrt", "tan", "tanh", "trunc", "ulp",
        )
    },
    "prod": plain("prod", _prod),
    **{f.__name__: plain(f.__name__, _small(f)) for f in (math.factorial, math.comb, math.perm)},
}  # fmt: skip
"""Functions and constants of the namespace `math`, by name; also available without a prefix."""


# --- text ---
class _Formatter(string.Formatter):
    """Safe `str.format` for xacro expressions, which supports only plain fields.

    Fields such as `{0.attribute}` and `{0[item]}` would give access to Python's objects.
    """

    def get_field(self, field_name: str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        if "." in field_name or "[" in field_name:
            raise XacroError(f"format field {{{field_name}}} is not supported", "name the value by itself")
        return super().get_field(field_name, args, kwargs)

    def format_field(self, value: Any, format_spec: str) -> str:
        _check_widths(re.findall(r"\d+", format_spec))
        return format(value if format_spec else text_of(value), format_spec)


def _check_widths(widths: Iterable[str | None]) -> None:
    for width in widths:
        if width == "*" or (width and (len(width) > 6 or int(width) > MAX_WIDTH)):
            raise XacroError(f"a text of width {width[:20]}", f"the limit is {MAX_WIDTH}")


def _format(text: str, /, *arguments: Any, **keywords: Any) -> str:
    _check_filled(text.count("{"), (list(arguments), keywords))
    return _Formatter().vformat(text, arguments, keywords)


def percent(text: str, values: Any) -> str:
    """Evaluate Python's `text % values` in a xacro expression,
    after checking the field widths and the result's size.

    Raises:
        XacroError: a field is too wide, a key contains parentheses, or the result would be too long.
    """
    fields = list(PERCENT.finditer(text))
    if any("(" in (field["key"] or "") for field in fields):  # unlike Python, PERCENT counts no parentheses
        raise XacroError("a key with parentheses is not supported")
    _check_widths(width for field in fields for width in (field["width"], field["digits"]))
    _check_filled(len(fields), values)
    return text % values


def _check_filled(fields: int, values: Any) -> None:
    if fields * size(values) > MAX_SIZE:
        raise XacroError("a formatted text would be too long")


def _replace(text: str, old: str, new: str, count: int = -1) -> str:
    times = text.count(old) if count < 0 else min(count, len(text) + 1)
    check_repeated(new, times)
    return text.replace(old, new, count)


def _join(text: str, items: Any) -> str:
    found = items_of(items)
    size(found)  # counts every item, even if all items are the same long string
    check_repeated(text, len(found))
    return text.join(found)


def _padded(method: Callable[..., str]) -> Callable[..., str]:
    def run(text: str, width: int, *fill: str) -> str:
        if width > MAX_WIDTH:
            raise XacroError(f"a text of width {width}", f"the limit is {MAX_WIDTH}")
        return method(text, width, *fill)

    return run


METHODS: dict[type, dict[str, Callable[..., Any]]] = {
    str: {
        **{
            name: getattr(str, name)
            for name in (
                "capitalize", "casefold", "count", "endswith", "find", "index", "isalnum", "isalpha",
                "isdecimal", "isdigit", "isidentifier", "islower", "isnumeric", "isspace", "isupper", "lower",
                "lstrip", "partition", "removeprefix", "removesuffix", "rfind", "rindex", "rpartition",
                "rsplit", "rstrip", "split", "splitlines", "startswith", "strip", "swapcase", "title",
                "upper",
            )
        },
        **{name: _padded(getattr(str, name)) for name in ("center", "ljust", "rjust", "zfill")},
        "format": _format,
        "join": _join,
        "replace": _replace,
    },
    list: {"copy": list.copy, "count": list.count, "index": list.index},
    tuple: {"count": tuple.count, "index": tuple.index},
    dict: {
        "copy": lambda value: dict(value),
        "get": dict.get,
        "items": lambda value: list(value.items()),
        "keys": lambda value: list(value),
        "values": lambda value: list(value.values()),
    },
    float: {"is_integer": float.is_integer},
}  # fmt: skip
"""Methods that expressions may call, by type and name; no method changes its object."""


def method_of(value: Any, name: str) -> Function | None:
    """Return a method of a value as a function that xacro expressions can call, or None if the method is not
    allowed.
    """
    found = next((methods for kind, methods in METHODS.items() if isinstance(value, kind)), {}).get(name)
    return None if found is None else plain(name, functools.partial(found, value))


def tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    """Split a text at each character of `sep`, like the xacro function `xacro.tokenize`."""
    items = re.split("[" + re.escape(sep) + "]", text) if sep else [text]
    return [item for item in items if item] if skip_empty else items
