"""What a running cell tells whoever watches it: viewer, recorder, report, wire."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

from armcell.core.contact import Contact
from armcell.core.joints import JointState, JointTrajectory
from armcell.core.transforms import SE3


@dataclass(frozen=True, eq=False)
class StateSample:
    """The cell at one instant of its own clock."""

    time: float  # [s]
    joints: JointState  # all actuated joints, with velocities and efforts where known
    object_poses: dict[str, SE3] = field(default_factory=dict)  # T_world_object, movable objects
    gripper_width: dict[str, float] = field(default_factory=dict)  # [m] by gripper
    gripper_force: dict[str, float] = field(default_factory=dict)  # [N] per finger, by gripper
    targets: JointState | None = None  # what the joints were last told to be, where the driver knows
    contacts: tuple[Contact, ...] = ()  # of physics; a real robot sees none


@dataclass(frozen=True, eq=False)
class Event:
    """Something that happened: a stage began or ended, a weld was made, a contact was unwanted.

    `kind` is one of "stage", "plan", "scene", "grasp", "weld", "contact", "stop", "error", "note". A stage's
    event has its name as text and `data["phase"]` "begin" or "end"; a plan's has the evidence it was made
    with; a scene's has what was added, moved, removed or allowed.
    """

    time: float
    kind: str
    text: str
    data: dict[str, Any] = field(default_factory=dict)


class Observer(Protocol):
    """Called from the thread that steps the cell; must return quickly."""

    def on_state(self, sample: StateSample) -> None: ...

    def on_event(self, event: Event) -> None: ...

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None: ...
