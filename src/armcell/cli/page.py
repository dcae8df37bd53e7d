"""A page that a command serves until Ctrl-C."""

from __future__ import annotations

from typing import NoReturn

from armcell import _interrupts
from armcell.cli.console import console


def serve_page(url: str, open_browser: bool) -> NoReturn:
    """Say where the page is, open it where that is asked for, and wait."""
    console.print(f"view: {url}")
    console.print("press Ctrl-C to end")
    if open_browser:
        import webbrowser

        webbrowser.open(url)
    while True:
        _interrupts.sleep(3600)
