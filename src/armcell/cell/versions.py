"""Versions of Python and of the packages that influence the result of a run."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

REPORTED_PACKAGES = ("armcell", "mujoco", "coal", "ompl", "numpy", "numba")


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that influence the result of a run."""
    return {"python": platform.python_version(), **{name: _installed(name) for name in REPORTED_PACKAGES}}


@cache
def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
