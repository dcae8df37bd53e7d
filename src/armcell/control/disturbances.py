"""What is wrong with a robot and what happens to it: values of a cell that campaigns vary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Push:
    """A force on a link or a movable object, at its centre of mass, in world axes.

    Attributes:
        on: link or object.
        at: [s] when it begins, on the driver's clock.
        duration: [s]
        force: [N]
    """

    on: str
    at: float
    duration: float
    force: tuple[float, float, float]


@dataclass(frozen=True)
class Move:
    """An object put elsewhere, which nobody but a camera is told.

    Attributes:
        object: fixed or movable.
        at: [s] when, on the driver's clock.
        by: [m] from where it then is, in world axes.
        turn: [rad] about the upright axis through its origin.
    """

    object: str
    at: float
    by: tuple[float, float, float]
    turn: float


@dataclass(frozen=True)
class Disturbances:
    """None by default.

    Attributes:
        joint_offsets: [rad] by joint: how much further it really stands than its encoder says.
        joint_noise: [rad] standard deviation of an arm's measured positions, each joint and time by itself.
        latency: [s] from a command to the arm until it acts.
        pushes: forces from outside.
        moves: objects put elsewhere.
    """

    joint_offsets: Mapping[str, float] = field(default_factory=dict)
    joint_noise: float = 0.0
    latency: float = 0.0
    pushes: tuple[Push, ...] = ()
    moves: tuple[Move, ...] = ()

    def __bool__(self) -> bool:
        of_the_arm = any(self.joint_offsets.values()) or self.joint_noise or self.latency
        return bool(of_the_arm or self.pushes or self.moves)
