"""What a running task knows: the driver, the true scene, who watches, what has been done."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterable, Sequence, Set
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from armcell.collision.kernel.world_part import object_part
from armcell.control import Driver, MotionGate
from armcell.core import SE3, Event, JointTrajectory, Observer, Outcome, StateSample
from armcell.model import Gripper
from armcell.scene import PlanningScene, new_obstacles, scene_changes
from armcell.tasks.failures import reason_in_short
from armcell.tasks.settings import TaskSettings
from armcell.tasks.world import World, without_measured

OBSERVER_PERIOD = 0.01  # [s] of the driver's clock between samples given to observers
UNWATCHED = 0.02  # [s] that pass at once where nobody watches


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
        self.world = World(scene)
        # Not kept alive by its gate: physics behind it is used again as soon as nobody holds it.
        self.gate = MotionGate(weakref.proxy(self))
        self.expected: set[frozenset[str]] = set()  # pairs whose contact is part of the task now
        self.holding: dict[str, Holding] = {}  # by object
        self.lost: dict[str, str] = {}  # by object that fell out of a hand and was not grasped again: how
        self.at_work: tuple[TaskContext, ...] = ()  # of arms side by side, that know now what they hold
        self.reports: list[StageReport] = []
        self.events: list[Event] = []
        self._next_sample = 0.0
        self._stops_told = 0  # of the safety supervisor's events
        self._told = (0, 0)  # welds and unwanted contacts that were reported

    # --- truth ---
    def scene(self) -> PlanningScene:
        """The planning scene as it is now: measured joints, object poses, held objects attached.

        From any thread, as `whole_scene` and `change_scene`.
        """
        return self.whole_scene()

    def whole_scene(self) -> PlanningScene:
        """The same with every arm, where `scene` is that of one of two."""
        return self._measured(self.base)

    def _measured(self, scene: PlanningScene) -> PlanningScene:
        model, driver = scene.model, self.driver
        with getattr(driver, "lock", nullcontext()):  # joints and objects of one moment
            q, poses = driver.joint_state().positions, driver.object_poses()
        scene = replace(scene, positions=np.clip(q, model.lower, model.upper))
        for name, pose in poses.items():
            if name in scene.objects:
                scene = scene.with_object_pose(name, pose)
        for held in self.hands():
            if held.object in scene.objects:
                scene = scene.with_attached(held.object, held.gripper.tcp_link, held.gripper.hand_links)
        return scene

    def hands(self) -> Iterable[Holding]:
        """What every hand holds."""
        contexts = self.at_work or (self,)
        return [held for ctx in contexts for held in list(ctx.holding.values())]

    @property
    def base(self) -> PlanningScene:
        """The world the task plans in, with nothing of it measured."""
        return self.world.scene

    def change_scene(self, make: Callable[[PlanningScene], PlanningScene]) -> PlanningScene:
        """Change the world the task plans in: objects added, changed, moved, removed, at once or not at all.

        At any time and from any thread, also while the arm moves: what is planned afterwards keeps to it, and
        a motion across whose rest something has come is stopped (`MotionGate`). Joints, what hands hold and
        the poses of bodies that the driver knows stay as they are measured.

        Args:
            make: makes another scene of the present one. Others' changes wait for it, so it should be quick.
        Returns:
            The scene as it is then.
        Raises:
            InputError: something that is held would be gone; or what `make` raises. Nothing is changed then.
        """
        with self.world.editing:
            before, now = self.base, self.whole_scene()
            after = without_measured(before, now, make(now), [held.object for held in self.hands()])
            for name in new_obstacles(before, after):
                object_part(after.objects[name])  # not on the time of who moves the arm
            self.world.scene = after
            if self.observers and (changes := scene_changes(before, after)):
                self.world.news.append(changes)
        self._tell_changes()
        return self.scene()

    def _tell_changes(self) -> None:
        """Changes in their order, by one thread at a time."""
        while self.world.news and self.world.telling.acquire(blocking=False):
            try:
                while self.world.news:
                    changes = self.world.news.popleft()
                    words = [
                        f"{kind} {', '.join(map(str, what))}"
                        for kind, what in changes.items()
                        if kind != "allowed"
                    ]
                    said = changes.get("allowed", ())
                    words += [f"{a} may{'' if yes else ' not'} touch {b}" for a, b, yes in said]
                    self.emit("scene", "; ".join(words), **changes)
            finally:
                self.world.telling.release()

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        """Contacts that are part of the task from now on (or no longer), for physics and the motion gate."""
        others = tuple(others)
        pairs = {frozenset((body, other)) for other in others}
        self.expected = self.expected | pairs if expected else self.expected - pairs
        self.driver.expect_contact(body, others, expected)

    def object_poses(self) -> dict[str, SE3]:
        """T_world_object of the objects that the driver measures."""
        return self.driver.object_poses()

    def expected_contacts(self) -> Set[frozenset[str]]:
        """Pairs of bodies whose contact is part of the task now."""
        return self.expected

    def clock(self) -> float:
        """The driver's [s]."""
        return self.driver.now

    @property
    def keeps_time(self) -> bool:
        """Whether motions are always as far along as the clock says: real arms may be slowed."""
        return self.driver.is_simulated

    def slip_of(self, held: Holding) -> float:
        """How far the held object has moved in the gripper since `T_tcp_object` was taken [m]."""
        return held.T_tcp_object.distance_to(self.T_tcp_object(held.object, held.gripper))[0]

    def T_tcp_object(self, item: str, gripper: Gripper) -> SE3:
        scene = replace(self.base, positions=self.driver.joint_state().positions)
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

    def choose(self, items: Sequence[str], zone: Callable[[str], str]) -> str:
        """The item to do next, so that the other arm is not in the way. Alone, the first."""
        return items[0]

    def meet(self, name: str) -> None:
        """Wait for the other arm at a point of both programs. Alone, an arm does not wait."""

    # --- time ---
    def advance(self, duration: float) -> None:
        """Let time pass [s], with observers served and cancel obeyed."""
        driver, end = self.driver, self.driver.now + duration
        alone = driver.is_simulated and not self.observers
        at_once = max(round(UNWATCHED / driver.period), 1) * driver.period if alone else driver.period
        while driver.now < end - 1e-9 and not self.cancel.is_set():
            driver.advance(min(at_once, end - driver.now))
            self.observe()

    @property
    def progress(self) -> Callable[[float], None] | None:
        """For `execute`: what is to be done after each command, if anything."""
        return (lambda _: self.observe()) if self.observers else None

    def observe(self) -> None:
        """Give the observers a sample if one is due, and tell what physics did unasked."""
        if not self.observers or self.driver.now < self._next_sample:
            return
        self.report_news()
        self._next_sample = self.driver.now + OBSERVER_PERIOD - 1e-9
        readings = {name: self.driver.gripper(name) for name in self.base.model.grippers}
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

    # --- what hands hold ---
    def take(self, held: Holding) -> None:
        """An object is in a hand now."""
        self.holding[held.object] = held
        self.lost.pop(held.object, None)

    def lose(self, item: str, text: str) -> None:
        """An object has fallen out of a hand: it belongs to the world again."""
        self.holding.pop(item, None)
        self.lost[item] = text
        self.emit("lost", text, object=item)

    # --- telling ---
    def emit(self, kind: str, text: str, **data: Any) -> None:
        event = Event(self.driver.now, kind, text, data)
        self.events.append(event)
        for observer in self.observers:
            observer.on_event(event)

    def announce(self, trajectory: JointTrajectory, plan: str = "", **evidence: Any) -> None:
        """Tell of a motion that begins.

        Args:
            plan: what it is; where given, its plan is told with this evidence.
        """
        for observer in self.observers:
            observer.on_trajectory(self.driver.now, trajectory)
        if plan:
            points, duration = len(trajectory.times), trajectory.duration
            self.emit("plan", plan, points=points, duration_s=duration, **evidence)


@dataclass
class Rejections:
    """Why candidates were not used: counts by stage and reason, and the text of the first of each."""

    counts: dict[tuple[str, str], int] = field(default_factory=dict)
    details: list[tuple[str, str, str]] = field(default_factory=list)  # stage, candidate, reason

    def add(self, stage: str, candidate: str, reason: str) -> None:
        short = reason_in_short(reason)
        self.counts[(stage, short)] = self.counts.get((stage, short), 0) + 1
        self.details.append((stage, candidate, reason))

    def summary(self) -> str:
        if not self.details:
            return "no candidates"
        _, candidate, reason = self.details[0]
        counted = ", ".join(
            f"{n} x {s}: {r}" for (s, r), n in sorted(self.counts.items(), key=lambda kv: -kv[1])[:4]
        )
        first = f"; the best one, {candidate!r}: {reason}" if candidate else f"; the first: {reason}"
        return f"{len(self.details)} rejected ({counted}){first}"
