"""The `Driver` base class: the interface of every robot, simulated or real."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, Contact, InputError, JointState, JointTrajectory, Outcome, Playback, Registry
from armcell.core.checks import checked
from armcell.drivers.execution_handle import ExecutionHandle
from armcell.drivers.motion_guard import ExecutionMonitor, MotionGuard
from armcell.drivers.safety import Fault, SafetyEvent
from armcell.scene import PlanningScene
from armcell.sim import SimWorld

Array = NDArray[np.float64]


class Capability(Enum):
    """Optional abilities of a robot driver. Each value completes the sentence "the driver can ..."."""

    PLAY_TRAJECTORY = "play a whole trajectory itself"  # follow
    PLAY_PARTS = "play a part of a trajectory in one call"  # play
    DRY_RUN = "dry-run a trajectory before the robot executes it"  # rehearse, watch
    ROBOT_CLOCK = "stream setpoints by the robot's own clock"  # tick, latency, speed_fraction
    MEASURE_FORCE = "measure the wrench on a gripper"  # wrench
    KNOW_CONTACTS = "detect contacts of robot and objects"  # contacts, unwanted_contacts
    REPORT_MODES = "report the robot mode and safety mode of each arm"  # arm_modes


@dataclass(frozen=True)
class GripperReading:
    """Reading that a driver returns for a gripper: its opening, its force and the object that it holds."""

    width: float  # [m]
    force_per_finger: float  # [N] mean per cup for a suction gripper
    held: str | None = None  # object that the fingers or cups hold, if the driver detects it
    fault: str = ""  # reason for which the gripper did not execute its last command
    sealed: tuple[int, int] | None = None  # cups that hold the object, and all cups; None for jaws
    vacuum: float | None = None  # [kPa] below ambient, highest of the cups; None for jaws or if unknown

    def describe(self) -> str:
        """Describe a driver's gripper reading in words: the held object, and the distance between the fingers
        or, for suction cups, the vacuum.
        """
        if self.sealed is None:
            apart = f"measured: {self.width * 1000:.1f} mm apart"
            return f"{self.held or 'nothing'} is between the fingers ({apart})"
        level = "" if self.vacuum is None else f", vacuum {self.vacuum:.0f} kPa"
        hold = f"measured: {self.sealed[0]} of {self.sealed[1]} hold{level}"
        return f"{self.held or 'nothing'} is on the cups ({hold})"


@dataclass(frozen=True)
class ContactRecord:
    """Record of an unexpected contact that a robot driver observed."""

    body_a: str
    body_b: str
    time: float  # [s]
    depth: float  # [m]
    count: int


@dataclass(frozen=True)
class WeldRecord:
    """Record of a weld: a driver attached an object to a gripper by a
    constraint instead of holding it by friction.
    """

    object: str
    gripper: str
    time: float
    reason: str
    released_at: float | None = None


@dataclass(frozen=True)
@checked()
class DriverOptions:
    """Options that a cell passes to every driver. Each driver reads only some of them."""

    seed: int = 0
    time_scale: float | None = None  # None: lock-step; 1.0: real time
    physics: Any = None  # armcell.sim.PhysicsSettings
    cameras: tuple = ()
    decals: tuple = ()  # images on objects, for the cameras
    extra: dict[str, Any] = field(default_factory=dict)


class Driver(ABC):
    """Base class of drivers.
    A driver is the connection to a real or simulated robot, and `with driver:` connects.

    The constructor performs no I/O. Time is the driver's own clock [s]; only `advance` moves it forward, so
    callers never sleep. One thread drives the robot. Other threads may read the state while they hold `lock`.

    A subclass implements the abstract methods. It lists in `capabilities` what it can do beyond them, and
    implements the methods of these capabilities. Wrappers of a driver derive from `DriverProxy`.

    Attributes:
        period: interval between commands [s].
        is_paced: True if the driver's clock follows wall time; callers must not block between two steps.
        capabilities: what the driver can do beyond the basic commands.
        lock: held while the state changes: joints and objects read under the lock belong to the same instant.
        world: physics of a simulated robot, once it is connected; None for other robots.
        wants_guard: True if the cell must set `guard` before it connects the driver.
        guard: dry-runs the motions and compares real arms with the dry run; None: motions are not guarded.
    """

    name: str
    period: float
    is_simulated: bool
    is_paced: bool = False
    capabilities: frozenset[Capability] = frozenset()
    lock: AbstractContextManager[Any] = nullcontext()
    world: SimWorld | None = None
    wants_guard: bool = False
    guard: MotionGuard | None = None

    # --- connection and time ---
    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(self, *exc: object) -> None: ...

    @property
    @abstractmethod
    def now(self) -> float:
        """Return the present time [s] on the clock of a robot driver."""

    @abstractmethod
    def advance(self, duration: float) -> None:
        """Advance the clock of the robot driver by `duration` [s]."""

    # --- arms ---
    @abstractmethod
    def joint_state(self) -> JointState:
        """Return the state of all actuated joints from a robot driver, in the order of the model."""

    @abstractmethod
    def command(
        self, joint_names: tuple[str, ...], positions: ArrayLike, velocities: ArrayLike
    ) -> JointState:
        """Send target positions and velocities [rad, rad/s] for joints to a robot driver. Return the
        setpoints that were actually sent.
        """

    def targets(self) -> JointState | None:
        """Return the joint positions that the driver last commanded to the arms,
        or None before the first command.
        """
        return None

    @abstractmethod
    def stop(self) -> None:
        """Stop the robot of a driver immediately, and hold its measured joint positions."""

    def hold(self, joint_names: tuple[str, ...]) -> None:
        """Stop those arms of a driver that own the given joints, at their measured positions.
        Other arms continue.
        """
        names = tuple(joint_names)
        q = self.joint_state().reindexed(names).positions
        self.command(names, q, np.zeros(len(q)))

    # --- faults ---
    def fault(self) -> Fault | None:
        """Return the fault that at present prevents the driver's robot from moving, or None."""
        return None

    def resume(self) -> None:
        """Make a driver's robot ready for motions again after a stop, without moving it.
        Old goals are discarded.

        If nothing has stopped the robot, the call has no effect, even during a motion. Any thread may call
        this.

        Raises:
            ArmcellError: the driver cannot make the robot ready. The message states the reason and the
                remedy, and the robot stays stopped.
        """
        return None

    @property
    def safety_events(self) -> Sequence[SafetyEvent]:
        """Return all stops and resumes of a driver's real arms so far, each with its time and cause. The list
        is empty for drivers without real arms.
        """
        return ()

    # --- grippers and objects ---
    @abstractmethod
    def command_gripper(self, gripper: str, width: float, force: float) -> None:
        """Move a driver's gripper to a width [m] with limited force [N] per finger.
        Use a width of 0 to grasp an object. A suction gripper turns its vacuum on at width 0, else off.
        """

    @abstractmethod
    def gripper(self, gripper: str) -> GripperReading: ...

    @abstractmethod
    def object_poses(self) -> dict[str, SE3]:
        """Return T_world_object of the movable objects whose poses a driver knows."""

    def correct_object_pose(self, name: str, T_world_object: SE3) -> None:
        """Correct the pose of an object that a driver does not measure but only believes. A driver that
        measures the pose ignores the correction.
        """
        return None

    def true_poses(self) -> dict[str, SE3]:
        """Return the true T_world_object of objects from the physics of
        a simulated driver, without camera errors.

        Without physics, the poses are those that the driver reports.
        """
        return self.object_poses()

    def welds(self) -> list[WeldRecord]:
        """Return the records of all welds by the driver so far: objects attached to a gripper by a constraint
        instead of friction.
        """
        return []

    # --- contacts: Capability.KNOW_CONTACTS ---
    def contacts(self) -> list[Contact]:
        """Return the present contacts of a driver's robot.
        The result is empty if the driver cannot detect contacts.
        """
        return []

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        """Declare to a driver that contact between a body and other bodies is part of the task,
        or revoke that declaration.
        """
        return None

    def watch_object(self, name: str, supports: Iterable[str] = ()) -> None:
        """Start watching a held object: from now on, the driver reports every contact of the object,
        except with its supports.
        """
        return None

    def unwatch_object(self, name: str) -> None:
        """Stop watching an object, so that the driver no longer reports the contacts of the object."""
        return None

    def unwanted_contacts(self) -> list[ContactRecord]:
        """Return the unexpected contacts that the driver has observed so far: those that the task has not
        declared.
        """
        return []

    # --- forces: Capability.MEASURE_FORCE ---
    def wrench(self, gripper: str) -> Array:
        """Return the external wrench (6,) on a gripper as a driver measures it:
        the force [N], then the torque [Nm].

        The torque is about the TCP, the axes are the world's, and the hand's own weight is excluded. The
        wrench is zero for a robot without force sensing.
        """
        return np.zeros(6)

    # --- whole trajectories: Capability.PLAY_TRAJECTORY ---
    def follow(self, trajectory: JointTrajectory) -> ExecutionHandle:
        """Start a whole trajectory, which the driver executes without further commands from the caller.
        Return a handle to monitor or cancel the trajectory.

        Raises:
            InputError: the robot may not move, or the trajectory names joints that are not arm joints.
        """
        raise self._incapable(Capability.PLAY_TRAJECTORY)

    # --- parts of a trajectory: Capability.PLAY_PARTS ---
    def play(
        self, joint_names: tuple[str, ...], playback: Playback, began: float, until: float, tolerance: float
    ) -> tuple[float, int]:
        """Let the robot driver play part of a trajectory: until a time [s], or until the tracking error
        exceeds the tolerance.

        At least one driver period passes.

        Args:
            began: driver time [s] at which the trajectory started.
            until: trajectory time [s] at which to return.
            tolerance: largest tracking error [rad or m] of a joint.
        Returns:
            The largest tracking error [rad or m] and the index of its joint.
        """
        raise self._incapable(Capability.PLAY_PARTS)

    # --- dry runs: Capability.DRY_RUN ---
    def dry_run(self, trajectory: JointTrajectory) -> Outcome | None:
        """Let a driver dry-run a trajectory in simulation. Return the reason not to execute it, or None."""
        raise self._incapable(Capability.DRY_RUN)

    def monitor_execution(self, trajectory: JointTrajectory, forced: bool) -> ExecutionMonitor:
        """Return a driver's monitor that compares a streamed motion with the most recent dry run.

        Args:
            forced: True if measured forces modify the motion, so that currents and speeds are not compared.
        """
        raise self._incapable(Capability.DRY_RUN)

    # --- streaming by the robot's clock: Capability.ROBOT_CLOCK ---
    @property
    def latency(self) -> float:
        """Return the time [s] by which the joint state that a driver measures may lag behind the streamed
        setpoints.
        """
        raise self._incapable(Capability.ROBOT_CLOCK)

    @property
    def next_command_time(self) -> float:
        """Return the driver's time [s] for the next command. Each call of `advance` adds its duration to this
        time.
        """
        raise self._incapable(Capability.ROBOT_CLOCK)

    @property
    def speed_fraction(self) -> float:
        """Return the current speed scaling of a driver's slowest arm, as a fraction of full speed (0..1), if
        this kind of driver has speed sliders or pauses.
        """
        raise self._incapable(Capability.ROBOT_CLOCK)

    # --- modes: Capability.REPORT_MODES ---
    def arm_modes(self) -> Mapping[str, tuple[int, int]]:
        """Return the robot mode and safety mode of each arm, as numbers of `ur_dashboard_msgs`, if this kind
        of driver reports modes.
        """
        raise self._incapable(Capability.REPORT_MODES)

    # --- twin ---
    def calibrations(self) -> Mapping[str, str]:
        """Return the checksum of each real arm's factory calibration. Drivers without real arms return an
        empty mapping.
        """
        return {}

    def _incapable(self, capability: Capability) -> InputError:
        known = ", ".join(sorted(c.name for c in self.capabilities)) or "none"
        return InputError(
            f"the driver {self.name!r} cannot {capability.value}",
            hint=f"check {capability.name} in 'driver.capabilities' first; this driver has: {known}",
        )


class DriverFactory(Protocol):
    def __call__(self, scene: PlanningScene, options: DriverOptions) -> Driver: ...


drivers: Registry[DriverFactory] = Registry("mode", "armcell.drivers")
"""Driver factories by the mode that uses them: sim, fake, real."""
