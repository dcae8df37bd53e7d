"""Shared helpers of the panel's tabs: robust, non-recursive callbacks and HTML-safe text."""

from __future__ import annotations

import contextlib
import html
import logging
import threading
from collections.abc import Callable, Iterator
from typing import Any

from armcell.core import ArmcellError

logger = logging.getLogger(__name__)

_quiet = threading.local()


@contextlib.contextmanager
def without_callbacks() -> Iterator[None]:
    """Let a thread of a panel tab set widgets during a `with` block without triggering their callbacks."""
    before, _quiet.on = getattr(_quiet, "on", False), True
    try:
        yield
    finally:
        _quiet.on = before


class Callbacks:
    """Factory for the callbacks of widgets in a panel tab.
    When a callback fails, the error is shown and the widgets are reset.

    Args:
        say: shows an error text.
        refresh: resets all widgets to the current state.
    """

    def __init__(self, say: Callable[[str], None], refresh: Callable[[], None]):
        self._say, self._refresh = say, refresh

    def wrap(self, work: Callable[[], Any]) -> Callable[[Any], None]:
        def callback(_: Any) -> None:
            if not getattr(_quiet, "on", False):
                self.run(work)

        return callback

    def run(self, work: Callable[[], Any]) -> None:
        try:
            work()
        except ArmcellError as error:
            self._say(str(error))
            self._refresh()
        except Exception as error:
            logger.exception("a click could not be followed")
            self._say(f"internal error: {type(error).__name__}: {error}")
            self._refresh()


def paragraph(text: str, color: str = "inherit", bold: bool = False) -> str:
    """Convert untrusted text to an escaped HTML paragraph for a panel widget. Line breaks are kept."""
    weight = "600" if bold else "inherit"
    style = f"padding:0.1em 0.75em;font-size:0.85em;line-height:1.35;color:{color};font-weight:{weight}"
    return f'<div style="{style};white-space:pre-wrap;overflow-wrap:anywhere">{html.escape(text)}</div>'
