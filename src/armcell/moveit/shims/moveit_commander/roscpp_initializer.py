"""Shim of roscpp_initialize and roscpp_shutdown, which start and stop no ROS node here."""

from __future__ import annotations

from typing import Any

from armcell.moveit.session import current_session


def roscpp_initialize(args: Any) -> None:
    current_session()  # without a session, raises an error that contains the remedy


def roscpp_shutdown() -> None:
    """Do nothing: armcell stops the cell when the script exits. MoveIt's roscpp_shutdown shuts down the C++
    node.
    """
