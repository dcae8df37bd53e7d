"""Pushes and drags of bin clearing, which move a piece off a wall."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from armcell.core import ErrorCode, JointTrajectory, Outcome
from armcell.drivers import Capability
from armcell.grasping import HeapDrag, HeapPush, drags_off_walls, hand_of, pushes_off_walls
from armcell.model import Gripper
from armcell.tasks.approach import ContactMonitor
from armcell.tasks.bin_clearing.counts import BinClearingCounts
from armcell.tasks.bin_clearing.settings import BinClearingSettings
from armcell.tasks.bin_clearing.stages import HEAP, ChooseFromHeap
from armcell.tasks.bin_clearing.work_regions import RegionView
from armcell.tasks.context import TaskContext
from armcell.tasks.pick import grasp_stages
from armcell.tasks.search import PartialSolution, SearchState, stage_types
from armcell.tasks.settings import Speed
from armcell.tasks.stages.fingers import opened_in_transit
from armcell.tasks.stages.moves import plan_straight, shifted, with_contacts, with_motion
from armcell.tasks.steps import DONE, DropMonitor, Motion, perform_all
from armcell.tasks.task import plan_stages


def push_off_wall(
    ctx: TaskContext,
    gripper: Gripper,
    here: RegionView,
    settings: BinClearingSettings,
    counts: BinClearingCounts,
) -> tuple[HeapPush | HeapDrag | None, Outcome]:
    """Push or drag a piece away from the walls if the hand does not fit around it: the motion with the best
    prediction. Return the motion, after which the hand must retreat, and its outcome. If the arm can reach no
    such motion, return None and PLANNING_FAILED.
    """
    hand = hand_of(ctx.base.model, gripper)
    seen = here.map, here.labels, here.cells, here.region.floor, hand
    pushes = pushes_off_walls(*seen, settings.pushes, counts.pushed)
    drags = drags_off_walls(*seen, settings.drags, counts.dragged)
    kinds: list[Sequence[HeapPush] | Sequence[HeapDrag]] = [pushes, drags]
    text = f"no push moves a piece {here.region.name} off its wall"
    done, outcome = None, Outcome(ErrorCode.PLANNING_FAILED, text)
    for motions in sorted(filter(None, kinds), key=lambda motions: -motions[0].score):
        done, outcome = _perform_first(ctx, gripper, motions, here, settings, counts)
        if done is not None:
            break
    return done, outcome


def _perform_first(
    ctx: TaskContext, gripper: Gripper, pushes: Sequence[HeapPush] | Sequence[HeapDrag], here: RegionView,
    s: BinClearingSettings, counts: BinClearingCounts,
) -> tuple[HeapPush | HeapDrag | None, Outcome]:  # fmt: skip
    """Perform the first of the pushes or drags that the arm can reach."""
    t = ctx.settings
    press = PushPiece(gripper, s.press, s.press_force, "press")
    begin = press if isinstance(pushes[0], HeapDrag) else PushPiece(gripper, s.push, s.push_force)
    choose = ChooseFromHeap(pushes, gripper, t.near, t.approach_distance)
    stages = grasp_stages(choose, gripper, t, begin, name="move to push")
    solution, outcome = plan_stages(ctx, stages, f"push {here.region.name}")
    if solution is None:
        return None, outcome
    push: HeapPush | HeapDrag = solution.data["grasp"]
    counts.pushes += 1
    counts.last_view = None
    counts.pushed.append((*push.T_object_tcp.translation[:2].tolist(), push.angle))
    outcome = perform_all(ctx, opened_in_transit(ctx.scene(), solution.steps))
    if isinstance(push, HeapDrag):
        counts.dragged.append(push.contact)
    if outcome.ok and isinstance(push, HeapDrag):
        pull = PushPiece(gripper, s.push, s.push_force, "drag", push.pull)
        solution, _ = plan_stages(ctx, [pull], f"drag {here.region.name}")
        if solution is not None:
            outcome = perform_all(ctx, solution.steps)
    return push, outcome


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
