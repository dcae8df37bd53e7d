"""The motion gate: certifies every motion at its start and again whenever the scene changes.

The executor accepts only a `GuardedMotion`, which a gate creates, and no bare trajectory. No caller (task,
script, service, topic, viewer) can therefore move an arm without a collision check. The check certifies that
the rest of the motion, from the measured state, touches no object, no part of the robot, and no other arm;
another arm either rests at its measured position or moves along its own remaining trajectory.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from armcell.collision.inter_arm_checker import links_of_joints
from armcell.collision.motion_proof import (
    ActiveMotion,
    Conflict,
    conflict_at_any_pace,
    elapsed_at,
    first_conflict,
)
from armcell.core import SE3, ErrorCode, ExecutionResult, InputError, JointTrajectory, Outcome
from armcell.scene import PlanningScene, new_obstacles

Result = TypeVar("Result", Outcome, ExecutionResult)
SCENE_INVALIDATED = ErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
"""Result code of a motion that is refused or stopped because of a collision: plan again."""

OBJECT_CHECK_PERIOD = 0.25  # [s] between two checks for moved objects
MOVED = 0.005  # [m] displacement of an object that triggers a new collision check
NOT_STARTED = "not_started"  # evidence key of a motion that the gate refused


class World(Protocol):
    """Interface to the robot cell for the motion gate, which checks motions for collisions. The gate reads
    the cell's scene, objects, expected contacts and clock.
    """

    @property
    def base(self) -> PlanningScene:
        """Planning scene of the cell for the motion gate's collision checks, without measured joint positions
        and object poses. When the scene changes, this is a new `PlanningScene` object.
        """
        ...

    def scene(self) -> PlanningScene:
        """Return the planning scene in which the motion gate checks motions,
        with the measured state of every arm and of held objects.
        """
        ...

    def object_poses(self) -> Mapping[str, SE3]:
        """Return the poses T_world_object of all measured objects, including held ones, for checks by the
        motion gate.
        """
        ...

    def expected_contacts(self) -> Iterable[frozenset[str]]:
        """Return the pairs of bodies that the motion gate allows to touch, because the current task expects
        their contact.
        """
        ...

    def clock(self) -> float:
        """Return the time [s] on the cell's clock, which the motion gate uses."""
        ...

    @property
    def follows_clock(self) -> bool:
        """Whether a running motion always progresses exactly with the cell's clock. If so, the motion gate
        can infer its progress from the clock.
        """
        ...

    def emit(self, kind: str, text: str, **data: Any) -> None: ...


class MotionGate:
    """Gate that every motion in a cell must pass: it certifies motions as collision-free and keeps track of
    the running motions.

    Motions are certified in the thread that moves the arms. Any thread may call `conflict`.

    Args:
        shift: largest time offset [s] between motions that start independently of each other; 0 if one
            program starts all motions.
    """

    def __init__(self, world: World, shift: float = 0.0):
        self.world, self.shift = world, shift
        self.version = 0
        """Incremented when a motion ends early: concurrent motions were checked against its remainder."""
        self._running: list[GuardedMotion] = []

    def motion(
        self,
        trajectory: JointTrajectory,
        planned_in: PlanningScene | None = None,
        cancel: threading.Event | None = None,
        scene: Callable[[], PlanningScene] | None = None,
    ) -> GuardedMotion:
        """Wrap a trajectory in a `GuardedMotion`. The executor accepts this motion because the motion gate
        checks it for collisions.

        Args:
            planned_in: scene in which the trajectory was planned; its allowed contacts apply to the motion.
            cancel: event that stops the motion when set.
            scene: returns the scene for the collision check; by default the world's measured scene.
        """
        return GuardedMotion(self, trajectory, planned_in, cancel, scene)

    def conflict(
        self,
        motion: ActiveMotion,
        scene: PlanningScene,
        ignore: GuardedMotion | None = None,
        planned: PlanningScene | None = None,
    ) -> Conflict | None:
        """Return the first collision that the motion gate finds on the rest of a motion, with the scene or
        with another running motion. Return None if there is no collision.

        Args:
            ignore: a running motion to ignore, usually the motion under test.
            planned: scene in which the motion was planned; it makes the check faster.
        """
        mine = set(motion.trajectory.joint_names)
        running = [r for r in list(self._running) if r is not ignore and not mine & set(r.joint_names)]
        others = [r.remaining_motion(scene) for r in running]
        beside = _allowed_beside(running, scene, tuple(motion.trajectory.joint_names))
        scene = replace(scene, allowed_pairs={**beside, **scene.allowed_pairs})
        found = first_conflict(scene, motion, others, self.shift, planned)
        if found is not None or self.world.follows_clock:
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
    """Base class of the motions that the executor accepts: motions that a motion gate guards, and motions
    that are explicitly ungated. The executor rejects a bare trajectory.

    A motion gate checks a `GuardedMotion`; an `UngatedMotion` is executed without a check. Every motion is a
    `threading.Event`: call `set()` to stop it.
    """

    def __init__(self, trajectory: JointTrajectory, cancel: threading.Event | None = None):
        super().__init__()
        self.trajectory, self.cancel = trajectory, cancel

    def is_set(self) -> bool:
        return super().is_set() or (self.cancel is not None and self.cancel.is_set())

    @abstractmethod
    def begin(self, blend: JointTrajectory | None = None) -> ExecutionResult | None:
        """Check the motion for collisions before it starts. Return the result if the motion gate refuses the
        motion, else None.

        Args:
            blend: offset added to the start of the trajectory: the remaining motion of an arm that is not at
                rest.
        """

    @abstractmethod
    def end(self, result: Result) -> Result:
        """Register the end of a motion in the motion gate. Return `result`, which contains the gate's reason
        if the gate stopped the motion.
        """


