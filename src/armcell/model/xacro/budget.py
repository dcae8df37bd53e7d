"""Limits on the work and memory that one xacro file may use.

Each operation costs a number of steps in proportion to its work, from one budget per robot file. A file that
needs too much work therefore fails after a few seconds, wherever its loop is. Counting steps instead of
measuring time makes the same file pass or fail on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

MAX_STEPS = 1_000_000  # the largest vendor description that we tested (two FR3 arms) takes 41,000
MAX_CHARACTERS = 1_000_000  # in one string
MAX_SIZE = 100_000  # items in one value, see `size`
MAX_BITS = 4096  # in one integer
MAX_KEY_BITS = 60  # in an integer key: an attacker can choose larger keys with equal hashes
CHARACTERS = 64  # number of characters that count as one item


class XacroError(Exception):
    """Error for a xacro file that is invalid, uses a feature that armcell does not support, or exceeds its
    budget of work and memory.
    """

    def __init__(self, reason: str, hint: str | None = None):
        super().__init__(reason)
        self.reason, self.hint = reason, hint


@dataclass(frozen=True, eq=False)
class Function:
    """Function that xacro expressions can call within the budget: `run(budget, *arguments, **keywords)`
    executes it and deducts its operations from the xacro file's budget.

    Attributes:
        name: name of the function in messages.
        run: the implementation.
        type: the Python type that the function constructs, for `isinstance`; None for other functions.
    """

    name: str
    run: Callable[..., Any]
    type: type | tuple[type, ...] | None = None

    def __repr__(self) -> str:
        return f"<function {self.name}>"


class Budget:
    """Budget for expanding one xacro file: a limit on the number of operations."""

    def __init__(self, steps: int = MAX_STEPS):
        self.left = steps

    def charge(self, steps: int) -> None:
        """Subtract a number of operations from the budget for expanding a xacro file.

        Raises:
            XacroError: the budget is exhausted.
        """
        self.left -= steps
        if self.left < 0:
            raise XacroError(f"it takes more than {MAX_STEPS:,} operations", "simplify the file")

    def charge_value(self, value: Any) -> Any:
        """Deduct the size of a new value in a xacro expression from the budget, and return the value.

        Raises:
            XacroError: the budget is exhausted, the value is too large, or xacro does not support its type.
        """
        if value is None or isinstance(value, bool | float):
            return value
        self.charge(size(value))
        return value


def size(value: Any) -> int:
    """Return the size of a xacro value as its number of items. An operation on the value costs this number of
    operations from the xacro file's budget.

    Nested items count too. A string counts as one item plus one for every 64 characters. An item that occurs
    twice counts twice, because printing and comparing it takes twice as long.

    Raises:
        XacroError: the value is too large, or xacro does not support its type.
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
    """Reject large integers as dictionary keys in xacro, because they could cause work beyond the budget.

    An attacker can choose large integers with equal hashes, which makes a dictionary slow.

    Raises:
        XacroError: an integer has more than 60 bits.
    """
    if isinstance(key, int) and key.bit_length() > MAX_KEY_BITS:
        raise XacroError(f"a key has more than {MAX_KEY_BITS} bits")
    if isinstance(key, tuple):
        for item in key:
            check_key(item)


def check_repeated(items: Sequence[Any], times: int) -> None:
    """Check that a string or list that a xacro expression repeats fits the memory budget: the size limit for
    one value.

    Raises:
        XacroError: `items`, repeated `times` times, would be too long.
    """
    most = MAX_CHARACTERS if isinstance(items, str) else MAX_SIZE
    if len(items) * times > most:
        raise XacroError(f"{len(items)} items, {times} times, are more than {most:,}")
