"""Versions of what decides a run."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

REPORTED_PACKAGES = ("armcell", "mujoco", "coal", "ompl", "numpy", "numba")


def versions() -> dict[str, str]:
    """Versions of what decides a run."""
    found = {"python": platform.python_version()}
    for package in REPORTED_PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
