"""States and events that a running cell sends to observers such as viewers and recorders."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

from armcell.core.joints import JointState, JointTrajectory
from armcell.core.results import Contact
from armcell.core.transforms import SE3


@dataclass(frozen=True, eq=False)
class StateSample:
    """State of a robot cell at one instant, as passed to observers: joints, objects and grippers."""

    time: float  # [s]
    joints: JointState  # all actuated joints, with velocities and efforts where known
    object_poses: dict[str, SE3] = field(default_factory=dict)  # T_world_object, movable objects
    gripper_width: dict[str, float] = field(default_factory=dict)  # [m] by gripper
    gripper_force: dict[str, float] = field(default_factory=dict)  # [N] per finger, by gripper
    targets: JointState | None = None  # last commanded positions, if the driver knows them
    contacts: tuple[Contact, ...] = ()  # from physics; a real robot reports none


@dataclass(frozen=True, eq=False)
class Event:
    """Event during the run of a robot cell, for example the start of a stage, a weld, or an unwanted contact.

    `kind` is one of "stage", "plan", "scene", "grasp", "weld", "contact", "stop", "error", "note". The event
    of a stage has the stage's name as text and `data["phase"]` "begin" or "end"; the event of a plan contains
    the plan's evidence; the event of a scene lists added, moved, removed and allowed bodies.
    """

    time: float
    kind: str
    text: str
    data: dict[str, Any] = field(default_factory=dict)


class Observer(Protocol):
    """Base class for receivers of the states, events and trajectories of a robot cell.

    The thread that steps the cell calls the methods, so they must return quickly.
    """

    def on_state(self, sample: StateSample) -> None: ...

    def on_event(self, event: Event) -> None: ...

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None: ...
