"""The Driver protocol: the interface that every robot, simulated or real, implements."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, Contact, JointState, JointTrajectory, Outcome, Playback, Registry
from armcell.core.checks import checked
from armcell.drivers.following import Following, SentClock
from armcell.drivers.safety import Fault
from armcell.scene import PlanningScene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GripperReading:
    """State that a gripper reports: its opening, its force, and the object it holds."""

    width: float  # [m]
    force_per_finger: float  # [N]
    held: str | None = None  # object between the fingers, if the driver detects it


@dataclass(frozen=True)
class ContactRecord:
    """An unexpected contact that a driver observed."""

    body_a: str
    body_b: str
    time: float  # [s]
    depth: float  # [m]
    count: int


@dataclass(frozen=True)
class WeldRecord:
    """An object that a constraint other than friction attached to a gripper."""

    object: str
    gripper: str
    time: float
    reason: str
    released_at: float | None = None


@dataclass(frozen=True)
@checked()
class DriverOptions:
    """Options that a cell passes to every driver; each driver reads the ones it needs."""

    seed: int = 0
    time_scale: float | None = None  # None: lock-step; 1.0: real time
    physics: Any = None  # armcell.sim.PhysicsSettings
    cameras: tuple = ()
    decals: tuple = ()  # images on objects, for the cameras
    extra: dict[str, Any] = field(default_factory=dict)


class Driver(Protocol):
    """A connection to a robot, real or simulated; `with driver:` connects and disconnects.

    The constructor performs no I/O. Time is the driver's own clock [s]; only `advance` moves it forward, so
    callers never sleep. One thread drives the robot. If other threads may read the state, the driver also
    has a `lock`, held while the state changes: joints and objects read under the lock belong to the same
    instant.
    """

    name: str
    period: float  # [s] between commands
    is_simulated: bool

    @property
    def is_paced(self) -> bool:
        """Whether the driver's clock follows wall time; callers must not block between two steps."""
        ...

    def __enter__(self) -> Driver: ...
    def __exit__(self, *exc: object) -> None: ...

    @property
    def now(self) -> float: ...

    def joint_state(self) -> JointState:
        """Return the state of all actuated joints, in the model's order."""
        ...

    def command(
        self, joint_names: tuple[str, ...], positions: ArrayLike, velocities: ArrayLike
    ) -> JointState:
        """Set the joint targets [rad, rad/s] and return the setpoints that were actually sent."""
        ...

    def command_gripper(self, gripper: str, width: float, force: float) -> None:
        """Drive the gripper to a width [m] with a limited force per finger [N]; width 0 grasps."""
        ...

    def gripper(self, gripper: str) -> GripperReading: ...

    def wrench(self, gripper: str) -> Array:
        """Return the external wrench on a gripper: force [N], then torque [Nm] (6,).

        The torque is about the TCP, the axes are the world's, and the hand's own weight is excluded. The
        wrench is zero for a robot without force sensing.
        """
        ...

    def advance(self, duration: float) -> None:
        """Advance the driver's clock by `duration` [s]."""
        ...

    def stop(self) -> None:
        """Stop the robot immediately and hold its measured joint positions."""
        ...

    def resume(self) -> None:
        """Make a stopped robot ready for motions again, without moving it; old goals are discarded.

        If nothing has stopped the robot, the call has no effect, even during a motion. Any thread may call
        this.

        Raises:
            ArmcellError: the driver cannot make the robot ready. The message states the reason and the
                remedy, and the robot stays stopped.
        """
        ...

    def object_poses(self) -> dict[str, SE3]:
        """Return T_world_object of the movable objects that the driver knows."""
        ...

    def targets(self) -> JointState | None:
        """Return the last commanded arm joint positions, or None before the first command."""
        ...

    def contacts(self) -> list[Contact]:
        """Return the current contacts; an empty list from a driver that cannot detect contacts."""
        ...

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        """Declare that contacts of `body` with `others` are part of the task, or no longer are."""
        ...

    def watch_object(self, name: str, supports: Iterable[str] = ()) -> None:
        """Report every contact of a held object from now on, except contacts with its supports."""
        ...

    def unwatch_object(self, name: str) -> None: ...

    def unwanted_contacts(self) -> list[ContactRecord]: ...

    def welds(self) -> list[WeldRecord]: ...


