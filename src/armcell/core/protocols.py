"""Checks for optional capabilities of drivers, also through forwarding wrappers."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from typing_extensions import TypeIs

T = TypeVar("T")


def offers(thing: Any, protocol: type[T]) -> TypeIs[T]:
    """Return whether an object has every member of a protocol.

    Since Python 3.12, `isinstance` does not see members that `__getattr__` forwards
    (`inspect.getattr_static`), so it would miss the capabilities of a wrapped driver.
    """
    members = {**vars(protocol), **inspect.get_annotations(protocol)}
    return all(hasattr(thing, name) for name in members if not name.startswith("_"))
