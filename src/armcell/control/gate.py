"""The motion gate: every motion is proven when it starts, and again whenever the world changes.

The executor takes no trajectory, only a `GuardedMotion`, which a gate makes. So no caller (task, script,
service, topic, viewer) can move an arm without the proof. What is proven: the rest of the motion, from the
measured state, touches neither an object nor the robot itself, nor another arm, which rests where it is
measured or moves along its own remaining trajectory.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from armcell.collision.motion_proof import (
    Conflict,
    Moving,
    conflict_at_any_pace,
    first_conflict,
    passed_at,
)
from armcell.core import SE3, ErrorCode, ExecutionResult, InputError, JointTrajectory, Outcome
from armcell.scene import PlanningScene, new_obstacles

Result = TypeVar("Result", Outcome, ExecutionResult)
CHANGED = ErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
"""How a motion ends, or is refused, that would touch something: plan again from the present scene."""

LOOK = 0.25  # [s] between two looks whether measured objects have moved
MOVED = 0.005  # [m] from where an object was when a motion was proven
SAME = 2e-5  # [m or rad] by which a measured pose or joint may differ from the plan's and count as the same
NOT_STARTED = "not_started"  # in the evidence of a motion that the gate refused


class World(Protocol):
    """A cell in which something moves."""

    @property
    def base(self) -> PlanningScene:
        """The world as planners are to see it, with nothing of it measured: another value after a change."""
        ...

    def scene(self) -> PlanningScene:
        """The scene as measured now, with every arm and what hands hold."""
        ...

    def object_poses(self) -> Mapping[str, SE3]:
        """T_world_object of the objects that are measured, held ones included."""
        ...

    def expected_contacts(self) -> Iterable[frozenset[str]]:
        """Pairs of bodies whose contact is part of the task now."""
        ...

    def clock(self) -> float:
        """[s]"""
        ...

    @property
    def keeps_time(self) -> bool:
        """Whether a motion is always as far along as the clock says."""
        ...

    def emit(self, kind: str, text: str, **data: Any) -> None: ...


class MotionGate:
    """Proves motions in one world, and knows which are under way.

    It is asked in the thread that moves the arms. `conflict` may be asked from any thread.

    Args:
        shift: [s] that motions which start independently of each other may be late or early against each
            other; 0 where one program starts them all.
    """

    def __init__(self, world: World, shift: float = 0.0):
        self.world, self.shift = world, shift
        self.version = 0
        """Changes when a motion ends early: what runs beside it was proven against the rest of it."""
        self._running: list[GuardedMotion] = []

    def motion(
        self,
        trajectory: JointTrajectory,
        planned_in: PlanningScene | None = None,
        cancel: threading.Event | None = None,
        scene: Callable[[], PlanningScene] | None = None,
    ) -> GuardedMotion:
        """A motion for the executor.

        Args:
            planned_in: the scene in which it was planned; the contacts that it allows belong to the motion.
            scene: the scene to prove it in; by default the world's, as measured.
        """
        return GuardedMotion(self, trajectory, planned_in, cancel, scene)

    def conflict(
        self, motion: Moving, scene: PlanningScene, but: GuardedMotion | None = None
    ) -> Conflict | None:
        """What a motion would touch from now on, beside all motions that are under way.

        Args:
            but: a motion that does not count: the one that is asked about.
        """
        mine = set(motion.trajectory.joint_names)
        running = [r for r in list(self._running) if r is not but and not mine & set(r.joint_names)]
        others = [r.moving(scene) for r in running]
        found = first_conflict(scene, motion, others, self.shift)
        if found is not None or self.world.keeps_time:
            return found
        for other in others:
            if other.remaining > 0 and conflict_at_any_pace(scene, motion, other):
                return Conflict(motion.passed, None)
        return None

    def _begin(self, motion: GuardedMotion) -> None:
        self._running.append(motion)

    def _end(self, motion: GuardedMotion, early: bool) -> None:
        if motion in self._running:
            self._running.remove(motion)
            self.version += early


class Executable(threading.Event, ABC):
    """A trajectory that the executor accepts; set like an event, it makes the executor stop."""

    def __init__(self, trajectory: JointTrajectory, cancel: threading.Event | None = None):
        super().__init__()
        self.trajectory, self.cancel = trajectory, cancel

    def is_set(self) -> bool:
        return super().is_set() or (self.cancel is not None and self.cancel.is_set())

    @abstractmethod
    def begin(self, fade: JointTrajectory | None = None) -> ExecutionResult | None:
        """Prove the motion; why it must not start, or None.

        Args:
            fade: what is added to the trajectory at its beginning: the motion of an arm that is not at rest.
        """

    @abstractmethod
    def end(self, result: Result) -> Result:
        """The motion has ended with a result; returns the result with the reason that the gate knows."""


def executable(motion: object) -> Executable:
    """The motion, if the executor may play it.

    Raises:
        InputError: it is a bare trajectory, which nothing has proven.
    """
    if isinstance(motion, Executable):
        return motion
    raise InputError(
        f"the executor plays motions that a MotionGate has made, not a {type(motion).__name__}",
        cure="live.arm.execute(trajectory), or execute(live.driver, live.ctx.gate.motion(trajectory))",
    )


class UngatedMotion(Executable):
    """A motion in a simulation of its own, where a contact is a finding: dry runs, tests, benchmarks."""

    def begin(self, fade: JointTrajectory | None = None) -> ExecutionResult | None:
        return None

    def end(self, result: Result) -> Result:
        return result


class GuardedMotion(Executable):
    """A motion that is proven when it starts, and again when the world changes."""

    def __init__(
        self,
        gate: MotionGate,
        trajectory: JointTrajectory,
        planned_in: PlanningScene | None = None,
        cancel: threading.Event | None = None,
        scene: Callable[[], PlanningScene] | None = None,
    ):
        super().__init__(trajectory, cancel)
        self._gate, self._world = gate, gate.world
        self._planned_in = planned_in
        self._scene = gate.world.scene if scene is None else scene
        self._fade: JointTrajectory | None = None
        self._began: float | None = None  # [s] of the world's clock
        self._known: tuple[PlanningScene, int] | None = None  # the world and the version it was proven in
        self._poses: Mapping[str, SE3] = {}  # of measured objects that no hand held, when it was proven
        self._poses_due = 0.0  # [s]
        self._objects: frozenset[str] = frozenset()  # of the world, when it was proven: no hand held them
        self.conflict: Conflict | None = None
        self._text = ""

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.trajectory.joint_names

    # --- what the executor calls ---
    def begin(self, fade: JointTrajectory | None = None) -> ExecutionResult | None:
        if not len(self.trajectory.times):
            return None  # a stop
        self._fade = fade
        self._prove()
        if self.conflict is None:
            self._began = self._world.clock()
            self._gate._begin(self)
            return None
        now = self._world.clock()
        code = ErrorCode.START_STATE_IN_COLLISION if self.conflict.at_start else CHANGED
        self._world.emit("stop", self._text, **self._evidence())
        return ExecutionResult(code, self._text, {**self._evidence(), NOT_STARTED: True}, now, now)

    def is_set(self) -> bool:
        if super().is_set():
            return True
        if self.conflict is None and self._began is not None and self._known is not None:
            base, version = self._known
            now = self._world.base
            if self._gate.version != version:
                self._prove()
            elif now is not base:
                names = new_obstacles(base, now)
                if names or now.allowed_pairs != base.allowed_pairs:
                    self._prove(names)
                self._known = (now, version)
            if self.conflict is None and (moved := self._moved()):
                self._prove(moved)
            if self.conflict is not None:
                self._world.emit("stop", self._text, **self._evidence())
        return self.conflict is not None

    def end(self, result: Result) -> Result:
        self._gate._end(self, early=not result.ok)
        if self.conflict is None or result.code is not ErrorCode.PREEMPTED:
            return result
        return replace(
            result, code=CHANGED, message=self._text, evidence={**result.evidence, **self._evidence()}
        )

    # --- the proof ---
    def moving(self, scene: PlanningScene) -> Moving:
        """What is left of it.

        Args:
            scene: as measured; where motions do not keep time it says how far along the robot is.
        """
        if self._began is None:
            return Moving(self.trajectory, 0.0, self._fade)
        passed = self._world.clock() - self._began
        if not self._world.keeps_time:
            q = scene.state.reindexed(self.joint_names).positions
            passed = passed_at(self.trajectory, q, passed)
        return Moving(self.trajectory, min(passed, self.trajectory.duration), self._fade)

    def _moved(self) -> list[str]:
        """Measured objects that are elsewhere than when the motion was proven."""
        now = self._world.clock()
        if not self._poses or now < self._poses_due:
            return []
        self._poses_due = now + LOOK
        poses = self._world.object_poses()
        return [
            n for n, T in self._poses.items()
            if n in poses and np.linalg.norm(poses[n].translation - T.translation) > MOVED
        ]  # fmt: skip

    def _prove(self, names: Iterable[str] = ()) -> None:
        """Look for a conflict; of the world's objects only with those named, if any are."""
        self._known = (self._world.base, self._gate.version)
        scene = self._scene()
        self._objects = frozenset(scene.objects)
        measured = self._world.object_poses()
        self._poses = {n: o.T_world_object for n, o in scene.objects.items() if n in measured}
        self._poses_due = self._world.clock() + LOOK
        if names := set(names):
            scene = replace(scene, objects={n: o for n, o in scene.objects.items() if n in names})
        expected = dict.fromkeys(self._world.expected_contacts(), True)
        planned = {} if self._planned_in is None else self._planned_in.allowed_pairs
        scene = replace(scene, allowed_pairs={**expected, **planned, **scene.allowed_pairs})
        if self._planned_in is not None:
            scene = as_planned(scene, self._planned_in, self.joint_names)
        motion = self.moving(scene)
        found = self._gate.conflict(motion, scene, self)
        if found is not None:
            self.conflict = found
            self._text = describe(found, motion.passed, began=self._began is not None)

    def _evidence(self) -> dict[str, Any]:
        found = self.conflict
        if found is None:
            return {}
        data: dict[str, Any] = {"time_s": found.time, "contact": found.contact}
        if found.contact is not None:
            data |= {
                "pair": (found.contact.body_a, found.contact.body_b),
                "position": found.contact.position,
                "contacts": [found.contact],
            }
            if objects := [name for name in data["pair"] if name in self._objects]:
                data["object"] = objects[0]
        return data


