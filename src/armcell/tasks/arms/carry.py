"""Task of carrying one object with two arms: grasp both ends, move, put down, release."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.inter_arm_checker import without_arms
from armcell.core import SE3, SO3, CartesianRequest, ErrorCode, InputError, JointState, Outcome
from armcell.execution import Admittance
from armcell.planning import plan_cartesian
from armcell.tasks.arms.hand_pair import CarrySettings, HandPair, PairHold
from armcell.tasks.arms.two_arm_pick import PickWithTwoArms
from armcell.tasks.context import StageReport, TaskContext
from armcell.timing import merge_trajectories, synchronize_trajectories

Array = NDArray[np.float64]
SLIP_EVERY = 10  # cycles between two measurements of the slip


@dataclass
class CarryRecord:
    """Largest values measured while two arms carry an object: error of the relative pose of the hands,
    squeeze force, and slip of the object.
    """

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


class TwoArmCarry:
    """Task in which two arms carry an object: they grasp both of its ends,
    move it, put it down and release it.

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
        self.ctx, self.item, self.settings = ctx, item, settings
        self.hands = HandPair(ctx, both, item, ends, settings)
        self.record = CarryRecord()

    @property
    def _held(self) -> PairHold | None:
        return self.hands.hold

    def grasp(self, route: Sequence[SE3] = ()) -> Outcome:
        """Move both arms of a carry task to the ends of the object at the same time, and close the grippers.

        Args:
            route: later poses of the object; grasps that cannot reach them are rejected. Grasps with
                straight paths come first, then grasps with detours around obstacles.
        """
        if self._held is not None:
            raise InputError(f"{self.item!r} is in both hands already")
        outcome = PickWithTwoArms(self.hands, route).run()
        self._admittance = Admittance(self.settings.admittance)
        return outcome if outcome.ok else self._with_record(outcome)

    def move(self, *poses: SE3, name: str = "carry") -> Outcome:
        """Carry an object with two arms through the given poses (T_world_object), with a stop at each pose.

        The path is straight if possible, else it avoids obstacles.
        """
        held = self._known()
        start = self._object_pose(held)
        scene = self.hands.attached(self.ctx.scene().with_state(JointState(self.hands.names, held.q)))
        result = self.hands.plan(scene, held.carried, start, poses, self.settings.planning_time)
        report = StageReport(name, "carry", result.planning_time)
        if not result.ok or result.trajectory is None:
            return self._with_record(Outcome(result.code, f"{name}: {result.message}", result.evidence))
        report.clearance_m = result.min_clearance
        self.ctx.expect_contact(self.item, held.supports)
        evidence = {"poses": list(poses), "seed": self.ctx.seed, **result.evidence}
        outcome = self.hands.play(
            name, result.trajectory, report, self._correct, self._watch, evidence, scene
        )
        if outcome.ok:
            held.q = self._corrected(result.trajectory.positions[-1], self._admittance.offset)
        return self._with_record(outcome)

    def shift(
        self, x: float = 0.0, y: float = 0.0, z: float = 0.0, turn_deg: float = 0.0, name: str = "carry"
    ):
        """Carry an object with two arms by an offset [m] along the world axes,
        and rotate it about the vertical.
        """
        here = self._object_pose(self._known())
        return self.move(moved_object_pose(here, x, y, z, turn_deg), name=name)

    def release(self) -> Outcome:
        """Open both grippers after two arms have carried an object, and retreat straight from the object."""
        self._known()
        widths = {}
        for group, gripper in self.hands.grippers.items():
            now = self.ctx.driver.gripper(gripper.name).width
            widths[group] = min(now + 0.02, gripper.max_width)
        self.record.slip_m = max(self.record.slip_m, self._slip())
        outcome = self.hands.move_fingers("open both", widths, self.settings.settle)
        self.ctx.driver.unwatch_object(self.item)
        self.hands.hold = None
        if not outcome:
            return self._with_record(outcome)
        scene = self.ctx.scene()
        retreats = []
        for group, gripper in self.hands.grippers.items():
            alone = without_arms(scene, self.hands.other(group)).with_allowed(self.item, gripper.hand_links)
            back = scene.frame_pose(gripper.tcp_link) @ SE3.from_xyz(0, 0, -self.settings.approach)
            near = self.ctx.settings.near
            result = plan_cartesian(
                alone, CartesianRequest(group, (back,), gripper.tcp_link, velocity_scaling=near.velocity,
                                        acceleration_scaling=near.acceleration),
            )  # fmt: skip
            if not result.ok or result.trajectory is None:
                return self._with_record(
                    Outcome(result.code, f"retreat of {group}: {result.message}", result.evidence)
                )
            retreats.append(result.trajectory)
        outcome = self.hands.play("retreat both", merge_trajectories(*synchronize_trajectories(retreats)))
        for gripper in self.hands.grippers.values():
            self.ctx.expect_contact(self.item, gripper.contact_links, expected=False)
        return self._with_record(outcome)

    def _object_pose(self, held: PairHold) -> SE3:
        """Return T_world_object of the object that two arms carry, computed from the commanded joint
        positions and the first hand's grasp.
        """
        first = self.hands.first
        return self.hands.tcp_poses_at(held.q)[first] @ held.carried.grasps[first].inverse()

    def _known(self) -> PairHold:
        if self._held is None:
            raise InputError(f"{self.item!r} is not in both hands", hint="grasp it first")
        return self._held

    def squeeze(self) -> Array:
        """Return the internal force (3,) [N] with which two arms squeeze the object that they carry: half the
        difference of the forces at the two hands.
        """
        first, second = (self.ctx.driver.wrench(self.hands.grippers[g].name)[:3] for g in self.hands.groups)
        return (second - first) / 2

    def _correct(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        offset = self._admittance.update(self.squeeze(), self.ctx.driver.period)
        return self._corrected(q, offset), v

    def _corrected(self, q: Array, offset: Array) -> Array:
        """Correct the joint setpoints of a two-arm carry: return setpoints that shift the second hand by an
        offset (3,) [m] without rotating it.
        """
        if not offset.any():
            return q
        group = self.hands.second
        names = self.ctx.base.model.group(group).joint_names
        at = [self.hands.names.index(n) for n in names]
        full = self.ctx.driver.joint_state().positions.copy()
        full[self.hands.columns] = q
        J = self.hands.tree.jacobian(full, self.hands.tips[group], names)
        out = q.copy()
        out[at] += np.linalg.lstsq(J, np.concatenate([offset, np.zeros(3)]), rcond=1e-6)[0]
        return out

    def _slip(self) -> float:
        held = self._known()
        here = (
            self.hands.measured_tcp_poses()[self.hands.first].inverse()
            @ self.ctx.driver.object_poses()[self.item]
        )
        return held.T_first_object.distance_to(here)[0]

    def _watch(self) -> Outcome | None:
        """Check, while two arms carry an object, that the hands keep their relative pose, that the internal
        force stays below its limit, and that both hands still hold the object.

        The check runs in every control cycle.
        """
        held, s, r = self._known(), self.settings, self.record
        hands = self.hands.measured_tcp_poses()
        off, turn = held.T_hands.distance_to(hands[self.hands.first].inverse() @ hands[self.hands.second])
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

    def _with_record(self, outcome: Outcome) -> Outcome:
        return replace(outcome, evidence={**outcome.evidence, **self.record.as_dict()})


def moved_object_pose(T: SE3, x: float = 0.0, y: float = 0.0, z: float = 0.0, turn_deg: float = 0.0) -> SE3:
    """Return the pose of an object that two arms carry,
    moved along the world axes and rotated about the vertical.
    """
    turn = SO3.exp((0.0, 0.0, np.deg2rad(turn_deg)))
    return SE3(turn @ T.rotation, T.translation + np.array([x, y, z]))
