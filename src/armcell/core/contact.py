"""A contact between two bodies of a robot cell."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Contact:
    """Contact between two bodies (links or objects) that touch or are close to each other.

    `distance` [m] is negative in penetration; `position` (3,) is in the world frame [m].
    """

    body_a: str
    body_b: str
    distance: float
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def describe(self) -> str:
        if self.distance <= 0:
            return f"{self.body_a} touches {self.body_b} ({-self.distance * 1000:.1f} mm deep)"
        return f"{self.body_a} is {self.distance * 1000:.1f} mm from {self.body_b}"
