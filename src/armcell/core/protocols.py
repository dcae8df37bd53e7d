"""What an object offers, also one that stands before another and passes calls on."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from typing_extensions import TypeIs

T = TypeVar("T")


def offers(thing: Any, protocol: type[T]) -> TypeIs[T]:
    """Whether an object has every member of a protocol.

    `isinstance` does not find what comes by `__getattr__` since Python 3.12 (`inspect.getattr_static`), so a
    driver behind another would be none of its kind.
    """
    members = {**vars(protocol), **inspect.get_annotations(protocol)}
    return all(hasattr(thing, name) for name in members if not name.startswith("_"))