def as_planned(scene: PlanningScene, planned: PlanningScene, moving: Iterable[str]) -> PlanningScene:
    """The measured scene with the plan's values where the two differ by less than `SAME`.

    Measurements repeat but for rounding. The collision kernel keeps what it worked out for a plan, and finds
    it again only for equal values.

    Args:
        moving: joints that keep their measured positions.
    """
    if scene.model is not planned.model:
        return scene
    near = np.abs(planned.positions - scene.positions) < SAME
    near[scene.model.columns(moving)] = False
    objects, attached = dict(scene.objects), dict(scene.attached)
    for name, measured in scene.objects.items():
        known = planned.objects.get(name)
        if (
            known is not None
            and measured.shapes is known.shapes
            and _near(measured.T_world_object, known.T_world_object)
        ):
            objects[name] = known
    for name, held in scene.attached.items():
        known = planned.attached.get(name)
        if known is not None and held.link == known.link and _near(held.T_link_object, known.T_link_object):
            attached[name] = replace(held, T_link_object=known.T_link_object)
    positions = np.where(near, planned.positions, scene.positions)
    return replace(scene, positions=positions, objects=objects, attached=attached)


def _near(a: SE3, b: SE3) -> bool:
    turned = np.abs(a.rotation.matrix - b.rotation.matrix).max()
    return max(turned, np.abs(a.translation - b.translation).max()) < SAME


