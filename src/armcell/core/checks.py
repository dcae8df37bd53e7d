"""Validation of settings from files, fields of value types, and arrays for compiled code."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.errors import ArmcellError, InputError, UnknownNameError

T = TypeVar("T")
_FLOAT = np.dtype(np.float64)
_FEW = 32  # arrays with fewer numbers are checked faster one by one than by np.isfinite


def settings_from(cls: type[T], values: Any, what: str) -> T:
    """Check the names and values of a nested mapping, such as parsed YAML, and create a settings dataclass
    from the mapping.

    Raises:
        InputError: unknown name (lists the valid names), wrong type, missing or invalid value.
    """
    if not isinstance(values, Mapping):
        raise InputError(f"{what} is {values!r}, a mapping is needed")
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    ready: dict[str, Any] = {}
    for name, value in values.items():
        if name not in known:
            raise UnknownNameError(f"setting of {what}", name, known)
        default = known[name].default
        if default is MISSING:
            default = 0.0  # settings without a default are numbers
        ready[name] = _like(default, value, f"{what}/{name}")
    missing = [n for n, f in known.items() if f.default is MISSING and n not in ready]
    if missing:
        raise InputError(f"{what} lacks {', '.join(missing)}")
    return cls(**ready)


def _number(value: Any) -> bool:
    return is_number(value) and not isinstance(value, bool)


def _like(default: Any, value: Any, what: str) -> Any:
    """Check that a setting's value from a file has the type of the default value, and convert the value to
    this type.
    """
    if is_dataclass(default) and not isinstance(default, type):
        return settings_from(type(default), value, what)
    if (reads := getattr(type(default), "from_setting", None)) is not None:  # a type with its own parser
        return reads(value, what)
    if isinstance(default, str):
        if not isinstance(value, str):
            raise InputError(f"{what} is {value!r}, a text is needed")
        return value
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise InputError(f"{what} is {value!r}, true or false is needed")
        return value
    if isinstance(default, tuple):
        if not isinstance(value, (list, tuple)) or len(value) != len(default) or not all(map(_number, value)):
            raise InputError(f"{what} is {value!r}, a list of {len(default)} numbers is needed")
        return tuple(float(v) for v in value)
    if isinstance(default, int):
        if not _number(value) or int(value) != value:
            raise InputError(f"{what} is {value!r}, a whole number is needed")
        return int(value)
    if not _number(value):
        raise InputError(f"{what} is {value!r}, a number is needed")
    return float(value)


def is_number(value: Any, infinite: bool = False) -> bool:
    """Check whether a value is a single real number. NaN never counts as a number; infinity counts only if
    `infinite` is true.
    """
    if type(value) is float:  # nearly always
        return math.isfinite(value) or (infinite and not math.isnan(value))
    if not isinstance(value, int | float | np.integer | np.floating):
        return False
    try:
        return math.isfinite(value) or (infinite and not math.isnan(value))
    except OverflowError:  # an integer too large for a float
        return False


def float_array(
    values: ArrayLike, shape: tuple[int | None, ...] | None, what: str, finite: bool = True
) -> NDArray[np.float64]:
    """Convert values to a float array for compiled code, after checking their shape.

    Args:
        shape: the required shape. None in it accepts any length, a leading -1 any number of axes; None
            instead of a shape accepts any shape.
        what: name of the values in the message.
        finite: reject NaN and infinity.
    Raises:
        InputError: wrong shape, not real numbers, or not finite.
    """
    if (
        type(values) is np.ndarray
        and values.dtype is _FLOAT
        and (shape is None or values.shape == shape)
        and (not finite or (values.ndim == 1 and values.size < _FEW and math.isfinite(sum(values.tolist()))))
    ):
        return values  # the usual case: the full checks below take three times as long
    try:
        array = np.asarray(values)
        if array.dtype != np.float64:
            array = array.astype(np.float64, casting="unsafe" if array.dtype == object else "same_kind")
    except (TypeError, ValueError, OverflowError):  # ragged, or not real numbers
        raise InputError(f"{what} must be an array of numbers, not {_short(values)}") from None
    shape = array.shape if shape is None else shape
    tail = shape[1:] if shape[:1] == (-1,) else shape
    given = array.shape[-len(tail) :] if shape[:1] == (-1,) and tail else array.shape
    if len(given) != len(tail) or any(n not in (None, m) for n, m in zip(tail, given, strict=True)):
        need = ", ".join("..." if n == -1 else "n" if n is None else str(n) for n in shape)
        raise InputError(f"{what} must have shape ({need}), not {array.shape}")
    if finite and not np.isfinite(array).all():
        raise InputError(f"{what} has a value that is not finite: {_short(values)}")
    return array


def unit_vector(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """Check a direction vector (3,) and scale it to length 1.

    Raises:
        InputError: not three finite numbers, or all are zero.
    """
    vector = float_array(values, (3,), what)
    length = float(np.linalg.norm(vector))
    if not 0 < length < math.inf:
        raise InputError(f"{what} must be a direction, not {_short(values)}")
    return vector / length


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


_SCALAR = {"float": "a number", "int": "a whole number"}
_TUPLE = {
    "tuple[float, float]": 2, "tuple[float, float, float]": 3, "Color": 4, "tuple[float, ...]": 0,
}  # fmt: skip


def checked(*unbounded: str) -> Callable[[type[T]], type[T]]:
    """Return a class decorator that checks the fields of a dataclass; its constructor then rejects NaN,
    infinity and values that are not numbers.

    Apply it below `@dataclass`.

    It checks fields annotated as float, int or a tuple of floats, including optional ones. It also checks the
    type of fields that are annotated as strings or value types of armcell, or as tuples of value types. If a
    value type has a `WRITTEN_AS`, the message contains this example.

    Args:
        unbounded: fields that may be infinite, besides those with an infinite default.
    Raises:
        InputError: raised by the constructor.
    """

    def decorate(cls: type[T]) -> type[T]:
        numbers = [
            (name, text.removesuffix(" | None"), text.endswith(" | None"),
             name in unbounded or getattr(cls, name, None) in (math.inf, -math.inf))
            for name, text in inspect.get_annotations(cls).items()
            if text.removesuffix(" | None") in (*_SCALAR, *_TUPLE)
        ]  # fmt: skip
        original: Callable[[Any], None] | None = getattr(cls, "__post_init__", None)

        classes: list[tuple[str, Callable[[Any], bool], Any]] | None = None  # unknown while modules import

        def check(self: Any) -> None:
            nonlocal classes
            for name, kind, optional, infinite in numbers:
                value = getattr(self, name)
                if not (optional and value is None) and not _fits(value, kind, infinite):
                    need = _SCALAR.get(kind) or (f"{_TUPLE[kind]} numbers" if _TUPLE[kind] else "numbers")
                    raise InputError(f"{type(self).__name__}: {name} is {_short(value)}, it must be {need}")
            if classes is None:
                classes = _class_fields(cls)
            for name, fits, need in classes:
                if not fits(value := getattr(self, name)):
                    what = f"{type(self).__name__}: {name} is {_short(value)}, it must be"
                    raise InputError(f"{what} {_described(need)}", hint=_example(need))

        def __post_init__(self: Any) -> None:
            try:
                if original is not None:
                    original(self)  # its messages are more specific
            except ArmcellError:
                raise
            except Exception:
                check(self)
                raise
            check(self)

        cls.__post_init__ = __post_init__  # type: ignore[attr-defined]
        return cls

    return decorate


def _fits(value: Any, kind: str, infinite: bool) -> bool:
    if kind == "float":
        return is_number(value, infinite)
    if kind == "int":
        return is_number(value) and value == int(value)
    if type(value) is not tuple and (not isinstance(value, Sequence | np.ndarray) or isinstance(value, str)):
        return False
    return (not _TUPLE[kind] or len(value) == _TUPLE[kind]) and all(is_number(v, infinite) for v in value)


def _class_fields(cls: type) -> list[tuple[str, Callable[[Any], bool], Any]]:
    """Return the fields of a dataclass whose values are checked, because they are texts or value types of
    armcell. Each entry has the field's name, the test of its value, and its type annotation.
    """
    tests = ((name, _test(hint), hint) for name, hint in get_type_hints(cls).items())
    return [(name, test, hint) for name, test, hint in tests if test is not None]


def _test(hint: Any) -> Callable[[Any], bool] | None:
    """Return a check function that tests whether a value has an annotated type, or None for types that are
    not checked.
    """
    parts = get_args(hint)
    if get_origin(hint) is tuple:
        tests = [_test(part) for part in parts if part is not ...]
        if parts[1:] == (...,) and tests[0] is not None:
            one = tests[0]
            return lambda value: isinstance(value, tuple | list) and all(map(one, value))
        if None in tests:
            return None
        return lambda value: (
            isinstance(value, tuple | list)
            and len(value) == len(tests)
            and all(test(item) for test, item in zip(tests, value) if test)
        )
    options = parts if get_origin(hint) in (Union, UnionType) else (hint,)
    if set(options) == {NoneType} or not all(map(_is_checkable, options)):
        return None
    return lambda value: isinstance(value, options)


def _is_checkable(option: Any) -> bool:
    return option in (str, NoneType) or (
        isinstance(option, type)
        and option.__module__.startswith("armcell.")
        and not getattr(option, "_is_protocol", False)
    )


def _described(hint: Any) -> str:
    """Describe the type that a checked value must have in words, such as "a tuple of SE3", for the error
    message.
    """
    parts = [part for part in get_args(hint) if part is not ...]
    if get_origin(hint) is tuple:
        inner = [_described(part) for part in parts]
        return f"a tuple of {inner[0]}" if ... in get_args(hint) else f"({', '.join(inner)})"
    if parts:
        return " or ".join(_described(part) for part in parts)
    return {str: "text", NoneType: "None"}.get(hint) or hint.__name__


def _example(hint: Any) -> str | None:
    """Return an example of a valid value for the error message of a failed type check. It is taken from
    `WRITTEN_AS` of the annotated classes.
    """
    while get_origin(hint) is tuple and ... in get_args(hint):
        hint = get_args(hint)[0]
    options = get_args(hint) or (hint,)
    examples = [option.WRITTEN_AS for option in options if hasattr(option, "WRITTEN_AS")]
    return f"for example {' or '.join(examples)}" if examples else None


def require(condition: bool, text: str) -> None:
    """Check a condition, and raise an InputError with the given text if it is false."""
    if not condition:
        raise InputError(text)
