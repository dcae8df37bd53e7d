"""What a proof of a motion says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armcell.core import Contact


@dataclass(frozen=True)
class Certificate:
    """`free`: proven. Else `contact` is the pair, and `at` the fraction of the motion where it is."""

    free: bool
    at: float = 1.0
    contact: Contact | None = None
    clearance: float = np.inf  # [m] smallest distance met at the configurations looked at
