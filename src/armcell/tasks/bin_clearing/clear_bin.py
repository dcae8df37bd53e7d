"""Bin clearing task: look, pick a piece, release it over the tray, and repeat."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from armcell.core import ErrorCode, InputError, NamedGoal, Outcome
from armcell.grasping import (
    Grasp,
    HeapGrasp,
    TopDownGraspSettings,
    hand_of,
    top_down_grasps,
)
from armcell.model import Gripper, SuctionGripper
from armcell.planning import warm_up
from armcell.tasks.bin_clearing.counts import BinClearingCounts
from armcell.tasks.bin_clearing.push import push_off_wall
from armcell.tasks.bin_clearing.settings import BinClearingSettings
from armcell.tasks.bin_clearing.stages import (
    HEAP,
    CheckObjectInFingers,
    ChooseFromHeap,
    ChooseReleasePoint,
    CloseOnHeap,
    Drop,
    GripUntilForce,
    ReleaseAboveTray,
    detach_held,
    held_object,
    holds,
)
from armcell.tasks.bin_clearing.work_regions import (
    Look,
    RegionView,
    WorkRegion,
    add_heap,
    first_not_empty,
    floor_of,
    lowest_points,
    table_around,
    view_region,
)
from armcell.tasks.context import TaskContext
from armcell.tasks.pick import Pick, grasp_stages
from armcell.tasks.search import PartialSolution, Stage
from armcell.tasks.stages import AppendPlannedMotion, Connect, MoveStraight, RunSteps
from armcell.tasks.stages.fingers import opened_in_transit
from armcell.tasks.steps import CommandGripper, Step, perform_all
from armcell.tasks.task import plan_stages

LIFTED = 0.02  # [m] of a lift that a retreat does not finish
STEEP = 0.010  # [m] height of a side within 9 mm (three cells) that fingers along a slanted approach hold
_FINAL = (ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA, ErrorCode.SENSOR_INFO_STALE, ErrorCode.FAILURE)


def clear_bin(
    ctx: TaskContext,
    gripper: Gripper,
    bin: str,
    tray: str,
    table: str,
    look: Look,
    look_at_tray: Look,
    settings: BinClearingSettings = BinClearingSettings(),
    others: Sequence[str] = (),
    counts: BinClearingCounts | None = None,
) -> Outcome:
    """Pick objects from a bin, and release them over a tray, until the bin is empty.

    Uses only images and the gripper's readings. The next image shows dropped objects; objects beside bin or
    tray are picked up last. Several arms may clear one bin side by side: the arm that reserves the bin looks
    and picks, while the others put their objects into their trays.

    Args:
        bin, tray: fixed objects with a level floor, square to the world's axes.
        table: the fixed object that both stand on.
        look, look_at_tray: return the newest depth image of each.
        others: further containers on the table, whose content stays.
        counts: shared by the arms that clear the bin; None for one arm.
    Returns:
        SUCCESS if no piece is visible any more, otherwise the reason for giving up. Evidence: `picks`, `put`,
        `missed`, `dropped`, `unplanned` (counts).
    Raises:
        InputError: the gripper has suction cups, or bin or tray have no level floor or are not aligned with
            the world axes.
    """
    if isinstance(gripper, SuctionGripper):
        raise InputError(f"clear_bin needs a gripper with jaws, {gripper.name!r} has suction cups")
    warm_up()
    s, base = settings, ctx.base
    bin_region, tray_region = floor_of(base, bin, s), floor_of(base, tray, s)
    containers = (bin, tray, *others)
    regions = (
        (look, bin_region),
        (look, table_around(base, bin, table, containers, s)),
        (look_at_tray, table_around(base, tray, table, containers, s)),
    )
    counts = BinClearingCounts() if counts is None else counts
    return _BinClearing(ctx, gripper, containers, s, counts, regions, look_at_tray, tray_region).run()


class _BinClearing:
    """One run of `clear_bin`: the arm looks, picks an object and releases it over the tray, until the bin is
    empty.

    Args:
        containers: names of the bin, of the tray and of further containers on the table.
        regions: the work regions with the cameras that see them, in the order in which they are cleared.
    """

    def __init__(
        self, ctx: TaskContext, gripper: Gripper, containers: Sequence[str], settings: BinClearingSettings,
        counts: BinClearingCounts, regions: Sequence[tuple[Look, WorkRegion]], look_at_tray: Look,
        tray: WorkRegion,
    ):  # fmt: skip
        self.ctx, self.gripper, self.settings, self.counts = ctx, gripper, settings, counts
        self.containers, self.bin = tuple(containers), containers[0]
        self._regions, self._look_at_tray, self._tray = regions, look_at_tray, tray
        self._is_away = False  # the arm, from the cameras' view
        self._has_failed = False  # a pick, push or put, after which the arm must leave the cameras' view
        self._any_grasp = False  # whether to try even slanted grasps, and those of only the top of a piece

    def run(self) -> Outcome:
        """Clear a bin: pick the objects in its work regions, one region after the other, and put them into
        the tray.
        """
        counts = self.counts
        while not self.ctx.cancel.is_set():
            with self.ctx.reserve(self.bin):
                pick, end = self._grasp()
            if pick is not None:  # the next arm may move to the bin while this one lifts its object
                outcome = self._put_away(pick)
                if not outcome.ok:
                    end = self._failed(outcome)
            if self._has_failed:  # not before other arms may use the bin
                self._leave_view()
            if end is not None:
                return Outcome(end.code, end.message, counts.as_dict())
        return Outcome(ErrorCode.PREEMPTED, "cancelled", counts.as_dict())

    def _grasp(self) -> tuple[_PickFromHeap | None, Outcome | None]:
        """Let `clear_bin` look and grasp an object, or push a piece off a wall. Return the pick if the hand
        holds an object, and the end of the task if it ends.
        """
        ctx, s, counts = self.ctx, self.settings, self.counts
        if (old := self._old_view()) is not None and counts.picks < s.most_picks:
            pick, outcome = self._grasp_from(old)
            if outcome.ok:
                return pick, None
            if outcome.code is not ErrorCode.PLANNING_FAILED:
                return None, self._failed(outcome)
        here = first_not_empty(ctx, [(eye, r) for eye, r in self._regions if r.name not in counts.left], s)
        if isinstance(here, Outcome):
            if here.ok and not self._is_away and counts.picks + counts.pushes > 0:
                self._leave_view()  # the arm may hide a piece beside the tray
                self._is_away = True
                return None, None
            if here.ok and counts.left:
                last = f"at least {s.most_misses} picks in a row brought nothing"
                return None, _given_up(last, counts.left.values())
            return None, here
        where = f"{here.count} {here.region.name}"
        if counts.picks >= s.most_picks:
            last = f"{counts.picks} picks are all that was allowed"
            return None, _given_up(last, [*counts.left.values(), where])
        if counts.in_a_row >= max(s.most_misses, s.tries_per_piece * here.count):
            counts.left[here.region.name] = where
            counts.in_a_row = 0
            return None, None
        counts.last_view, counts.touched = here if here.region is self._regions[0][1] else None, []
        self._is_away = False
        pick, outcome = self._grasp_from(here)
        self._any_grasp = False
        if outcome.ok:
            return pick, None
        end = self._failed(outcome)
        if outcome.code is ErrorCode.PLANNING_FAILED:
            if len(counts.pushed) < s.most_pushes:
                push, outcome = push_off_wall(ctx, self.gripper, here, s, counts)
                if push is not None:
                    self.retreat(push)
            self._any_grasp = not outcome.ok
            counts.in_a_row -= outcome.ok  # the piece may have a grasp now
            end = outcome if outcome.code in _FINAL else None
        return None, end

    def _old_view(self) -> RegionView | None:
        """Return what the last image shows of the bin, without the pieces that an arm may have moved since,
        while another arm hides the bin from the camera. None if no piece remains.
        """
        view = self.counts.last_view
        if view is None or not self.ctx.is_hidden(view.corners):
            return None
        rest = view.without(self.counts.touched, self.settings.touched)
        return rest if rest.count else None

    def _grasp_from(self, here: RegionView) -> tuple[_PickFromHeap, Outcome]:
        """Let `clear_bin` close the hand on an object that it sees in a work region."""
        add_heap(self.ctx, here)
        pick = _PickFromHeap(self, here, self._any_grasp)
        outcome = pick.run()
        if outcome.ok:
            add_heap(self.ctx, here, pick.grasp.piece)
            self.counts.touched.append(pick.grasp.T_object_tcp.translation[:2])
        elif outcome.code is not ErrorCode.PLANNING_FAILED:
            self.counts.last_view = None
        return pick, outcome

    def _put_away(self, pick: _PickFromHeap) -> Outcome:
        """Let `clear_bin` lift the object in the hand, and release it over the tray."""
        outcome = perform_all(self.ctx, pick.lift)
        if outcome.code is ErrorCode.PREEMPTED:
            return outcome
        if not outcome.ok:
            self.counts.last_view = None
            pick.recover(outcome)
            return outcome
        counts, width = self.counts, self.ctx.driver.gripper(self.gripper.name).width
        put, outcome = self._plan_put(pick.grasp, pick.region)
        if put is not None:
            outcome = self._put(put, pick.grasp)
        if outcome.ok and width <= self.settings.thinnest:
            counts.in_a_row += 1  # perhaps nothing was between the fingers
            counts.avoid.append(pick.grasp)
        elif outcome.ok:
            counts.in_a_row, counts.avoid = 0, counts.avoid[-6:]
            counts.pushed, counts.dragged = [], []
        return outcome

    def _failed(self, outcome: Outcome) -> Outcome | None:
        """Count a failed attempt of `clear_bin`. Return the outcome if it ends the task."""
        if outcome.code is ErrorCode.PREEMPTED:
            return None
        self.counts.in_a_row += 1
        self.ctx.emit("note", f"clearing {self.bin}: {outcome.message}")
        return outcome if outcome.code in _FINAL else None

    def retreat(self, grasp: Grasp) -> None:
        """Let `clear_bin` retreat from a grasp: open the fingers and move straight up to the height of the
        lift, or as far as possible.

        After a grasp, the fingers open a little if they press on an object or have closed completely, and at
        most to their opening [m] before the grasp: the hand or the neighboring pieces may have moved since.
        After they have closed completely, thin sheet metal may still be between them.
        """
        ctx, gripper, s, t = self.ctx, self.gripper, self.settings, self.ctx.settings
        detach_held(ctx, gripper)
        reading = ctx.driver.gripper(gripper.name)
        width = min(max(reading.width, 0.0) + t.release_margin, grasp.opening)
        closed = holds(reading) or reading.width <= s.thinnest
        if isinstance(grasp, HeapGrasp) and closed:
            CommandGripper("open", gripper, width, gripper.max_force, t.release_settle).perform(ctx)
        touching = ((HEAP, gripper.hand_links), (self.bin, gripper.hand_links))
        now = ctx.scene().frame_pose(gripper.tcp_link).translation
        lifted = float(now[2] - grasp.T_object_tcp.translation[2])
        if (rest := s.lift - lifted) > LIFTED:
            self._try_straight("retreat", rest, touching)
        self._has_failed = True

    def _try_straight(self, name: str, rise: float, allow: tuple[tuple[str, tuple[str, ...]], ...]) -> None:
        """Let `clear_bin` move the hand straight up by `rise` [m]. If no motion is found, the hand stays."""
        gripper = self.gripper
        stage = MoveStraight(
            name, gripper.arm_group, gripper.tcp_link, self.ctx.settings.near, (0.0, 0.0, rise), allow=allow
        )
        solution, _ = plan_stages(self.ctx, [stage], name)
        if solution is not None:
            perform_all(self.ctx, solution.steps)

    def _leave_view(self) -> None:
        """Let `clear_bin` move the arm out of the camera's view, to the first named state that it
        can reach.
        """
        ctx, group = self.ctx, self.gripper.arm_group
        self._has_failed = False
        for name in ctx.base.model.named_states.get(group, {}):
            stage = Connect(f"move to {name}", group, ctx.settings.free, goal=NamedGoal(name))
            solution, _ = plan_stages(ctx, [stage], f"move to {name}")
            if solution is not None:
                perform_all(ctx, solution.steps)
                return

    def _plan_put(self, grasp: HeapGrasp, source: WorkRegion) -> tuple[PartialSolution | None, Outcome]:
        """Let `clear_bin` plan the release of a picked object over the lowest point of the tray. Return
        FAILURE if the tray is full.
        """
        ctx, gripper, s, t, tray = self.ctx, self.gripper, self.settings, self.ctx.settings, self._tray
        seen = view_region(ctx, self._look_at_tray, tray, s)
        if isinstance(seen, Outcome):
            return None, seen
        full = tray.floor + s.pile
        points = lowest_points(seen, s, max(grasp.reach, grasp.top - source.floor))
        if points and points[0][2] > full:
            points = lowest_points(seen, s)
        if not points or points[0][2] > full:
            self._put_back(grasp)
            lowest = f"the lowest place is {1000 * (points[0][2] - tray.floor):.0f} mm up" if points else ""
            room = f"{lowest}, at most {1000 * s.pile:.0f} mm are allowed" if points else "it is too small"
            text = f"full: no room {tray.name}, {room}; what was held lies {source.name} again"
            return None, Outcome(ErrorCode.FAILURE, f"{text} (empty the tray, or a greater `pile`)")
        hang = float(grasp.T_object_tcp.translation[2]) - source.floor + s.gap
        stages: list[Stage] = [
            ChooseReleasePoint(points, hang, gripper, t.near, t.lower_distance),
            Connect("move to tray", gripper.arm_group, t.carry, target="pre_place"),
            AppendPlannedMotion("lower", "after_lower", "lower"),
            ReleaseAboveTray(gripper, t.release_margin, t.release_settle),
            MoveStraight(
                "retreat", gripper.arm_group, gripper.tcp_link, t.free, (0.0, 0.0, t.retreat_distance)
            ),
        ]
        solution, outcome = plan_stages(ctx, stages, f"put {tray.name}")
        if solution is None:
            self._let_go(grasp, outcome)
        return solution, outcome

    def _put(self, solution: PartialSolution, grasp: HeapGrasp) -> Outcome:
        """Let `clear_bin` perform the planned release over the tray.

        An object that hangs lower than assumed touches the tray first and stops the arm: the hand releases it
        there.
        """
        ctx, gripper, t = self.ctx, self.gripper, self.ctx.settings
        outcome = perform_all(ctx, solution.steps)
        reading = ctx.driver.gripper(gripper.name)
        if outcome.code is ErrorCode.CONTROL_FAILED and holds(reading) and self._is_over_tray():
            width = min(reading.width + t.release_margin, gripper.max_width)
            grip = CommandGripper("open", gripper, width, gripper.max_force, t.release_settle)
            outcome = Drop(grip).perform(ctx)
            self._try_straight("retreat", t.retreat_distance, ((HEAP, gripper.hand_links),))
        if outcome.ok:
            self.counts.put += 1
        else:
            self._let_go(grasp, outcome)
        return outcome

    def _is_over_tray(self) -> bool:
        """Return whether the hand of `clear_bin` is over the tray."""
        at = self.ctx.scene().frame_pose(self.gripper.tcp_link).translation[:2].tolist()
        low, high = self._tray.rectangle
        return all(a < x < b for a, x, b in zip(low, at, high, strict=True))

    def _let_go(self, grasp: HeapGrasp, outcome: Outcome) -> None:
        """Let `clear_bin` release an object that did not get into the tray. A canceled task keeps it."""
        ctx, gripper, t = self.ctx, self.gripper, self.ctx.settings
        if outcome.code is not ErrorCode.PREEMPTED:
            self.counts.dropped += not holds(ctx.driver.gripper(gripper.name))
            detach_held(ctx, gripper)
            CommandGripper("open", gripper, grasp.opening, gripper.max_force, t.release_settle).perform(ctx)
            self._has_failed = True

    def _put_back(self, grasp: HeapGrasp) -> None:
        """Let `clear_bin` put a picked object back into the bin: lower it along the path on which it was
        lifted, and release it.
        """
        touching = ((held_object(self.gripper), (HEAP, self.bin)), (HEAP, self.gripper.hand_links))
        self._try_straight("lay back", self.settings.gap - self.settings.lift, touching)
        self.retreat(grasp)


def _given_up(last: str, where: Iterable[str]) -> Outcome:
    return Outcome(ErrorCode.FAILURE, f"given up, {last}; pieces still seen: {', '.join(where)}")


class _PickFromHeap(Pick):
    """Pick of one unknown object from the heap in `clear_bin`. A camera locates the objects.

    The pick ends when the hand has closed on the object; the steps in `lift` follow. After a failure,
    `clear_bin` takes a new image.
    """

    grasp: HeapGrasp  # the chosen grasp, after `plan`
    lift: tuple[Step, ...]  # lift and check, after `plan`

    def __init__(self, clearing: _BinClearing, here: RegionView, any_grasp: bool):
        super().__init__(f"pick {here.region.name}", lambda text: None)
        self._clearing, self._here, self._any_grasp, self.region = clearing, here, any_grasp, here.region

    def plan(self) -> tuple[PartialSolution | None, Outcome]:
        ctx, gripper, s = self._clearing.ctx, self._clearing.gripper, self._clearing.settings
        counts, t = self._clearing.counts, ctx.settings
        # the assumed shape of the held object may reach into a container beside it
        near = HEAP, *self._clearing.containers
        touching = ((held_object(gripper), near), (HEAP, gripper.hand_links))
        text = f"{self._here.count} pieces {self._here.region.name}, the hand fits around none of them"
        solution, outcome = None, Outcome(ErrorCode.PLANNING_FAILED, text)
        for grasps in self._candidates():
            stages = grasp_stages(
                ChooseFromHeap(grasps, gripper, t.near, t.approach_distance), gripper, t,
                CloseOnHeap(gripper, self._here.region.floor, t.grasp_settle, s.thinnest),
                MoveStraight("lift", gripper.arm_group, gripper.tcp_link, t.carry, (0.0, 0.0, s.lift),
                             allow=touching),
                RunSteps("check grasp", (CheckObjectInFingers(gripper),)),
            )  # fmt: skip
            solution, outcome = plan_stages(ctx, stages, self.label)
            if solution is not None:
                break
        if solution is None:
            counts.unplanned += not self._here.is_old
        else:
            self.grasp = solution.data["grasp"]
            counts.picks += 1
            steps = opened_in_transit(ctx.scene(), solution.steps)
            closed = next(k for k, step in enumerate(steps) if isinstance(step, GripUntilForce)) + 1
            self.lift = steps[closed:]
            solution = replace(solution, steps=steps[:closed])
        return solution, outcome

    def _candidates(self) -> Iterator[list[HeapGrasp]]:
        """Yield candidate grasps of the visible objects for the next pick of `clear_bin`, at first with the
        full margin around the hand.

        Candidates with smaller margins follow if no better candidate is reachable, or if the better ones
        resemble failed grasps. If no push helps either, candidates along slanted approaches follow, and then
        candidates that hold only the top of a piece. In an old view, only candidates with the full margin
        count.
        """
        clearing, here = self._clearing, self._here
        s, hand = clearing.settings, hand_of(clearing.ctx.base.model, clearing.gripper)
        failed: list[HeapGrasp] = []
        closest = _closer(s.grasps, 3)
        slanted = (_slanted(s.grasps, tilt) for tilt in s.tilts)
        last = (*slanted, replace(closest, least_grip=0.0)) if self._any_grasp else ()
        closer = () if here.is_old else (_closer(s.grasps, 2), closest, *last)
        for how in (s.grasps, *closer):
            grasps = failed + top_down_grasps(
                here.map, here.labels, here.region.floor, hand, s.force, how, clearing.counts.avoid
            )
            grasps.sort(key=lambda grasp: -grasp.score)
            if grasps and grasps[0].score > 0:
                failed = []
                yield grasps
            else:
                failed = grasps
        if failed and not here.is_old:
            yield failed

    def perform(self, solution: PartialSolution) -> Outcome:
        return perform_all(self._clearing.ctx, solution.steps)

    def recover(self, outcome: Outcome) -> bool:
        clearing = self._clearing
        clearing.counts.missed += 1
        clearing.counts.avoid.append(self.grasp)
        clearing.retreat(self.grasp)
        return False


def _closer(settings: TopDownGraspSettings, times: int) -> TopDownGraspSettings:
    """Return the grasp settings with which `clear_bin` picks flat objects and objects near walls: a smaller
    margin, more orientations, grasps at corners, and grasps of lower edges.
    """
    return replace(
        settings,
        room=settings.room / times,
        turns=times * settings.turns,
        least_touch=settings.least_touch / 2,
        least_hold=settings.least_hold / times,
    )


def _slanted(settings: TopDownGraspSettings, tilt: float) -> TopDownGraspSettings:
    """Return the settings for approaches that lean by `tilt` [rad].

    Along them, the edge of a plate looks like a ridge, from whose slopes the fingers would slip.
    """
    return replace(settings, room=settings.room / 2, least_hold=STEEP, tilt=tilt)
