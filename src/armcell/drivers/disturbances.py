"""Disturbances of a simulated cell: robot errors and events that a test campaign varies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Push:
    """Disturbance of a simulated cell: an external force that pushes a
    link or object at its center, given in world axes.

    Attributes:
        on: name of the link or object.
        at: start time [s] on the driver's clock.
        duration: [s]
        force: (3,) [N]
    """

    on: str
    at: float
    duration: float
    force: tuple[float, float, float]


@dataclass(frozen=True)
class Displacement:
    """Disturbance of a simulated cell that displaces an object during a run.
    Only cameras can observe the displacement.

    Attributes:
        object: name of a fixed or movable object.
        at: time [s] on the driver's clock.
        by: displacement (3,) [m] from the object's pose at that time, in world axes.
        turn: rotation [rad] about the vertical axis through the object's origin.
    """

    object: str
    at: float
    by: tuple[float, float, float]
    turn: float


@dataclass(frozen=True)
class Disturbances:
    """All disturbances of one simulated cell. By default there are none.

    Attributes:
        joint_offsets: joint name to offset [rad] of the true joint position from the encoder's reading.
        joint_noise: standard deviation [rad] of the measured arm positions, independent per joint and time.
        latency: delay [s] between a command to the arm and its effect.
        pushes: external forces.
        moves: displacements of objects.
    """

    joint_offsets: Mapping[str, float] = field(default_factory=dict)
    joint_noise: float = 0.0
    latency: float = 0.0
    pushes: tuple[Push, ...] = ()
    moves: tuple[Displacement, ...] = ()

    def __bool__(self) -> bool:
        of_the_arm = any(self.joint_offsets.values()) or self.joint_noise or self.latency
        return bool(of_the_arm or self.pushes or self.moves)
