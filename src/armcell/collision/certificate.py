"""`Certificate`: the result of certifying that a motion is collision-free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armcell.core import Contact


@dataclass(frozen=True)
class Certificate:
    """Result of an attempt to certify that a motion is collision-free.

    Attributes:
        free: True if the motion is certified collision-free.
        at: position of the contact as a fraction of the motion, from 0 to 1; only if not `free`.
        contact: pair of bodies in contact, or None if unknown; only if not `free`.
        clearance: smallest distance [m] among the configurations that were measured.
    """

    free: bool
    at: float = 1.0
    contact: Contact | None = None
    clearance: float = np.inf
