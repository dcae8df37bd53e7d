"""Pick of an object that moves at constant speed, for example on a conveyor belt.

The hand moves along with the object while it descends and closes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, ErrorCode, InputError, JointTrajectory, Outcome
from armcell.core.checks import checked, require
from armcell.execution import execute
from armcell.grasping import Grasp
from armcell.kinematics import ik_solver
from armcell.model import Gripper
from armcell.planning import warm_up
from armcell.scene import PlanningScene
from armcell.tasks.context import HeldObject, StageReport, TaskContext
from armcell.tasks.pick import Pick, check_pickable, grasp_stages
from armcell.tasks.search import PartialSolution, SearchState, Stage, stage_types
from armcell.tasks.stages import ChooseGrasp, RunSteps
from armcell.tasks.stages.grasp import finger_state
from armcell.tasks.steps import DONE, CheckLift, CommandGripper, Motion, WatchObject, perform_all, staged
from armcell.tasks.task import plan_stages
from armcell.timing.chords import chords

Array = NDArray[np.float64]


@dataclass(frozen=True)
@checked()
class ConveyorPickSettings:
    """Settings for picking from a conveyor belt."""

    watch: float = 0.2  # [s] duration of the speed measurement
    spare: float = 0.6  # [s] waiting time of the hand above the meeting point
    first_lead: float = 3.0  # [s] first guess of the time to the meeting
    blend: float = 0.6  # [s] acceleration to the belt's speed, and deceleration
    approach: float = 1.4  # [s] descent along with the object
    close: float = 0.9  # [s] closing time of the fingers
    lift: float = 1.4  # [s]
    tries: int = 3
    slowest: float = 0.005  # [m/s] lower speeds count as standstill

    def __post_init__(self) -> None:
        for name in ("watch", "spare", "first_lead", "blend", "approach", "close", "lift"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        require(self.tries >= 1, f"tries is {self.tries}, it must be at least 1")


def pick_moving(
    ctx: TaskContext, item: str, gripper: Gripper, settings: ConveyorPickSettings = ConveyorPickSettings()
) -> Outcome:
    """Grasp and lift an object that moves at constant speed, for example on a conveyor belt.

    Args:
        settings: times; the distances come from `ctx.settings`.
    Returns:
        SUCCESS with the speed [m/s] in the evidence; PLANNING_FAILED with the reasons if no meeting point is
        feasible; CONTROL_FAILED if the object was not grasped after `tries` attempts.
    Raises:
        InputError: no such object, not movable, it does not move, or the gripper holds something.
    """
    check_pickable(ctx, item, gripper)
    warm_up()  # compile before the object's speed is measured
    return _MovingPick(ctx, item, gripper, settings).run()


class _MovingPick(Pick):
    """Pick of a moving object from a conveyor. Each attempt meets the object farther along its path."""

    retry = "trying again farther on"

    def __init__(self, ctx: TaskContext, item: str, gripper: Gripper, settings: ConveyorPickSettings):
        super().__init__(f"pick {item} on the way", partial(ctx.emit, "note"), settings.tries)
        self._ctx, self._item, self._gripper, self._settings = ctx, item, gripper, settings
        self._speed = 0.0  # [m/s] of the object, measured before each attempt

    def plan(self) -> tuple[PartialSolution | None, Outcome]:
        ctx, item, s, t = self._ctx, self._item, self._settings, self._ctx.settings
        velocity, seen_at, T_seen = _measured_velocity(ctx, item, s)
        self._speed, lead = float(np.linalg.norm(velocity)), s.first_lead
        for _ in range(3):  # the first guess of the time may be too short for the arm's motion
            meeting = ctx.driver.now + lead
            T_then = replace(T_seen, translation=T_seen.translation + velocity * (meeting - seen_at))
            scene = ctx.scene().with_object_pose(item, T_then)
            stages = self._stages(velocity, meeting - s.blend / 2, float(T_seen.translation[2]))
            solution, outcome = plan_stages(ctx, stages, self.label, scene)
            if solution is None:
                return None, outcome
            needed = sum(step.duration for step in solution.steps if isinstance(step, Motion))
            needed += s.blend / 2 + s.spare + t.gripper_timeout / 3
            if lead >= needed:
                return solution, outcome
            lead = needed + 0.2
        text = f"{self.label}: the object is past before the hand is there"
        return None, Outcome(ErrorCode.PLANNING_FAILED, text)

    def _stages(self, velocity: Array, start: float, height: float) -> list[Stage]:
        item, gripper, t = self._item, self._gripper, self._ctx.settings
        return grasp_stages(
            ChooseGrasp(item, gripper, t.near, t.approach_distance), gripper, t,
            RunSteps("check grasp", (CheckLift(item, gripper, height, t.lift_distance),)),
            name="move to meet it", approach=MoveAlong(item, gripper, velocity, start, self._settings),
        )  # fmt: skip

    def perform(self, solution: PartialSolution) -> Outcome:
        outcome = perform_all(self._ctx, solution.steps)
        return replace(outcome, evidence={**outcome.evidence, "speed": self._speed})

    def recover(self, outcome: Outcome) -> bool:
        ctx, gripper = self._ctx, self._gripper  # also after a scene change: the fingers may be closing
        ctx.holding.pop(self._item, None)
        CommandGripper("open", gripper, gripper.max_width, gripper.max_force).perform(ctx)
        return False


def _measured_velocity(ctx: TaskContext, item: str, s: ConveyorPickSettings) -> tuple[Array, float, SE3]:
    """Measure the velocity (3,) [m/s] of an object on a conveyor belt.

    Also returns the last time [s] and T_world_object.
    """
    before, began = ctx.driver.object_poses()[item], ctx.driver.now
    ctx.advance(s.watch)
    T, now = ctx.driver.object_poses()[item], ctx.driver.now
    velocity = (T.translation - before.translation) / max(now - began, 1e-6)
    velocity[2] = 0.0  # a belt is level; a residual falling speed would be extrapolated for seconds
    if np.linalg.norm(velocity) < s.slowest:
        raise InputError(f"{item!r} does not move", hint="pick it as any other object")
    return velocity, now, T


@dataclass(frozen=True, eq=False)
class _WaitUntil:
    """Step of a conveyor pick that waits until the driver's clock reaches a time [s]."""

    time: float

    def perform(self, ctx: TaskContext) -> Outcome:
        ctx.advance(self.time - ctx.driver.now)
        return DONE


