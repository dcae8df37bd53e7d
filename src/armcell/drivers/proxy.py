"""Base class of drivers that wrap another driver and change a part of its behavior."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Self

from numpy.typing import ArrayLike

from armcell.core import SE3, Contact, JointState, JointTrajectory, Outcome, Playback
from armcell.drivers.driver import Array, Capability, ContactRecord, Driver, GripperReading, WeldRecord
from armcell.drivers.execution_handle import ExecutionHandle
from armcell.drivers.motion_guard import ExecutionMonitor, MotionGuard
from armcell.drivers.safety import Fault, SafetyEvent
from armcell.sim import SimWorld


class DriverProxy(Driver):
    """Proxy driver, which passes every call on to another driver.
    It is the base class of drivers that wrap others.

    A proxy has its driver's capabilities except `PLAY_PARTS`: the driver would play without the proxy's
    `command` and `advance`. A subclass that leaves both alone may add it again.
    """

    def __init__(self, driver: Driver):
        self._driver = driver

    @property
    def capabilities(self) -> frozenset[Capability]:
        return self._driver.capabilities - {Capability.PLAY_PARTS}

    # --- attributes ---
    @property
    def name(self) -> str:
        return self._driver.name

    @property
    def period(self) -> float:
        return self._driver.period

    @property
    def is_simulated(self) -> bool:
        return self._driver.is_simulated

    @property
    def is_paced(self) -> bool:
        return self._driver.is_paced

    @property
    def lock(self) -> AbstractContextManager[Any]:
        return self._driver.lock

    @property
    def world(self) -> SimWorld | None:
        return self._driver.world

    @property
    def wants_guard(self) -> bool:
        return self._driver.wants_guard

    @property
    def guard(self) -> MotionGuard | None:
        return self._driver.guard

    @guard.setter
    def guard(self, guard: MotionGuard | None) -> None:
        self._driver.guard = guard

    # --- connection and time ---
    def __enter__(self) -> Self:
        self._driver.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        self._driver.__exit__(*exc)

    @property
    def now(self) -> float:
        return self._driver.now

    def advance(self, duration: float) -> None:
        self._driver.advance(duration)

    # --- arms ---
    def joint_state(self) -> JointState:
        return self._driver.joint_state()

    def command(
        self, joint_names: tuple[str, ...], positions: ArrayLike, velocities: ArrayLike
    ) -> JointState:
        return self._driver.command(joint_names, positions, velocities)

    def targets(self) -> JointState | None:
        return self._driver.targets()

    def stop(self) -> None:
        self._driver.stop()

    def hold(self, joint_names: tuple[str, ...]) -> None:
        self._driver.hold(joint_names)

    # --- faults ---
    def fault(self) -> Fault | None:
        return self._driver.fault()

    def resume(self) -> None:
        self._driver.resume()

    @property
    def safety_events(self) -> Sequence[SafetyEvent]:
        return self._driver.safety_events

    # --- grippers and objects ---
    def command_gripper(self, gripper: str, width: float, force: float) -> None:
        self._driver.command_gripper(gripper, width, force)

    def gripper(self, gripper: str) -> GripperReading:
        return self._driver.gripper(gripper)

    def object_poses(self) -> dict[str, SE3]:
        return self._driver.object_poses()

    def correct_object_pose(self, name: str, T_world_object: SE3) -> None:
        self._driver.correct_object_pose(name, T_world_object)

    def true_poses(self) -> dict[str, SE3]:
        return self._driver.true_poses()

    def welds(self) -> list[WeldRecord]:
        return self._driver.welds()

    # --- contacts and forces ---
    def contacts(self) -> list[Contact]:
        return self._driver.contacts()

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        self._driver.expect_contact(body, others, expected)

    def watch_object(self, name: str, supports: Iterable[str] = ()) -> None:
        self._driver.watch_object(name, supports)

    def unwatch_object(self, name: str) -> None:
        self._driver.unwatch_object(name)

    def unwanted_contacts(self) -> list[ContactRecord]:
        return self._driver.unwanted_contacts()

    def wrench(self, gripper: str) -> Array:
        return self._driver.wrench(gripper)

    # --- trajectories ---
    def follow(self, trajectory: JointTrajectory) -> ExecutionHandle:
        return self._driver.follow(trajectory)

    def play(
        self, joint_names: tuple[str, ...], playback: Playback, began: float, until: float, tolerance: float
    ) -> tuple[float, int]:
        return self._driver.play(joint_names, playback, began, until, tolerance)

    def dry_run(self, trajectory: JointTrajectory) -> Outcome | None:
        return self._driver.dry_run(trajectory)

    def monitor_execution(self, trajectory: JointTrajectory, forced: bool) -> ExecutionMonitor:
        return self._driver.monitor_execution(trajectory, forced)

    # --- real arms ---
    @property
    def latency(self) -> float:
        return self._driver.latency

    @property
    def next_command_time(self) -> float:
        return self._driver.next_command_time

    @property
    def speed_fraction(self) -> float:
        return self._driver.speed_fraction

    def arm_modes(self) -> Mapping[str, tuple[int, int]]:
        return self._driver.arm_modes()

    def calibrations(self) -> Mapping[str, str]:
        return self._driver.calibrations()
