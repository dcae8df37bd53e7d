"""Where the users' scripts are."""

from __future__ import annotations

from pathlib import Path

SHARED = "shared/scripts"
SCRIPTS = next(
    (p / SHARED for p in Path(__file__).parents if (p / SHARED).is_dir()), Path(__file__).parents[3] / SHARED
)
