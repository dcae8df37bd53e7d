"""Limits on the work and memory that a xacro file may cause.

Each operation is charged to one budget per robot file, in proportion to its work, so a file that asks for
too much fails after a few seconds wherever its loop is. Counting operations instead of reading a clock
makes the same file pass or fail on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

MAX_STEPS = 1_000_000  # the largest description of a vendor that we tried (two FR3 arms) takes 41,000
MAX_CHARACTERS = 1_000_000  # of one string
MAX_SIZE = 100_000  # of one value, see `size`
MAX_BITS = 4096  # of one integer
MAX_KEY_BITS = 60  # of an integer as a key: larger ones can be chosen to have equal hashes
CHARACTERS = 64  # that count as much as one item


class XacroError(Exception):
    """A xacro file that cannot be expanded, or that armcell refuses to expand."""

    def __init__(self, reason: str, cure: str | None = None):
        super().__init__(reason)
        self.reason, self.cure = reason, cure


@dataclass(frozen=True, eq=False)
class Function:
    """A function that expressions may call, by `run(budget, *arguments, **keywords)`.

    Attributes:
        type: for `isinstance`, where the function is a type's constructor.
    """

    name: str
    run: Callable[..., Any]
    type: type | tuple[type, ...] | None = None

    def __repr__(self) -> str:
        return f"<function {self.name}>"


class Budget:
    """Operations left for one robot file."""

    def __init__(self, steps: int = MAX_STEPS):
        self.left = steps

    def charge(self, steps: int) -> None:
        """Count operations.

        Raises:
            XacroError: there were too many.
        """
        self.left -= steps
        if self.left < 0:
            raise XacroError(f"it takes more than {MAX_STEPS:,} operations", "simplify the file")

    def made(self, value: Any) -> Any:
        """Return a value that an expression made, after charging for its size.

        Raises:
            XacroError: the value is too large, or of a type that xacro does not have.
        """
        if value is None or isinstance(value, bool | float):
            return value
        self.charge(size(value))
        return value


def size(value: Any) -> int:
    """Return the number of items in a value, nested ones included; 64 characters count as one item.

    Values are trees for this count: an item that is contained twice counts twice, since printing and
    comparing take as long.

    Raises:
        XacroError: the value is too large, or contains a type that xacro does not have.
    """
    total, left = 0, [value]
    while left:
        item = left.pop()
        total += 1
        if isinstance(item, str):
            if len(item) > MAX_CHARACTERS:
                raise XacroError(f"a text has more than {MAX_CHARACTERS:,} characters")
            total += len(item) // CHARACTERS
        elif isinstance(item, int):
            if item.bit_length() > MAX_BITS:
                raise XacroError(f"an integer has more than {MAX_BITS} bits")
        elif isinstance(item, list | tuple):
            left.extend(item[: MAX_SIZE + 1])
        elif isinstance(item, dict):
            for key in item:
                check_key(key)
            left.extend(item)
            left.extend(item.values())
        elif item is not None and not isinstance(item, float | Function):
            raise XacroError(f"values of type {type(item).__name__} are not supported")
        if total + len(left) > 2 * MAX_SIZE or total > MAX_SIZE:
            raise XacroError(f"a value has more than {MAX_SIZE:,} items")
    return total


def check_key(key: Any) -> None:
    """Refuse a dictionary key whose hash can be chosen, which would make a dictionary slow.

    Raises:
        XacroError: a large integer.
    """
    if isinstance(key, int) and key.bit_length() > MAX_KEY_BITS:
        raise XacroError(f"a key has more than {MAX_KEY_BITS} bits")
    if isinstance(key, tuple):
        for item in key:
            check_key(item)


def check_repeated(items: Sequence[Any], times: int) -> None:
    """Refuse a repetition before it takes memory.

    Raises:
        XacroError: the result would be too large.
    """
    most = MAX_CHARACTERS if isinstance(items, str) else MAX_SIZE
    if len(items) * times > most:
        raise XacroError(f"{len(items)} items, {times} times, are more than {most:,}")