class SeesNoContacts:
    """Contact methods of a driver without physics: no contact is ever reported."""

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
    """A driver that dry-runs a trajectory in simulation before the robot executes it."""

    def rehearse(self, trajectory: JointTrajectory) -> Outcome | None:
        """Simulate the trajectory; return the reason not to execute it, or None."""
        ...

    def watch(self, trajectory: JointTrajectory, forced: bool) -> Watch:
        """Return a monitor that compares a streamed motion with the most recent dry run.

        Args:
            forced: True if measured forces modify the motion, so that currents and speeds are not compared.
        """
        ...


class Watch(Protocol):
    """Monitor of a motion that the caller streams point by point."""

    def sent(self, clock: float, off: Array) -> None:
        """Record a point that the caller has commanded, for comparison with the dry run.

        Args:
            clock: time of the point on the trajectory [s].
            off: offset of the commanded point from the trajectory (n,).
        """
        ...

    def look(self) -> None: ...

    def end(self, how: str) -> None:
        """End the monitoring of a motion; `how` is "done" or the reason for the failure."""
        ...


class DryRunStage(Protocol):
    """The contact declarations of the simulation in which a guard dry-runs motions; see `Driver`."""

    def expect_contact(self, body: str, others: tuple[str, ...], expected: bool) -> None: ...

    def watch_object(self, name: str, supports: tuple[str, ...]) -> None: ...

    def unwatch_object(self, name: str) -> None: ...


class MotionGuard(Protocol):
    """Dry-runs the motions of real arms and compares the arms with the dry run; `twin.TwinGuard` is one.

    Attributes:
        trips: shortest recent network round trip [s], by arm.
        note: called with (arm name, kind, text) for each action of the guard.
    """

    trips: Mapping[str, Callable[[], float]]
    note: Callable[[str, str, str], None]

    @property
    def stage(self) -> DryRunStage: ...

    @property
    def motions(self) -> list[Any]: ...  # recorded motions, while the guard learns

    def check_calibration(self, found: Mapping[str, str]) -> None: ...

    def rehearse(
        self,
        trajectory: JointTrajectory,
        state: JointState,
        poses: Mapping[str, SE3],
        held: Mapping[str, str],
    ) -> Outcome | None: ...

    def watching(
        self, following: Following, trajectory: JointTrajectory, arms: Iterable[Any],
        trip: Callable[[Fault], None], sent_for: SentClock | None = None, forced: bool = False,
    ) -> Following: ...  # fmt: skip


class Player(Protocol):
    """A driver that plays parts of a trajectory itself, with less overhead between the commands."""

    def play(
        self, joint_names: tuple[str, ...], playback: Playback, began: float, until: float, tolerance: float
    ) -> tuple[float, int]:
        """Play the trajectory until `until` [s] or until a tracking error exceeds the tolerance.

        At least one driver period passes.

        Args:
            began: driver time [s] at which the trajectory started.
            until: trajectory time [s] at which to return.
            tolerance: largest tracking error [rad or m] of a joint.
        Returns:
            The largest tracking error [rad or m] and the index of its joint.
        """
        ...


class ReportsModes(Protocol):
    """A driver of real arms that report their robot mode and safety mode."""

    def arm_modes(self) -> Mapping[str, tuple[int, int]]:
        """Return (robot mode, safety mode) by arm, in Universal Robots' numbers (`ur_wire.modes`)."""
        ...


class DriverFactory(Protocol):
    def __call__(self, scene: PlanningScene, options: DriverOptions) -> Driver: ...


drivers: Registry[DriverFactory] = Registry("mode", "armcell.drivers")
"""Driver factories by the mode that uses them: sim, fake, real."""
