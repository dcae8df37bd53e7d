"""What a running task knows: the driver, the true scene, who watches, what has been done."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from armcell.control import Driver
from armcell.core import SE3, Event, JointTrajectory, Observer, Outcome, StateSample
from armcell.model import Gripper
from armcell.scene import PlanningScene, scene_changes
from armcell.tasks.settings import TaskSettings

OBSERVER_PERIOD = 0.01  # [s] of the driver's clock between samples given to observers


@dataclass
class StageReport:
    """One line of the stage table."""

    name: str
    planner: str = ""
    planning_time_s: float = 0.0  # wall clock
    motion_time_s: float = 0.0  # driver's clock
    clearance_m: float | None = None
    slip_m: float | None = None  # of the held object in the gripper during the stage
    error: str = ""
    ok: bool = True
    started_s: float = 0.0  # driver's clock

    def as_dict(self) -> dict[str, Any]:
        return dict(self.__dict__)


@dataclass
class Holding:
    """An object in a gripper, as the task believes and the scene shows it."""

    object: str
    gripper: Gripper
    T_tcp_object: SE3  # when it was grasped


class TaskContext:
    """The live side of a task. `scene()` is always made from what the driver measures."""

    def __init__(
        self,
        driver: Driver,
        scene: PlanningScene,
        settings: TaskSettings = TaskSettings(),
        observers: Sequence[Observer] = (),
        seed: int = 0,
        cancel: threading.Event | None = None,
    ):
        self.driver, self.settings, self.observers, self.seed = driver, settings, list(observers), seed
        self.cancel = cancel or threading.Event()
        self._base = scene
        self.holding: dict[str, Holding] = {}  # by object
        self.reports: list[StageReport] = []
        self.events: list[Event] = []
        self._next_sample = 0.0
        self._stops_told = 0  # of the safety supervisor's events
        self._told = (0, 0)  # welds and unwanted contacts that were reported

    # --- truth ---
    def scene(self) -> PlanningScene:
        """The planning scene as it is now: measured joints, object poses, held objects attached."""
        model = self._base.model
        q = np.clip(self.driver.joint_state().positions, model.lower, model.upper)
        scene = replace(self._base, positions=q)
        for name, pose in self.driver.object_poses().items():
            if name in scene.objects:
                scene = scene.with_object_pose(name, pose)
        for held in self.holding.values():
            scene = scene.with_attached(held.object, held.gripper.tcp_link, held.gripper.hand_links)
        return scene

    @property
    def base(self) -> PlanningScene:
        """The world the task plans in, with nothing of it measured."""
        return self._base

    def change_scene(self, scene: PlanningScene) -> None:
        """Replace the world the task plans in (objects added or removed); the state stays measured."""
        before, self._base = self._base, scene
        if self.observers and (changes := scene_changes(before, scene)):
            words = [
                f"{kind} {', '.join(map(str, what))}" for kind, what in changes.items() if kind != "allowed"
            ]
            words += [f"{a} may{'' if yes else ' not'} touch {b}" for a, b, yes in changes.get("allowed", ())]
            self.emit("scene", "; ".join(words), **changes)

    def slip_of(self, held: Holding) -> float:
        """How far the held object has moved in the gripper since `T_tcp_object` was taken [m]."""
        return held.T_tcp_object.distance_to(self.T_tcp_object(held.object, held.gripper))[0]

    def T_tcp_object(self, item: str, gripper: Gripper) -> SE3:
        scene = replace(self._base, positions=self.driver.joint_state().positions)
        return scene.frame_pose(gripper.tcp_link).inv() @ self.driver.object_poses()[item]

    # --- the way ---
    def clear(self, motion: Any) -> JointTrajectory | Outcome:
        """The motion (a `steps.Motion`) as it may begin now, or why it may not. Alone, an arm just may."""
        return motion.trajectory

    def rested(self) -> None:
        """The arm has come to rest after a motion."""

    def reserve(self, zone: str) -> AbstractContextManager[None]:
        """A zone for one arm at a time. Alone, an arm just has it."""
        return nullcontext()

    def meet(self, name: str) -> None:
        """Wait for the other arm at a point of both programs. Alone, an arm does not wait."""

    # --- time ---
    def advance(self, duration: float) -> None:
        """Let time pass [s], with observers served and cancel obeyed."""
        end = self.driver.now + duration
        while self.driver.now < end - 1e-9 and not self.cancel.is_set():
            self.driver.advance(min(self.driver.period, end - self.driver.now))
            self.observe()

    def observe(self) -> None:
        """Give the observers a sample if one is due, and tell what physics did unasked."""
        if not self.observers or self.driver.now < self._next_sample:
            return
        self.report_news()
        self._next_sample = self.driver.now + OBSERVER_PERIOD - 1e-9
        readings = {name: self.driver.gripper(name) for name in self._base.model.grippers}
        sample = StateSample(
            self.driver.now,
            self.driver.joint_state(),
            self.driver.object_poses(),
            {n: r.width for n, r in readings.items()},
            {n: r.force_per_finger for n, r in readings.items()},
            self.driver.targets(),
            tuple(self.driver.contacts()),
        )
        for observer in self.observers:
            observer.on_state(sample)

    def report_news(self) -> None:
        """Events for welds, unwanted contacts and stops of real arms that are new."""
        welds, contacts = self.driver.welds(), self.driver.unwanted_contacts()
        for weld in welds[self._told[0] :]:
            self.emit("weld", f"{weld.object} is welded to {weld.gripper}: {weld.reason}")
        for contact in contacts[self._told[1] :]:
            self.emit("contact", f"{contact.body_a} touches {contact.body_b}", depth_m=contact.depth)
        self._told = (len(welds), len(contacts))
        safety = getattr(self.driver, "safety_events", ())  # of real arms
        for event in safety[self._stops_told :]:
            self._stops_told += 1
            kind = "note" if event.kind == "twin" else "stop"
            self.emit(kind, f"{event.arm}: {event.kind}: {event.text}", cause=event.kind)

    # --- telling ---
    def emit(self, kind: str, text: str, **data: Any) -> None:
        event = Event(self.driver.now, kind, text, data)
        self.events.append(event)
        for observer in self.observers:
            observer.on_event(event)

    def announce(self, trajectory: JointTrajectory) -> None:
        for observer in self.observers:
            observer.on_trajectory(self.driver.now, trajectory)


@dataclass
class Rejections:
    """Why candidates were not used: counts by stage and reason, and the text of the first of each."""

    counts: dict[tuple[str, str], int] = field(default_factory=dict)
    details: list[tuple[str, str, str]] = field(default_factory=list)  # stage, candidate, reason

    def add(self, stage: str, candidate: str, reason: str) -> None:
        short = reason.split(":")[0].split(" (")[0]
        self.counts[(stage, short)] = self.counts.get((stage, short), 0) + 1
        self.details.append((stage, candidate, reason))

    def summary(self) -> str:
        if not self.details:
            return "no candidates"
        _, candidate, reason = self.details[0]
        counted = ", ".join(
            f"{n} x {s}: {r}" for (s, r), n in sorted(self.counts.items(), key=lambda kv: -kv[1])[:4]
        )
        first = f"; the best one, {candidate!r}: {reason}" if candidate else ""
        return f"{len(self.details)} rejected ({counted}){first}"
