"""Task of driving a screw: the hand rotates about its axis while it presses by admittance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, ErrorCode, InputError, JointTrajectory, Outcome
from armcell.core.checks import require
from armcell.execution import Admittance, AdmittanceSettings, execute_coupled
from armcell.kinematics import kinematic_tree
from armcell.tasks.context import StageReport, TaskContext
from armcell.tasks.steps import staged
from armcell.timing import delay_trajectory
from armcell.timing.chords import chords

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScrewSettings:
    """Settings for driving a screw."""

    speed: float = 1.5  # [rad/s] maximum speed of the hand
    press_time: float = 0.5  # [s] force build-up before the rotation
    max_force: float = 40.0  # [N] maximum force along or across the axis; more stops both arms
    admittance: AdmittanceSettings = AdmittanceSettings(
        damping=3000.0, dead_band=0.3, max_speed=0.02, max_offset=0.004
    )

    def __post_init__(self) -> None:
        for name in ("speed", "press_time", "max_force"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")


def screw(
    ctx: TaskContext, item: str, turns: float, force: float, settings: ScrewSettings = ScrewSettings()
) -> Outcome:
    """Drive a screw that the hand holds: press it along the tool axis
    while rotating it clockwise about that axis.

    Args:
        turns: revolutions of the hand, within the last joint's range.
        force: [N] pressing force.
    Returns:
        SUCCESS with evidence: `turned` (revolutions of the object), `went_in_mm`, `force_mean_N`,
        `force_max_N`.
    Raises:
        InputError: the object is not held, the last joint's range is too small, or a number is not positive.
    """
    if item not in ctx.holding:
        raise InputError(f"the robot does not hold {item!r}", hint="grasp it first")
    for what, value in (("turns", turns), ("force", force)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{what} is {value:g}, it must be positive")
    gripper, scene = ctx.holding[item].gripper, ctx.scene()
    model, names = scene.model, scene.model.group(gripper.arm_group).joint_names
    q = ctx.driver.joint_state().reindexed(names).positions
    trajectory = _turn(names, q, turns, settings)
    last = model.joint(names[-1]).limits
    if not last.lower <= trajectory.positions[-1, -1] <= last.upper:
        raise InputError(
            f"{names[-1]} at {np.rad2deg(q[-1]):.0f} degrees has no room for {turns:g} turns",
            hint="grasp it turned back, or turn less at a time",
        )
    others = [n for n in scene.objects if scene.is_allowed(item, n)]
    planned_in = scene.with_allowed(item, others) if others else scene
    checker = KernelChecker(planned_in, names)
    _, points, room = chords((trajectory,), (0.0,), 0.0, trajectory.duration)
    proof = checker.certify(points, room)
    if not proof.free:
        what = "" if proof.contact is None else f": {proof.contact.describe()}"
        return Outcome(ErrorCode.PLANNING_FAILED, f"the hand cannot turn{what}")
    turning = _Turning(ctx, item, force, settings, names, gripper.name, gripper.tcp_link)

    def act() -> Outcome:
        asked = {"turns": turns, "force_N": force}
        ctx.announce(trajectory, "screw", planner="admittance", evidence=asked)
        motion = ctx.gate.motion(trajectory, planned_in, ctx.cancel)
        result = execute_coupled(
            ctx.driver, motion, turning.correct, turning.watch, settings=ctx.settings.execution,
            progress=ctx.progress,
        )  # fmt: skip
        return replace(result, evidence={**result.evidence, **turning.evidence()})

    return staged(ctx, StageReport("screw", "admittance"), act)


def _turn(names: tuple[str, ...], q: Array, turns: float, s: ScrewSettings) -> JointTrajectory:
    """Return the trajectory that drives a screw: it waits for `press_time` [s] and then rotates the last
    joint smoothly.

    The rotation is a quintic polynomial of time.
    """
    angle = 2 * np.pi * turns
    duration = 1.875 * angle / s.speed
    x = np.linspace(0, 1, 60)
    share = x**3 * (10 - 15 * x + 6 * x**2)
    rate, bend = 30 * x**2 * (1 - x) ** 2 / duration, 60 * x * (1 - x) * (1 - 2 * x) / duration**2
    positions = np.tile(q, (len(x), 1))
    velocities, accelerations = np.zeros_like(positions), np.zeros_like(positions)
    positions[:, -1] += angle * share
    velocities[:, -1], accelerations[:, -1] = angle * rate, angle * bend
    turn = JointTrajectory(names, x * duration, positions, velocities, accelerations)
    return delay_trajectory(turn, s.press_time)


class _Turning:
    """Admittance control of the force that presses a screw along the tool axis.
    The force is measured in every cycle.
    """

    def __init__(self, ctx, item, force, settings, names, gripper, tip):
        self.ctx, self.item, self.force, self.settings = ctx, item, force, settings
        self.names, self.gripper, self.tip = names, gripper, tip
        model = ctx.base.model
        self.tree, self.columns = kinematic_tree(model), model.columns(names)
        self.admittance = Admittance(settings.admittance, 1)
        self.forces: list[float] = []
        thread = ctx.base.object(item).thread if item in ctx.base.objects else None
        self.into = None if thread is None else thread.into
        self.began = self._pose()
        self.angle, self._last = 0.0, self.began

    def _pose(self) -> SE3:
        """Return the measured pose of the screw that the hand drives: in the frame of the body with the
        threaded hole if that body is known, else in the world frame.
        """
        poses = self.ctx.driver.object_poses()
        return poses[self.item] if self.into not in poses else poses[self.into].inverse() @ poses[self.item]

    def correct(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        full = self.ctx.driver.joint_state().positions.copy()
        # the TCP's z axis, points out of the hand
        axis = self.tree.link_pose(full, self.tip).rotation.matrix[:, 2]
        pressed = -float(self.ctx.driver.wrench(self.gripper)[:3] @ axis)
        share = min(t / (0.6 * self.settings.press_time), 1.0)  # ramp of the target force
        offset = -float(self.admittance.update([pressed], self.ctx.driver.period, [share * self.force])[0])
        if t >= self.settings.press_time:
            self.forces.append(pressed)
        full[self.columns] = q
        J = self.tree.jacobian(full, self.tip, self.names)
        step = np.concatenate([offset * axis, np.zeros(3)])
        return q + np.linalg.lstsq(J, step, rcond=1e-6)[0], v

    def watch(self) -> Outcome | None:
        now = self._pose()
        turn = (self._last.rotation.inverse() @ now.rotation).log()
        self.angle += -float(turn[2])
        self._last = now
        size = float(np.linalg.norm(self.ctx.driver.wrench(self.gripper)[:3]))
        if size > self.settings.max_force:
            return Outcome(ErrorCode.CONTROL_FAILED, f"the hand pushes {self.item} with {size:.0f} N")
        return None

    def evidence(self) -> dict[str, float]:
        went = self.began.inverse().apply(self._last.translation)
        return {
            "turned": self.angle / (2 * np.pi), "went_in_mm": -1000 * float(went[2]),
            "force_mean_N": float(np.mean(self.forces)) if self.forces else 0.0,
            "force_max_N": float(np.max(self.forces)) if self.forces else 0.0,
        }  # fmt: skip
