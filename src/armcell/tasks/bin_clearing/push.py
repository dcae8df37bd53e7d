"""Stages of bin clearing that push or drag a piece off a wall."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from armcell.core import ErrorCode, JointTrajectory, Outcome
from armcell.drivers import Capability
from armcell.model import Gripper
from armcell.tasks.approach import ContactMonitor
from armcell.tasks.bin_clearing.stages import HEAP
from armcell.tasks.context import TaskContext
from armcell.tasks.search import PartialSolution, SearchState, stage_types
from armcell.tasks.settings import Speed
from armcell.tasks.stages.moves import plan_straight, shifted, with_contacts, with_motion
from armcell.tasks.steps import DONE, DropMonitor, Motion


@stage_types.register("push_piece")
@dataclass(frozen=True, eq=False)
class PushPiece:
    """Stage of bin clearing that pushes a piece of the heap in a straight line with the hand.

    Only the hand may touch the heap; the motion touches nothing else. A drag consists of two such motions:
    one fingertip presses on the piece from above, then pulls it.
    """

    gripper: Gripper
    speed: Speed
    most_force: float  # [N] on the hand; the push ends where the piece resists with more
    name: str = "push"
    offset: tuple[float, float, float] | None = None  # [m, world] of the motion; None: the chosen push's

    @property
    def requires(self) -> tuple[str, ...]:
        return ("grasp",) if self.offset is None else ()

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        offset = solution.data["grasp"].offset if self.offset is None else self.offset
        scene = with_contacts(solution.scene, ((HEAP, self.gripper.hand_links),))
        target = shifted(scene.frame_pose(self.gripper.tcp_link), offset, in_own_frame=False)
        result = plan_straight(scene, self.gripper.arm_group, self.gripper.tcp_link, target, self.speed)
        kind = partial(PushMotion, gripper=self.gripper, most_force=self.most_force)
        yield from with_motion(solution, planning, self.name, result, planned_in=scene, kind=kind)


@dataclass(frozen=True, eq=False)
class PushMotion(Motion):
    """Step of bin clearing that pushes a piece. A force on the hand above a limit ends the push early: the
    piece is stuck. The next image shows how far it has moved.
    """

    gripper: Gripper | None = None
    most_force: float = 0.0  # [N]

    def monitor(self, ctx: TaskContext, trajectory: JointTrajectory) -> DropMonitor:
        if self.gripper is not None and Capability.MEASURE_FORCE in ctx.driver.capabilities:
            return ContactMonitor(ctx, trajectory, self.planned_in, self.gripper, self.most_force)
        return super().monitor(ctx, trajectory)

    def outcome(self, ctx: TaskContext, watch: DropMonitor, result: Outcome) -> Outcome:
        if not isinstance(watch, ContactMonitor) or watch.wrench is None or ctx.cancel.is_set():
            return result
        ctx.emit("note", f"{self.name}: stopped, the piece resists with more than {self.most_force:.0f} N")
        return DONE if result.code is ErrorCode.PREEMPTED else result
