"""Which draw of a cell's randomised values a command runs."""

from __future__ import annotations

import typer

SEED = typer.Option(
    None, min=0, show_default=False,
    help="Draw of the randomised values, and seed of the planners. Default: 0; in mode real things are where "
    "the cell file says.",
)  # fmt: skip


def drawn(seed: int | None, mode: str) -> int | None:
    """The seed that was given, else 0; else None in mode real, where nobody has put things so."""
    return 0 if seed is None and mode != "real" else seed
