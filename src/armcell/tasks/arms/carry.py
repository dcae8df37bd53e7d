"""Carrying one object with two arms: grasp both ends, move, put down, release."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision import neighbors
from armcell.collision.arms import Arms, merged, without_arm
from armcell.core import (
    SE3,
    SO3,
    CartesianRequest,
    ErrorCode,
    InputError,
    JointGoal,
    JointState,
    JointTrajectory,
    Outcome,
    PlanResult,
)
from armcell.core.checks import checked, require
from armcell.execution.admittance import Admittance, AdmittanceSettings
from armcell.grasping import grip_force, pre_opening
from armcell.kinematics import ik_solver, kinematic_tree
from armcell.planning import CarriedObject, plan_carry, plan_cartesian
from armcell.scene import PlanningScene
from armcell.tasks.arms.coupled import move_together, play
from armcell.tasks.context import StageReport, TaskContext
from armcell.tasks.steps import staged
from armcell.timing import reversed_in_time, synchronized

Array = NDArray[np.float64]
GRASPS = 6  # grasps for which detours are searched if no straight path exists
SLIP_EVERY = 10  # cycles between two measurements of the slip
DONE = Outcome(ErrorCode.SUCCESS)


@dataclass(frozen=True)
@checked()
class CarrySettings:
    """Settings of carrying one object with two arms."""

    velocity: float = 0.3  # scaling of the joint limits
    acceleration: float = 0.15
    max_speed: float = 0.2  # [m/s] maximum speed of the object
    max_off: float = 5e-4  # [m] maximum deviation of the hands' relative position; more stops both arms
    max_turn: float = 1.7453e-3  # [rad] maximum deviation of their relative rotation: 0.1 degree
    max_squeeze: float = 30.0  # [N] maximum internal force between the hands; more stops both arms
    approach: float = 0.1  # [m] straight approach
    planning_time: float = 10.0  # [s] for detours around obstacles; 0: only straight paths
    settle: float = 0.4  # [s] pause after closing and after opening
    admittance: AdmittanceSettings = AdmittanceSettings()

    def __post_init__(self) -> None:
        for name in ("max_off", "max_turn", "max_squeeze", "approach", "max_speed"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        require(self.planning_time >= 0, f"planning_time is {self.planning_time:g}, it must be at least 0")


@dataclass
class CarryRecord:
    """Largest deviations of all control cycles since the grasp."""

    off_m: float = 0.0
    turn_rad: float = 0.0
    squeeze_n: float = 0.0
    slip_m: float = 0.0
    ticks: int = 0

    def as_dict(self) -> dict[str, float]:
        return {
            "relative_error_mm": 1000 * self.off_m, "relative_error_deg": float(np.rad2deg(self.turn_rad)),
            "squeeze_N": self.squeeze_n, "slip_mm": 1000 * self.slip_m, "ticks": self.ticks,
        }  # fmt: skip


@dataclass
class _Held:
    """State when both grippers have closed."""

    carried: CarriedObject  # grasps at the set points
    T_hands: SE3  # measured pose of the second hand in the first
    T_first_object: SE3  # measured
    supports: tuple[str, ...]
    q: Array = field(default_factory=lambda: np.zeros(0))  # current set points of both arms


class Carrying:
    """Object carried by two arms.

    Every method returns an `Outcome`; the first failure stops both arms.

    Args:
        both: the group of both arms' joints.
        ends: arm group -> subframe of the object for the arm's TCP. The TCP's z axis aligns with the
            subframe's z axis, the fingers close along its y axis; a half turn about z is allowed.
    """

    def __init__(
        self, ctx: TaskContext, both: str, item: str, ends: Mapping[str, str],
        settings: CarrySettings = CarrySettings(),
    ):  # fmt: skip
        model, found = ctx.scene().model, ctx.scene().object(item)
        if len(ends) != 2:
            raise InputError(f"{item!r} is given to {len(ends)} arms, two are needed")
        for end in ends.values():
            if end not in found.subframes:
                raise InputError(
                    f"object {item!r} has no subframe {end!r}", cure=f"{sorted(found.subframes)}"
                )
        if not found.movable:
            raise InputError(f"object {item!r} is fixed", cure="give it 'movable: true'")
        self.ctx, self.both, self.item, self.ends, self.settings = ctx, both, item, dict(ends), settings
        self.groups: tuple[str, str] = tuple(ends)  # type: ignore[assignment]
        self.grippers = {g: model.gripper(arm_group=g) for g in ends}
        self.tips = {g: self.grippers[g].tcp_link for g in ends}
        self.names = model.group(both).joint_names
        self.tree = kinematic_tree(model)
        self.record = CarryRecord()
        self._held: _Held | None = None

    # --- grasping ---
    def grasp(self, route: Sequence[SE3] = ()) -> Outcome:
        """Move both arms to the object's ends simultaneously and close the grippers.

        Args:
            route: later poses of the object; grasps that cannot reach them are rejected. Grasps with
                straight paths come first, then grasps with detours around obstacles.
        """
        if self._held is not None:
            raise InputError(f"{self.item!r} is in both hands already")
        scene = self.ctx.scene()
        why, others = "no grasp was tried", []
        for hands in self._hands(scene):
            if isinstance(hands, str):
                why = hands
                continue
            if route:
                ahead = self._ahead(scene, hands, route, 0.0)
                if not ahead.ok:
                    why = ahead.message
                    others.append(hands)
                    continue
            return self._take(hands[0], why)
        end = time.monotonic() + self.settings.planning_time
        others = others[:GRASPS]
        for k, hands in enumerate(others):
            seconds = (end - time.monotonic()) / (len(others) - k)
            if seconds <= 0 or self.ctx.cancel.is_set():
                break
            ahead = self._ahead(scene, hands, route, seconds)
            if ahead.ok:
                return self._take(hands[0], why)
            why = ahead.message
        return self._told(Outcome(ErrorCode.PLANNING_FAILED, f"grasp {self.item} with both arms: {why}"))

    def _ahead(self, scene: PlanningScene, hands, route: Sequence[SE3], seconds: float) -> PlanResult:
        """Plan the motion along a route with one choice of grasps (see `_hands`)."""
        _, at_grasp, grasps = hands
        trial = self._attached(scene.with_state(at_grasp))
        carried = CarriedObject(self.item, grasps, self.tips)
        return self._plan(trial, carried, scene.object(self.item).T_world_object, route, seconds)

    def _hands(self, scene: PlanningScene):
        """Yield simultaneous approaches of both arms with the state at the grasp.

        If an arm has no approach, yield the reason as text instead.
        """
        item = scene.object(self.item)
        options = {}
        for group in self.groups:
            options[group] = list(self._approaches(scene, group, item.T_world_object))
            if not options[group]:
                yield f"{group} has no straight way to {self.ends[group]!r}"
                return
        start = scene.state

        def far(pair) -> float:
            return sum(
                float(np.abs(a.positions[0] - start.reindexed(a.joint_names).positions).max())
                for a, _ in pair
            )

        arms = Arms(scene, self.groups)
        for pair in sorted(product(*options.values()), key=far):
            motions = synchronized([trajectory for trajectory, _ in pair])
            if not arms.certify(motions[0], motions[1], clearance=0.01, evidence=False).free:
                yield "the hands come too near each other"
                continue
            state = motions[0].end.as_dict() | motions[1].end.as_dict()
            yield (
                motions,
                JointState.from_mapping(state),
                {g: T for g, (_, T) in zip(self.groups, pair, strict=True)},
            )

    def _approaches(self, scene: PlanningScene, group: str, T_world_object: SE3):
        """Yield straight approaches of one arm to its end of the object, each with T_object_tcp."""
        gripper, s = self.grippers[group], self.settings
        other = next(g for g in self.groups if g != group)
        alone = without_arm(self._opened(scene), other).with_allowed(self.item, gripper.hand_links)
        ik = ik_solver(alone.model, group, gripper.tcp_link)
        for turn in (0.0, np.pi):
            T = scene.object(self.item).subframes[self.ends[group]] @ SE3(
                SO3.exp((0.0, 0.0, turn)), np.zeros(3)
            )
            target = T_world_object @ T
            for q in ik.nearest(target, alone.positions, among=8):
                at = alone.with_state(JointState(ik.joint_names, q))
                back = target @ SE3.from_xyz(0.0, 0.0, -s.approach)
                near = self.ctx.settings.near
                result = plan_cartesian(
                    at, CartesianRequest(group, (back,), gripper.tcp_link, velocity_scaling=near.velocity,
                                         acceleration_scaling=near.acceleration),
                )  # fmt: skip
                if result.ok and result.trajectory is not None:
                    yield reversed_in_time(result.trajectory), T

    def _opened(self, scene: PlanningScene) -> PlanningScene:
        for group, gripper in self.grippers.items():
            q = np.array([gripper.joint_position(self._opening(group))])
            scene = scene.with_state(JointState((gripper.joint_name,), q))
        return scene

    def _opening(self, group: str) -> float:
        item, gripper = self.ctx.scene().object(self.item), self.grippers[group]
        width = item.extent(item.subframes[self.ends[group]].rotation.matrix[:, 1])
        return pre_opening(width, gripper)

    def _take(self, approaches: Sequence[JointTrajectory], why: str) -> Outcome:
        ctx, driver = self.ctx, self.ctx.driver
        scene = ctx.scene()
        supports = tuple(neighbors(scene, self.item))
        widths = {g: self._opening(g) for g in self.groups}
        item = scene.object(self.item)
        outcome = self._grip("open both", widths, 0.3)
        goals = {
            g: JointGoal(JointState(a.joint_names, a.positions[0]))
            for g, a in zip(self.groups, approaches, strict=True)
        }
        outcome = outcome and move_together(self.ctx, self.both, goals, "both to the ends")
        if not outcome:
            return self._told(outcome)
        for group in self.groups:
            ctx.expect_contact(self.item, self.grippers[group].finger_links)
        outcome = self._play("approach both", merged(approaches[0], approaches[1]))
        force = {g: grip_force(item, self.grippers[g]) for g in self.groups}
        outcome = outcome and self._grip(
            "close both", dict.fromkeys(self.groups, 0.0), self.settings.settle, force
        )
        if not outcome:
            return self._told(outcome)
        for group in self.groups:
            reading = driver.gripper(self.grippers[group].name)
            if reading.held != self.item:
                apart = 1000 * reading.width
                text = f"{group} has not grasped {self.item}: its fingers are {apart:.0f} mm apart"
                return self._told(Outcome(ErrorCode.CONTROL_FAILED, f"{text}; {ctx.belief(self.item)}"))
        driver.watch_object(self.item, supports)
        q = np.concatenate([a.positions[-1] for a in approaches])
        order = [n for a in approaches for n in a.joint_names]
        q = q[[order.index(n) for n in self.names]]
        T_object = driver.object_poses()[self.item]
        hands, measured = self._hands_at(q), self._measured()
        grasps = {g: T_object.inv() @ hands[g] for g in self.groups}
        first, second = self.groups
        self._held = _Held(
            CarriedObject(self.item, grasps, self.tips), measured[first].inv() @ measured[second],
            measured[first].inv() @ T_object, supports, q,
        )  # fmt: skip
        self._admittance = Admittance(self.settings.admittance)
        ctx.emit("grasp", f"both hands hold {self.item}")
        return DONE

    # --- carrying ---
    def move(self, *poses: SE3, name: str = "carry") -> Outcome:
        """Carry the object through poses (T_world_object) with a stop at each.

        The path is straight if possible, else it avoids obstacles.
        """
        held = self._known()
        start = self._hands_at(held.q)[self.groups[0]] @ held.carried.grasps[self.groups[0]].inv()
        scene = self._attached(self.ctx.scene().with_state(JointState(self.names, held.q)))
        result = self._plan(scene, held.carried, start, poses, self.settings.planning_time)
        report = StageReport(name, "carry", result.planning_time)
        if not result.ok or result.trajectory is None:
            return self._told(Outcome(result.code, f"{name}: {result.message}", result.evidence))
        report.clearance_m = result.min_clearance
        self.ctx.expect_contact(self.item, held.supports)
        told = {"poses": list(poses), "seed": self.ctx.seed, **result.evidence}
        outcome = self._play(name, result.trajectory, report, self._correct, self._watch, told)
        if outcome.ok:
            held.q = self._corrected(result.trajectory.positions[-1], self._admittance.offset)
        return self._told(outcome)

    def shift(
        self, x: float = 0.0, y: float = 0.0, z: float = 0.0, turn_deg: float = 0.0, name: str = "carry"
    ):
        """Carry the object by an offset [m] in world axes, with a rotation about the vertical."""
        here = (
            self._hands_at(self._known().q)[self.groups[0]]
            @ self._known().carried.grasps[self.groups[0]].inv()
        )
        return self.move(shifted(here, x, y, z, turn_deg), name=name)

    def release(self) -> Outcome:
        """Open both grippers and retreat straight back."""
        self._known()
        widths = {}
        for group, gripper in self.grippers.items():
            now = self.ctx.driver.gripper(gripper.name).width
            widths[group] = min(now + 0.02, gripper.max_width)
        self.record.slip_m = max(self.record.slip_m, self._slip())
        outcome = self._grip("open both", widths, self.settings.settle)
        self.ctx.driver.unwatch_object(self.item)
        self._held = None
        if not outcome:
            return self._told(outcome)
        scene = self.ctx.scene()
        retreats = []
        for group, gripper in self.grippers.items():
            other = next(g for g in self.groups if g != group)
            alone = without_arm(scene, other).with_allowed(self.item, gripper.hand_links)
            back = scene.frame_pose(gripper.tcp_link) @ SE3.from_xyz(0, 0, -self.settings.approach)
            near = self.ctx.settings.near
            result = plan_cartesian(
                alone, CartesianRequest(group, (back,), gripper.tcp_link, velocity_scaling=near.velocity,
                                        acceleration_scaling=near.acceleration),
            )  # fmt: skip
            if not result.ok or result.trajectory is None:
                return self._told(
                    Outcome(result.code, f"retreat of {group}: {result.message}", result.evidence)
                )
            retreats.append(result.trajectory)
        outcome = self._play("retreat both", merged(*synchronized(retreats)))
        for gripper in self.grippers.values():
            self.ctx.expect_contact(self.item, gripper.finger_links, expected=False)
        return self._told(outcome)

    # --- helpers ---
    def _known(self) -> _Held:
        if self._held is None:
            raise InputError(f"{self.item!r} is not in both hands", cure="grasp it first")
        return self._held

    def _attached(self, scene: PlanningScene) -> PlanningScene:
        """Return the scene with the object attached to the first hand.

        Contacts of both hands and of the supports with the object are allowed.
        """
        first, second = (self.grippers[g] for g in self.groups)
        supports = self._supports(scene)
        scene = scene.with_attached(self.item, first.tcp_link, first.hand_links)
        return scene.with_allowed(self.item, (*second.hand_links, *supports))

    def _supports(self, scene: PlanningScene) -> tuple[str, ...]:
        """Return the object's supports, now or at the time of the grasp."""
        return self._held.supports if self._held is not None else tuple(neighbors(scene, self.item))

    def _plan(
        self, scene: PlanningScene, carried: CarriedObject, start: SE3, poses: Sequence[SE3], seconds: float
    ) -> PlanResult:
        s, rests_on = self.settings, self._supports(self.ctx.scene())
        return plan_carry(
            scene, self.both, carried, start, poses, s.velocity, s.acceleration, s.max_speed, rests_on,
            seconds, self.ctx.seed, self.ctx.cancel,
        )  # fmt: skip

    def _hands_at(self, q: Array) -> dict[str, SE3]:
        full = self.ctx.driver.joint_state().positions.copy()
        full[self.ctx.scene().model.columns(self.names)] = q
        return {g: self.tree.link_pose(full, self.tips[g]) for g in self.groups}

    def _measured(self) -> dict[str, SE3]:
        poses = self.tree.link_poses(self.ctx.driver.joint_state().positions, tuple(self.tips.values()))
        return dict(zip(self.tips, poses, strict=True))

    def squeeze(self) -> Array:
        """Return the internal force (3,) [N]: half the difference of the hands' forces."""
        first, second = (self.ctx.driver.wrench(self.grippers[g].name)[:3] for g in self.groups)
        return (second - first) / 2

    def _correct(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        offset = self._admittance.update(self.squeeze(), self.ctx.driver.period)
        return self._corrected(q, offset), v

    def _corrected(self, q: Array, offset: Array) -> Array:
        """Return set points with the second hand moved by an offset (3,) [m], by its Jacobian."""
        if not offset.any():
            return q
        group = self.groups[1]
        names = self.ctx.base.model.group(group).joint_names
        at = [self.names.index(n) for n in names]
        full = self.ctx.driver.joint_state().positions.copy()
        full[self._columns] = q
        J = self.tree.jacobian(full, self.tips[group], names)
        out = q.copy()
        out[at] += np.linalg.lstsq(J, np.concatenate([offset, np.zeros(3)]), rcond=1e-6)[0]
        return out

    @property
    def _columns(self) -> list[int]:
        return self.ctx.base.model.columns(self.names)

    def _slip(self) -> float:
        held = self._known()
        here = self._measured()[self.groups[0]].inv() @ self.ctx.driver.object_poses()[self.item]
        return held.T_first_object.distance_to(here)[0]

    def _watch(self) -> Outcome | None:
        """Check the hands' relative pose, the internal force and the object's presence.

        Runs in every control cycle.
        """
        held, s, r = self._known(), self.settings, self.record
        hands = self._measured()
        off, turn = held.T_hands.distance_to(hands[self.groups[0]].inv() @ hands[self.groups[1]])
        force = float(np.linalg.norm(self._admittance.force))
        r.off_m, r.turn_rad = max(r.off_m, off), max(r.turn_rad, turn)
        r.squeeze_n, r.ticks = max(r.squeeze_n, force), r.ticks + 1
        if r.ticks % SLIP_EVERY == 0:
            r.slip_m = max(r.slip_m, self._slip())
        if off > s.max_off or turn > s.max_turn:
            text = f"the hands are {1000 * off:.2f} mm and {np.rad2deg(turn):.3f} degrees off their grasps"
            return Outcome(ErrorCode.CONTROL_FAILED, text, {"off_m": off, "turn_rad": turn})
        if force > s.max_squeeze:
            return Outcome(ErrorCode.CONTROL_FAILED, f"the hands squeeze {self.item} with {force:.0f} N")
        return None

    def _grip(
        self, name: str, widths: Mapping[str, float], settle: float, force: Mapping[str, float] | None = None
    ) -> Outcome:
        """Command both grippers simultaneously and wait for both."""
        ctx, driver = self.ctx, self.ctx.driver

        def act() -> Outcome:
            for group, width in widths.items():
                g = self.grippers[group]
                driver.command_gripper(g.name, width, g.max_force if force is None else force[group])
            end = driver.now + ctx.settings.gripper_timeout
            while driver.now < end and not ctx.cancel.is_set():
                ctx.advance(0.02)
                if all(self._there(g, w, None if force is None else force[g]) for g, w in widths.items()):
                    break
            ctx.advance(settle)
            return Outcome(ErrorCode.PREEMPTED, "cancelled") if ctx.cancel.is_set() else DONE

        return staged(ctx, StageReport(name), act)

    def _there(self, group: str, width: float, force: float | None) -> bool:
        reading = self.ctx.driver.gripper(self.grippers[group].name)
        if force is None:
            return abs(reading.width - width) < 1e-3
        return reading.held == self.item and reading.force_per_finger >= 0.8 * force

    def _play(
        self, name: str, trajectory: JointTrajectory, report: StageReport | None = None,
        correct: Callable | None = None, watch: Callable | None = None,
        evidence: Mapping[str, Any] = MappingProxyType({}),
    ) -> Outcome:  # fmt: skip
        return play(
            self.ctx,
            trajectory.reindexed(self.names),
            report or StageReport(name, "cartesian"),
            correct,
            watch,
            evidence,
            self._touched,
        )

    def _touched(self) -> PlanningScene:
        """Return the measured scene with the hands' contacts allowed and a held object attached."""
        scene = self.ctx.scene()
        if self._held is not None:
            return self._attached(scene)
        return scene.with_allowed(self.item, [n for g in self.grippers.values() for n in g.hand_links])

    def _told(self, outcome: Outcome) -> Outcome:
        return replace(outcome, evidence={**outcome.evidence, **self.record.as_dict()})


def shifted(T: SE3, x: float = 0.0, y: float = 0.0, z: float = 0.0, turn_deg: float = 0.0) -> SE3:
    """Return a pose moved in world axes and rotated about the vertical through its origin."""
    turn = SO3.exp((0.0, 0.0, np.deg2rad(turn_deg)))
    return SE3(turn @ T.rotation, T.translation + np.array([x, y, z]))