@dataclass(frozen=True, eq=False)
class _MoveAlongStep:
    """Step of a conveyor pick that moves the hand along with the object. During this motion, the hand
    descends, closes and lifts the object.
    """

    item: str
    gripper: Gripper
    trajectory: JointTrajectory
    close_at: float  # [s] trajectory time at which the gripper closes
    force: float  # [N] per finger
    planned_in: PlanningScene
    evidence: Mapping[str, Any]
    name: str = "along with it"

    def perform(self, ctx: TaskContext) -> Outcome:
        report = StageReport(self.name, "cartesian")
        return staged(ctx, report, lambda: self._move(ctx))

    def _move(self, ctx: TaskContext) -> Outcome:
        ctx.announce(self.trajectory, self.name, planner="cartesian", evidence=dict(self.evidence))
        closing = False

        def progress(done: float) -> None:
            nonlocal closing
            if not closing and done * self.trajectory.duration >= self.close_at:
                closing = True
                ctx.driver.command_gripper(self.gripper.name, 0.0, self.force)
            ctx.observe()

        motion = ctx.gate.motion(self.trajectory, self.planned_in, ctx.cancel)
        result = execute(ctx.driver, motion, ctx.settings.execution, progress)
        if not result.ok:
            return result
        reading = ctx.driver.gripper(self.gripper.name)
        if reading.held != self.item:
            return Outcome(ErrorCode.CONTROL_FAILED, f"{self.item} is not between the fingers")
        T = ctx.T_tcp_object(self.item, self.gripper)
        ctx.record_grasp(HeldObject(self.item, self.gripper, T))
        ctx.emit("grasp", f"holds {self.item} with {reading.force_per_finger:.0f} N per finger")
        return WatchObject(self.item).perform(ctx)


