"""Selection of the seed for a cell's randomized values in a command."""

from __future__ import annotations

import typer

SEED = typer.Option(
    None, min=0, show_default=False,
    help="Draw of the randomised values, and seed of the planners. Default: 0; in mode real things are where "
    "the cell file says.",
)  # fmt: skip


def seed_or_default(seed: int | None, mode: str) -> int | None:
    """Return the random seed of a command: the given seed, or else a default.
    The default is 0, or None in mode real.
    """
    return 0 if seed is None and mode != "real" else seed
