"""The Driver protocol: what every robot, simulated or real, offers to the rooms above."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, Contact, JointState, JointTrajectory, Outcome, Playback, Registry
from armcell.core.checks import checked
from armcell.scene import PlanningScene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GripperReading:
    """What a gripper reports."""

    width: float  # [m]
    force_per_finger: float  # [N]
    held: str | None = None  # object between the fingers, where the driver can tell


@dataclass(frozen=True)
class ContactRecord:
    """A contact nobody asked for, as the driver saw it."""

    body_a: str
    body_b: str
    time: float  # [s]
    depth: float  # [m]
    count: int


@dataclass(frozen=True)
class WeldRecord:
    """An object held by something else than friction."""

    object: str
    gripper: str
    time: float
    reason: str
    released_at: float | None = None


@dataclass(frozen=True)
@checked()
class DriverOptions:
    """What a cell gives every driver; each takes what it needs."""

    seed: int = 0
    time_scale: float | None = None  # None: lock-step; 1.0: real time
    physics: Any = None  # sim's PhysicsSettings
    cameras: tuple = ()
    decals: tuple = ()  # pictures on things, for the cameras
    extra: dict[str, Any] = field(default_factory=dict)


class Driver(Protocol):
    """A connected robot. Connect and disconnect by `with driver:`; the constructor does no I/O.

    Time is the driver's own clock [s]; `advance` is the only thing that lets it pass, so no caller sleeps.
    One thread drives it. Where others may look meanwhile it has a `lock`, too, which is held while the state
    changes: joints and objects that are read within it are of one moment.
    """

    name: str
    period: float  # [s] between commands
    is_simulated: bool

    @property
    def is_paced(self) -> bool:
        """Whether its clock keeps to the wall's: nothing that takes long may be done between two steps."""
        ...

    def __enter__(self) -> Driver: ...
    def __exit__(self, *exc: object) -> None: ...

    @property
    def now(self) -> float: ...

    def joint_state(self) -> JointState:
        """All actuated joints, in the model's order."""
        ...

    def command(
        self, joint_names: tuple[str, ...], positions: ArrayLike, velocities: ArrayLike
    ) -> JointState:
        """Set the joints' targets [rad, rad/s]; returns what was actually sent."""
        ...

    def command_gripper(self, gripper: str, width: float, force: float) -> None:
        """Drive to a width [m] with at most a force per finger [N]. Width 0 grasps."""
        ...

    def gripper(self, gripper: str) -> GripperReading: ...

    def wrench(self, gripper: str) -> Array:
        """Force [N] over torque [Nm] (6,) on a hand by what touches it, about its tcp, in world axes.

        Without the hand's own weight. Zero for a robot that feels nothing.
        """
        ...

    def advance(self, duration: float) -> None:
        """Let time pass [s]."""
        ...

    def stop(self) -> None:
        """Hold the measured position now."""
        ...

    def resume(self) -> None:
        """Make ready for motions again after whatever has stopped it. Nothing moves, old goals are forgotten.

        Where nothing has stopped it nothing happens, also while it moves. May be called from any thread.

        Raises:
            ArmcellError: it cannot be made ready from here; says why and what to do. It stays stopped.
        """
        ...

    def object_poses(self) -> dict[str, SE3]:
        """T_world_object of the movable objects, as far as the driver knows them."""
        ...

    def targets(self) -> JointState | None:
        """What the arm joints were last told to be; None before anything was."""
        ...

    def contacts(self) -> list[Contact]:
        """What touches now; a driver that cannot tell says nothing."""
        ...

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        """Contacts that are part of the task from now on (or no longer)."""
        ...

    def watch_object(self, name: str, supports: Iterable[str] = ()) -> None:
        """A held object may from now on touch nothing but its supports."""
        ...

    def unwatch_object(self, name: str) -> None: ...

    def unwanted_contacts(self) -> list[ContactRecord]: ...

    def welds(self) -> list[WeldRecord]: ...


class SeesNoContacts:
    """What a driver without physics says of contacts: nothing."""

    def contacts(self) -> list[Contact]:
        return []

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        pass

    def watch_object(self, name: str, supports: Iterable[str] = ()) -> None:
        pass

    def unwatch_object(self, name: str) -> None:
        pass

    def unwanted_contacts(self) -> list[ContactRecord]:
        return []

    def welds(self) -> list[WeldRecord]:
        return []


class Rehearsing(Protocol):
    """A driver that tries a trajectory elsewhere before a robot gets it."""

    def rehearse(self, trajectory: JointTrajectory) -> Outcome | None:
        """Why it must not be driven, or None."""
        ...

    def watch(self, trajectory: JointTrajectory, forced: bool) -> Watch:
        """Compare a motion that is commanded point by point with its rehearsal, which was the last.

        Args:
            forced: what is felt decides on the way, so forces and speeds say nothing.
        """
        ...


class Watch(Protocol):
    """A motion under way, told of by who commands it."""

    def sent(self, clock: float, off: Array) -> None:
        """A point was commanded: of this time [s] on the trajectory, and so far off it (n,)."""
        ...

    def look(self) -> None: ...

    def end(self, how: str) -> None:
        """done, or why not."""
        ...


class Player(Protocol):
    """A driver that plays a part of a trajectory by itself: the same commands, less between them."""

    def play(
        self, joint_names: tuple[str, ...], playback: Playback, began: float, until: float, tolerance: float
    ) -> tuple[float, int]:
        """Command and let time pass until `until` [s] on the trajectory, or a joint is off by more than a
        tolerance [rad or m]; at least one period.

        Args:
            began: the driver's time [s] at which the trajectory began.
        Returns:
            The largest error, and the index of its joint.
        """
        ...


class DriverFactory(Protocol):
    def __call__(self, scene: PlanningScene, options: DriverOptions) -> Driver: ...


drivers: Registry[DriverFactory] = Registry("mode")
"""Drivers by the name of the mode that uses them: sim, fake, real."""
