"""State of a running task: driver, shared planning scene, observers and stage reports."""

from __future__ import annotations

import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Sequence, Set
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.world_arrays import world_of
from armcell.core import SE3, Event, InputError, JointTrajectory, Observer, Outcome, StateSample
from armcell.drivers import Driver
from armcell.execution import MotionGate
from armcell.model import Gripper
from armcell.scene import PlanningScene, new_obstacles, scene_changes
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stage_statistics import reason_in_short


class SharedScene:
    """Planning scene of a task, without the measured joint positions and object poses. Several threads share
    this scene.

    Attributes:
        scene: may be read at any time. It is replaced while `editing` is held, never mutated.
        news: changes that have not been reported yet, oldest first.
        telling: lock of the thread that reports changes.
    """

    def __init__(self, scene: PlanningScene):
        self.scene = scene
        self.editing = threading.RLock()
        self.news: deque[dict[str, Any]] = deque()
        self.telling = threading.Lock()


def without_measured(
    base: PlanningScene, now: PlanningScene, after: PlanningScene, held: Iterable[str]
) -> PlanningScene:
    """Return the scene `after` of a running task without measurements: the measured joint positions and
    object poses are replaced by their values in the scene `base`.

    Args:
        base: the scene before the change.
        now: the base scene with measurements, from which `after` was made.
        held: names of objects that the hands report as held; they are attached again at the next measurement.
    Raises:
        InputError: a held object was removed.
    """
    objects = {n: base.objects[n] if o is now.objects.get(n) else o for n, o in after.objects.items()}
    attached = dict(after.attached)
    for name in held:
        if name not in now.attached:
            continue
        body = attached.pop(name, None)
        if body is None and name not in objects:
            raise InputError(
                f"object {name!r} is held by {now.attached[name].link}: it cannot be taken out of the scene",
                hint="let go of it first",
            )
        if body is now.attached[name]:
            objects[name] = base.objects[name]
        elif body is not None:
            objects[name] = after.object(name)
    return replace(after, objects=objects, attached=attached, positions=base.positions)


OBSERVER_PERIOD = 0.01  # [s] of the driver's clock between samples given to observers
UNWATCHED = 0.02  # [s] step size without observers


@dataclass
class StageReport:
    """Report of one stage of a task. Each report is one row of the stage table."""

    name: str
    planner: str = ""
    planning_time_s: float = 0.0  # wall clock
    motion_time_s: float = 0.0  # driver's clock
    clearance_m: float | None = None
    slip_m: float | None = None  # [m] slip of the held object during the stage
    error: str = ""
    ok: bool = True
    started_s: float = 0.0  # driver's clock

    def as_dict(self) -> dict[str, Any]:
        return dict(self.__dict__)


@dataclass
class HeldObject:
    """Object that a gripper holds, as the task's context and the planning scene assume."""

    object: str
    gripper: Gripper
    T_tcp_object: SE3  # pose at the time of the grasp


