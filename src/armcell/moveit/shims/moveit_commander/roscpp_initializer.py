"""roscpp_initialize and roscpp_shutdown: there is nothing to start here."""

from __future__ import annotations

from typing import Any

from armcell.moveit.session import current_session


def roscpp_initialize(args: Any) -> None:
    current_session()  # says what to do where there is none


def roscpp_shutdown() -> None:
    """The cell ends with the script."""