def executable(motion: object) -> Executable:
    """Return `motion` unchanged if the executor may play it: a `GuardedMotion`, which the motion gate checks,
    or an `UngatedMotion` without collision checks. Otherwise raise an error.

    Raises:
        InputError: `motion` is a bare trajectory that no gate has checked.
    """
    if isinstance(motion, Executable):
        return motion
    raise InputError(
        f"the executor plays motions that a MotionGate has made, not a {type(motion).__name__}",
        hint="live.arm.execute(trajectory), or execute(live.driver, live.ctx.gate.motion(trajectory))",
    )


class UngatedMotion(Executable):
    """Motion that is executed without the collision checks of a motion gate, for dry runs, tests and
    benchmarks.

    Contacts in such a simulation are findings.
    """

    def begin(self, blend: JointTrajectory | None = None) -> ExecutionResult | None:
        return None

    def end(self, result: Result) -> Result:
        return result


class GuardedMotion(Executable):
    """Motion that the motion gate checks for collisions at its start and again whenever the world changes."""

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
        self.planned_in = planned_in
        self._scene = gate.world.scene if scene is None else scene
        self._blend: JointTrajectory | None = None
        self._began: float | None = None  # [s] on the world's clock
        self._proven_for: tuple[PlanningScene, int] | None = None  # world and gate version of the last check
        self._poses: Mapping[str, SE3] = {}  # of measured objects not held at the last check
        self._next_object_check = 0.0  # [s]
        self._objects: frozenset[str] = frozenset()  # in the world, not held, at the last check
        self.conflict: Conflict | None = None
        self._text = ""

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.trajectory.joint_names

    # --- called by the executor ---
    def begin(self, blend: JointTrajectory | None = None) -> ExecutionResult | None:
        if not len(self.trajectory.times):
            return None  # an empty trajectory means stop
        self._blend = blend
        self._prove()
        if self.conflict is None:
            self._began = self._world.clock()
            self._gate._begin(self)
            return None
        now = self._world.clock()
        code = ErrorCode.START_STATE_IN_COLLISION if self.conflict.at_start else SCENE_INVALIDATED
        self._world.emit("stop", self._text, **self._evidence())
        return ExecutionResult(code, self._text, {**self._evidence(), NOT_STARTED: True}, now, now)

    def is_set(self) -> bool:
        if super().is_set() or self.conflict is not None:
            return True
        if self._began is None or self._proven_for is None:
            return False
        base, version = self._proven_for
        now = self._world.base
        if self._gate.version != version:
            self._prove()
        elif now is not base:
            names = new_obstacles(base, now)
            if names or now.allowed_pairs != base.allowed_pairs:
                self._prove(names)
            self._proven_for = (now, version)
        if self.conflict is None and self._poses and (moved := self._moved()):
            self._prove(moved)
        if self.conflict is None:
            return False
        self._world.emit("stop", self._text, **self._evidence())
        return True

    def end(self, result: Result) -> Result:
        self._gate._end(self, early=not result.ok)
        if self.conflict is None or result.code is not ErrorCode.PREEMPTED:
            return result
        evidence = {**result.evidence, **self._evidence()}
        return replace(result, code=SCENE_INVALIDATED, message=self._text, evidence=evidence)

    # --- collision check ---
    def remaining_motion(self, scene: PlanningScene) -> ActiveMotion:
        """Return the remaining part of a motion that the motion gate guards: the part that the arm has not
        executed yet.

        Args:
            scene: measured scene; its joint state gives the progress if motions do not follow the clock.
        """
        if self._began is None:
            return ActiveMotion(self.trajectory, 0.0, self._blend)
        passed = self._world.clock() - self._began
        if not self._world.follows_clock:
            q = scene.state.reindexed(self.joint_names).positions
            passed = elapsed_at(self.trajectory, q, passed)
        return ActiveMotion(self.trajectory, min(passed, self.trajectory.duration), self._blend)

    def _moved(self) -> list[str]:
        """Return the measured objects that have moved since the motion gate last checked the motion for
        collisions.
        """
        now = self._world.clock()
        if now < self._next_object_check:
            return []
        self._next_object_check = now + OBJECT_CHECK_PERIOD
        poses = self._world.object_poses()
        return [
            n for n, T in self._poses.items()
            if n in poses and np.linalg.norm(poses[n].translation - T.translation) > MOVED
        ]  # fmt: skip

    def _prove(self, names: Iterable[str] = ()) -> None:
        """Let the motion gate check the rest of a guarded motion for collisions. If `names` is given, check
        it only against these objects.
        """
        self._proven_for = (self._world.base, self._gate.version)
        scene = self._scene()
        self._objects = frozenset(scene.objects)
        measured = self._world.object_poses()
        self._poses = {n: o.T_world_object for n, o in scene.objects.items() if n in measured}
        self._next_object_check = self._world.clock() + OBJECT_CHECK_PERIOD
        if names := set(names):
            scene = replace(scene, objects={n: o for n, o in scene.objects.items() if n in names})
        expected = dict.fromkeys(self._world.expected_contacts(), True)
        planned = {} if self.planned_in is None else self.planned_in.allowed_pairs
        scene = replace(scene, allowed_pairs={**expected, **planned, **scene.allowed_pairs})
        motion = self.remaining_motion(scene)
        found = self._gate.conflict(motion, scene, self, None if names else self.planned_in)
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