class TaskContext:
    """Runtime state (context) of a task. `scene()` is always built
    from the latest measurements of the driver.
    """

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
        self.world = SharedScene(scene)
        # The gate must not keep the context alive: unreferenced physics models are reused.
        self.gate = MotionGate(weakref.proxy(self))
        self.expected: set[frozenset[str]] = set()  # pairs whose contact is currently part of the task
        self.holding: dict[str, HeldObject] = {}  # object -> holding
        self.lost: dict[str, str] = {}  # lost object -> cause, until it is grasped again
        # contexts of arms side by side, with their held objects
        self.at_work: tuple[TaskContext, ...] = ()
        self.reports: list[StageReport] = []
        self.events: list[Event] = []
        self.look: Callable[[], Outcome] | None = None  # looks with a camera again after a failed grasp
        self._next_sample = 0.0
        self._stops_told = 0  # number of reported safety events
        self._told = (0, 0)  # numbers of reported welds and unwanted contacts

    # --- measured state ---
    def scene(self) -> PlanningScene:
        """Return the planning scene of a task's context, with measured joint positions and object poses,
        and with held objects attached.

        Safe to call from any thread, like `whole_scene` and `change_scene`.
        """
        return self.whole_scene()

    def belief(self, name: str, width: float = 0.0) -> str:
        """Describe where an object is according to the task's planning scene, as a believed value. For real
        arms, the text also explains how to correct a wrong pose.

        Args:
            width: [m] of the object between the pads, if the text should state it.
        """
        x, y, z = self.scene().object(name).T_world_object.translation
        wide = f", {width * 1000:.1f} mm wide between the fingers" if width else ""
        text = f"believed: the scene has {name} at {x:.3f} {y:.3f} {z:.3f}{wide}"
        if self.driver.is_simulated:
            return text
        return (
            f"{text} m, as the cell file says or a camera last saw it. If it is elsewhere: let the task look "
            f"(cell.look()), or give its pose (--set objects.{name}.pose=[x, y, z]); an emulated world goes "
            'back to its start with: armcell ur-dashboard ADDRESS "armcell reset"'
        )

    def whole_scene(self) -> PlanningScene:
        """Return the scene of a task's context with all arms. If arms work side by side, the attribute
        `scene` contains only one arm.
        """
        return self._measured(self.base)

    def _measured(self, scene: PlanningScene) -> PlanningScene:
        model, driver = scene.model, self.driver
        with driver.lock:  # joints and objects at the same time
            q, poses = driver.joint_state().positions, driver.object_poses()
        scene = replace(scene, positions=np.clip(q, model.lower, model.upper))
        for name, pose in poses.items():
            if name in scene.objects:
                scene = scene.with_object_pose(name, pose)
        for held in self.hands():
            if held.object in scene.objects:
                scene = scene.with_attached(held.object, held.gripper.tcp_link, held.gripper.hand_links)
        return scene

    def hands(self) -> Iterable[HeldObject]:
        """Return the objects that the hands of all arms hold, according to the task's context."""
        contexts = self.at_work or (self,)
        return [held for ctx in contexts for held in list(ctx.holding.values())]

    @property
    def base(self) -> PlanningScene:
        """Return the planning scene of a task's context, without measurements."""
        return self.world.scene

    def change_scene(self, make: Callable[[PlanningScene], PlanningScene]) -> PlanningScene:
        """Change the planning scene of a task's context atomically: add, change, move or remove objects.

        Safe to call at any time from any thread, also during a motion. Later plans respect the change, and a
        running motion is stopped if an object blocks its remaining part (`MotionGate`). Joints, held objects
        and the poses of objects that the driver measures keep their measured values.

        Args:
            make: returns a new scene for the current one. It should be fast, because other changes wait for
                it.
        Returns:
            The scene after the change.
        Raises:
            InputError: a held object would be removed, or `make` raises; the scene stays unchanged.
        """
        with self.world.editing:
            before, now = self.base, self.whole_scene()
            after = without_measured(before, now, make(now), [held.object for held in self.hands()])
            if new_obstacles(before, after):
                # build their collision geometry here, not in the thread that moves the arm
                world_of(after.objects)
            self.world.scene = after
            if self.observers and (changes := scene_changes(before, after)):
                self.world.news.append(changes)
        self._tell_changes()
        return self.scene()

    def _tell_changes(self) -> None:
        """Report scene changes of a task's context to the observers in order,
        from only one thread at a time.
        """
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
        """Allow or forbid contact between a body and others in a task's context, both in the physics
        simulation and in the motion gate.
        """
        others = tuple(others)
        pairs = {frozenset((body, other)) for other in others}
        self.expected = self.expected | pairs if expected else self.expected - pairs
        self.driver.expect_contact(body, others, expected)

    def object_poses(self) -> dict[str, SE3]:
        """Return T_world_object of all objects whose poses the driver of a task's context measures."""
        return self.driver.object_poses()

    def expected_contacts(self) -> Set[frozenset[str]]:
        """Return the pairs of bodies between which a task's context expects contact at present."""
        return self.expected

    def clock(self) -> float:
        """Return the present time [s] on the clock of the task's driver."""
        return self.driver.now

    @property
    def follows_clock(self) -> bool:
        """Return whether the robot of a task executes motions exactly on time. Simulated robots do; real arms
        may be slower.
        """
        return self.driver.is_simulated

    def slip_of(self, held: HeldObject) -> float:
        """Return how far [m] a held object in the task's context has slipped in the gripper since the hand
        grasped it.
        """
        return held.T_tcp_object.distance_to(self.T_tcp_object(held.object, held.gripper))[0]

    def T_tcp_object(self, item: str, gripper: Gripper) -> SE3:
        scene = replace(self.base, positions=self.driver.joint_state().positions)
        T_world_object = self.driver.object_poses().get(item, scene.object(item).T_world_object)
        return scene.frame_pose(gripper.tcp_link).inverse() @ T_world_object

    def correct_pose(self, name: str, T_world_object: SE3) -> None:
        """Correct the believed pose of an object in a task's context. A pose that the driver measures stays
        unchanged.
        """
        if name in self.driver.object_poses():
            self.driver.correct_object_pose(name, T_world_object)
        else:
            self.change_scene(lambda scene: scene.with_object_pose(name, T_world_object))

    # --- coordination with other arms ---
    def request_start(self, motion: Any) -> JointTrajectory | Outcome:
        """Return the trajectory of a motion if the task's context allows it to start,
        or else the reason for the refusal.

        A single arm may always start.

        Args:
            motion: a `steps.Motion`.
        """
        return motion.trajectory

    def rested(self) -> None:
        """Record in a task's context that the arm has come to rest after a motion."""

    def reserve(self, zone: str) -> AbstractContextManager[None]:
        """Return a context manager that reserves a zone for the arm while a task works there. If the task has
        only one arm, the context manager does nothing.
        """
        return nullcontext()

    def choose(self, items: Sequence[str], zone: Callable[[str], str]) -> str:
        """Return the item that a task should handle next: the first item whose destination zone no other arm
        uses.

        For a single arm, this is the first item.
        """
        return items[0]

    def await_view(self, corners: NDArray[np.float64]) -> bool:
        """Wait until no other arm hides a region from a camera, and return whether that took time.

        A single arm does not wait.

        Args:
            corners: (k, 3) points [m, world frame] whose convex hull contains the view: camera and region.
        """
        return False

    def is_hidden(self, corners: NDArray[np.float64]) -> bool:
        """Return whether another arm hides a region from a camera now. A single arm hides nothing.

        Args:
            corners: as for `await_view`.
        """
        return False

    def rendezvous(self, name: str) -> None:
        """Wait in a task's context until the programs of all other arms reach the same rendezvous point.

        A single arm does not wait.
        """

    # --- time ---
    def advance(self, duration: float) -> None:
        """Let an amount of time [s] pass in a task's context and keep the observers up to date.
        Return early if the task is canceled.
        """
        driver, end = self.driver, self.driver.now + duration
        alone = driver.is_simulated and not self.observers
        at_once = max(round(UNWATCHED / driver.period), 1) * driver.period if alone else driver.period
        while driver.now < end - 1e-9 and not self.cancel.is_set():
            driver.advance(min(at_once, end - driver.now))
            self.observe()

    @property
    def progress(self) -> Callable[[float], None] | None:
        """Return the callback for the progress of motions, or None if the task has no observers."""
        return (lambda _: self.observe()) if self.observers else None

    def observe(self) -> None:
        """Report new physics events and send a state sample to the observers of a task's context, at most
        once per sampling period.
        """
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
        """Emit an event in a task's context for each new weld,
        unwanted contact and safety stop of a real arm.
        """
        welds, contacts = self.driver.welds(), self.driver.unwanted_contacts()
        for weld in welds[self._told[0] :]:
            self.emit("weld", f"{weld.object} is welded to {weld.gripper}: {weld.reason}")
        for contact in contacts[self._told[1] :]:
            self.emit("contact", f"{contact.body_a} touches {contact.body_b}", depth_m=contact.depth)
        self._told = (len(welds), len(contacts))
        for event in self.driver.safety_events[self._stops_told :]:
            self._stops_told += 1
            kind = "note" if event.kind == "twin" else "stop"
            self.emit(kind, f"{event.arm}: {event.kind}: {event.text}", cause=event.kind)

    # --- held objects ---
    def record_grasp(self, held: HeldObject) -> None:
        """Record in a task's context that a hand holds an object."""
        self.holding[held.object] = held
        self.lost.pop(held.object, None)

    def lose(self, item: str, text: str) -> None:
        """Record in a task's context that a hand has lost an object."""
        self.holding.pop(item, None)
        self.lost[item] = text
        self.emit("lost", text, object=item)

    # --- reporting ---
    def emit(self, kind: str, text: str, **data: Any) -> None:
        event = Event(self.driver.now, kind, text, data)
        self.events.append(event)
        for observer in self.observers:
            observer.on_event(event)

    def announce(self, trajectory: JointTrajectory, plan: str = "", **evidence: Any) -> None:
        """Notify the observers of a task's context that a motion begins.

        Args:
            plan: name of the plan; if given, a "plan" event with the evidence is emitted.
        """
        for observer in self.observers:
            observer.on_trajectory(self.driver.now, trajectory)
        if plan:
            points, duration = len(trajectory.times), trajectory.duration
            self.emit("plan", plan, points=points, duration_s=duration, **evidence)


@dataclass
class Rejections:
    """Reasons why candidates were rejected, for a task's context: counts by stage and reason,
    and the first reasons in full.
    """

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