@stage_types.register("move_along")
@dataclass(frozen=True, eq=False)
class MoveAlong:
    """Stage of a conveyor pick in which the hand descends to the moving object,
    moves along with it and lifts it.
    """

    item: str
    gripper: Gripper
    velocity: Array  # (3,) [m/s]
    start: float  # [s] driver's time at which the hand begins to move along
    settings: ConveyorPickSettings
    name: str = "along"
    requires = ("grasp",)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        s, t, gripper = self.settings, planning.settings, self.gripper
        grasp: Grasp = solution.data["grasp"]
        scene = solution.scene.with_state(finger_state(gripper, grasp.opening))
        start = scene.frame_pose(gripper.tcp_link)
        at_grasp = scene.object(self.item).T_world_object @ grasp.T_object_tcp
        down = at_grasp.translation - start.translation
        ends = np.cumsum([s.blend, s.approach, s.close, s.lift, s.blend])
        times = np.arange(0.0, ends[-1] + STEP / 2, STEP)
        moved = _carried(times, s.blend, float(ends[-1]))[:, None] * self.velocity
        depth = _smooth((times - ends[0]) / s.approach)[:, None] * down
        up = _smooth((times - ends[2]) / s.lift)[:, None] * np.array([0.0, 0.0, t.lift_distance])
        ik = ik_solver(scene.model, gripper.arm_group, gripper.tcp_link)
        columns = scene.model.columns(ik.joint_names)
        q, path = np.array(scene.positions), np.empty((len(times), len(ik.joint_names)))
        for k, offset in enumerate(moved + depth + up):
            wanted = replace(start, translation=start.translation + offset)
            found = min(
                ik.solutions(wanted, q), key=lambda x: float(np.abs(x - q[columns]).max()), default=None
            )
            if found is None or np.abs(found - q[columns]).max() > JUMP:
                planning.reject(self.name, grasp.name, f"out of reach {times[k]:.1f} s after the meeting")
                return
            path[k], q[columns] = found, found
        speed = np.asarray(np.gradient(path, STEP, axis=0))
        speed[[0, -1]] = 0.0
        limits = scene.model.limits(ik.joint_names, "velocity")
        if np.any(np.abs(speed) > limits):
            planning.reject(self.name, grasp.name, "too fast for the joints")
            return
        trajectory = JointTrajectory(ik.joint_names, times, path, speed)
        # no padding, because the grasp is close to the belt
        bare = scene.without_object(self.item).with_padding(0.0)
        if trouble := _touches(bare, trajectory):
            planning.reject(self.name, grasp.name, f"in collision: {trouble}")
            return
        touching = scene.with_allowed(self.item, gripper.hand_links)
        evidence = {"grasp": grasp.name, "velocity": self.velocity}
        along = _MoveAlongStep(
            self.item, gripper, trajectory, float(ends[1]), grasp.force, touching, evidence
        )
        yield solution.then(_WaitUntil(self.start), along)


STEP = 0.02  # [s] between points of the motion along with the object
JUMP = 0.15  # [rad] maximum joint step between these points


def _smooth(u: Array) -> Array:
    """Return a quintic blend from 0 to 1 with zero slope at both ends; `u` is clipped to 0..1. The blend
    shapes the vertical motion of the hand in a conveyor pick.
    """
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2)


def _carried(times: Array, blend: float, end: float) -> Array:
    """Return how far the hand has moved along a conveyor belt at given times, expressed as the time [s] in
    which the belt covers the same distance.

    The displacement is this result times the belt's velocity. The hand accelerates to the belt speed within
    `blend` [s] and decelerates in the last `blend` [s] before the time `end`.
    """

    def ramp(u: Array) -> Array:  # the integral of _smooth
        u = np.clip(u, 0.0, 1.0)
        return u**4 * (2.5 - 3 * u + u**2)

    rising = blend * ramp(times / blend) + np.maximum(times - blend, 0.0)
    late = times - (end - blend)
    return rising - blend * ramp(late / blend)


def _touches(scene: PlanningScene, trajectory: JointTrajectory) -> str:
    """Describe the contact that a conveyor pick's motion would cause.
    The text is empty if the motion is proven collision-free.
    """
    _, points, room = chords((trajectory,), (0.0,), 0.0, trajectory.duration)
    proof = KernelChecker(scene, trajectory.joint_names).certify(points, room)
    return "" if proof.free else "it cannot be proven" if proof.contact is None else proof.contact.describe()