def _allowed_beside(
    running: Iterable[GuardedMotion], scene: PlanningScene, joint_names: tuple[str, ...]
) -> dict[frozenset[str], bool]:
    """Return the contacts that running motions were planned with, such as those of a hand that reaches into a
    heap. The motion gate allows them when it checks another motion, but no contact of what this motion moves.

    Args:
        scene: scene of the check.
        joint_names: joints of the checked motion.
    """
    mine, found = _moved_bodies(scene, joint_names), {}
    for other in running:
        if other.planned_in is not None:
            theirs = _moved_bodies(scene, other.joint_names) | _moved_bodies(
                other.planned_in, other.joint_names
            )
            allowed = other.planned_in.allowed_pairs.items()
            found |= {pair: True for pair, yes in allowed if yes and pair & theirs and not pair & mine}
    return found


def _moved_bodies(scene: PlanningScene, joint_names: tuple[str, ...]) -> frozenset[str]:
    """Return the links and held objects that move with joints of the robot."""
    links = links_of_joints(scene.model, joint_names)
    return links | {name for name, body in scene.attached.items() if body.link in links}


def describe(found: Conflict, passed: float, began: bool) -> str:
    """Describe in a sentence why the motion gate stops a motion: which bodies would collide,
    where and when, and what would help.

    Args:
        passed: completed part of the motion [s].
        began: True if the motion was already running.
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
    """Planning scene, with measured joint positions and object poses, that the motion gate uses for a driver
    without a cell.
    """

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
    def follows_clock(self) -> bool:
        return self.driver.is_simulated

    def emit(self, kind: str, text: str, **data: Any) -> None:
        pass