def describe(found: Conflict, passed: float, began: bool) -> str:
    """A conflict in one sentence: the pair, where and when, and what to do.

    Args:
        passed: [s] of the motion that are done. began: it was under way already.
    """
    contact, ahead = found.contact, found.time - passed
    if contact is None:
        what, where = "another arm that moves would be too near", ""
    else:
        depth = f", {-contact.distance * 1000:.1f} mm deep" if contact.distance < -5e-5 else ""
        verb = "touches" if found.at_start else "would touch"
        what = f"{contact.body_a} {verb} {contact.body_b}{depth}"
        where = " at ({:.3f}, {:.3f}, {:.3f}) m".format(*contact.position)
    if found.at_start:
        return f"the motion was not started: {what}{where} already; move one of the two away"
    when = f"{ahead:.2f} s ahead" if began else f"{ahead:.2f} s into the motion"
    did = "stopped" if began else "the motion was not started"
    return f"{did}: {what}{where}, {when}; plan again from the present scene"


@dataclass(frozen=True)
class DriverWorld:
    """The world of a driver that is used without a cell: its scene with joints and objects as measured."""

    driver: Any
    base: PlanningScene

    def scene(self) -> PlanningScene:
        state = self.driver.joint_state()
        scene = self.base.with_state(state.reindexed(self.base.model.joint_names))
        for name, pose in self.driver.object_poses().items():
            if name in scene.objects:
                scene = scene.with_object_pose(name, pose)
        return scene

    def object_poses(self) -> Mapping[str, SE3]:
        return self.driver.object_poses()

    def expected_contacts(self) -> Iterable[frozenset[str]]:
        return ()

    def clock(self) -> float:
        return self.driver.now

    @property
    def keeps_time(self) -> bool:
        return self.driver.is_simulated

    def emit(self, kind: str, text: str, **data: Any) -> None:
        pass
