"""Who may move when: motions that are under way, zones that are reserved, and who makes way for whom.

The rule that keeps arms apart: a motion begins only when it is proven, with the times, to keep off what the
other arm does and off where the other comes to rest; and so does the rest at its own end. Then standing
still is always safe, for both. What is left are arms that wait for each other: the one that began to wait
later goes home, which is out of the other's way, and comes back when the other has its motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from armcell.collision.arms import Arms
from armcell.control import execute
from armcell.core import (
    ErrorCode,
    InputError,
    JointGoal,
    JointState,
    JointTrajectory,
    Outcome,
    PlanRequest,
    PlanResult,
)
from armcell.planning import RunningMotion, plan_beside
from armcell.scene import PlanningScene

if TYPE_CHECKING:
    from armcell.tasks.arms.context import ArmContext
    from armcell.tasks.steps import Motion

LOOK = 0.1  # [s] between two looks of an arm that waits for its way
IDLE = 0.02  # [s] between two of one that waits for a zone or the other arm
AWAY = 0.005  # [rad] from a motion's start beyond which an arm goes back there first
HOME = "home"


class Traffic:
    """What two arms that work side by side know of each other. One program runs at a time: no locks."""

    def __init__(self, groups: tuple[str, str], clearance: float, patience: float):
        self.groups, self.clearance, self.patience = groups, clearance, patience
        self.contexts: dict[str, ArmContext] = {}
        self.running: dict[str, RunningMotion] = {}
        self.waits: dict[str, tuple[float, str]] = {}  # since when [s], and for what: "way", or a zone
        self.asked: set[str] = set()  # to go home, by the other
        self.zones: dict[str, list[str]] = {}  # who has it, then who wants it
        self.waited: dict[str, float] = dict.fromkeys(groups, 0.0)  # [s] in total
        self.made_way: dict[str, int] = dict.fromkeys(groups, 0)
        self.searched: dict[str, int] = dict.fromkeys(groups, 0)  # motions found in space and time
        self._met: dict[str, set[str]] = {}
        self._heading: dict[str, str] = {}  # the zone that an arm has chosen to go to

    def other(self, group: str) -> str:
        return self.groups[1] if group == self.groups[0] else self.groups[0]

    # --- the way ---
    def clear(self, ctx: ArmContext, motion: Motion) -> JointTrajectory | Outcome:
        """The motion as it may begin now (perhaps another way, or later); waits until it may."""
        me, straight = ctx.group, motion.planner == "cartesian"
        began = ctx.driver.now
        while not ctx.cancel.is_set():
            found = self._try(ctx, motion.trajectory, straight, motion)
            if found is not None:
                self._go_on(me)
                return found
            if ctx.driver.now - began > self.patience:
                self._go_on(me)
                return self._gave_up(ctx, motion)
            self.waits.setdefault(me, (ctx.driver.now, "way"))
            self._settle(ctx)
            ctx.advance(LOOK)
            self.waited[me] += LOOK
        self._go_on(me)
        return Outcome(ErrorCode.PREEMPTED, "cancelled")

    def _go_on(self, group: str) -> None:
        self.waits.pop(group, None)
        self.asked.discard(self.other(group))

    def _try(self, ctx: ArmContext, wanted: JointTrajectory, straight: bool, motion: Motion):
        now, scene, me = ctx.driver.now, ctx.whole_scene(), ctx.group
        other = self.running[self.other(me)]
        q = scene.state.reindexed(wanted.joint_names).positions
        if np.max(np.abs(q - wanted.positions[0])) > AWAY:  # it made way: back to where the motion begins
            if self._behind(me):
                return None
            back = self._plan(ctx, scene, wanted.positions[0])
            if back is None or not self.perform(ctx, back, f"{me} comes back"):
                return None
            now, scene, other = ctx.driver.now, ctx.whole_scene(), self.running[self.other(me)]
        arms = Arms(scene, (me, self.other(me)))
        if self._free(ctx, arms, scene, wanted, other, now):
            self.running[me] = RunningMotion(wanted, now)
            return wanted
        if straight or self._behind(me):
            return None
        if not ctx.driver.is_simulated and other.trajectory.duration > 0:
            return None  # a way round it in time would need the other to keep time
        found = self._plan(ctx, scene, wanted.positions[-1], motion)
        if found is not None:
            self.searched[me] += 1
            self.running[me] = RunningMotion(found, now)
        return found

    def _free(self, ctx, arms: Arms, scene: PlanningScene, wanted, other: RunningMotion, now: float) -> bool:
        """Whether a motion may begin. Simulated arms keep time, and are proven with the times. Real ones may
        be slowed by a slider or a pause, and go on while this is looked at: they are proven for any time.
        """
        room = self._room(arms, scene, wanted)
        if not ctx.driver.is_simulated:
            return arms.certify_any_time(wanted, other.trajectory, room)
        return arms.certify(
            wanted, other.trajectory, (now, other.start), room, begin=now,
            until=max(now + wanted.duration, other.end), evidence=False,
        ).free  # fmt: skip

    def _room(self, arms: Arms, scene: PlanningScene, wanted: JointTrajectory) -> float:
        """The clearance, or a little less than there is where the arms stand nearer than that."""
        q = scene.state.reindexed(arms.joint_names).positions
        if arms.apart(q[None], None, self.clearance) < 0:
            return self.clearance
        near = arms.contact(q)
        return self.clearance if near is None else max(min(self.clearance, near.distance - 2e-3), 0.0)

    def _plan(self, ctx: ArmContext, scene: PlanningScene, q, motion: Motion | None = None):
        speed = ctx.settings.carry if ctx.holding else ctx.settings.free
        names = scene.model.group(ctx.group).joint_names
        request = PlanRequest(
            ctx.group, (JointGoal(JointState(names, q)),), planner_id=ctx.settings.planner_id,
            planning_time=ctx.settings.planning_time, velocity_scaling=speed.velocity,
            acceleration_scaling=speed.acceleration, seed=ctx.seed,
        )  # fmt: skip
        running = self.running[self.other(ctx.group)]
        result: PlanResult = plan_beside(
            scene, request, self.other(ctx.group), running, ctx.driver.now, self.clearance, ctx.cancel
        )
        found = result.trajectory if result.ok else None
        if found is None or ctx.driver.is_simulated:
            return found
        arms = Arms(scene, (ctx.group, self.other(ctx.group)))
        return found if self._free(ctx, arms, scene, found, running, ctx.driver.now) else None

    def perform(self, ctx: ArmContext, trajectory: JointTrajectory, name: str) -> bool:
        """A motion of the traffic's own (making way, coming back), begun now."""
        self.running[ctx.group] = RunningMotion(trajectory, ctx.driver.now)
        ctx.announce(trajectory, name, planner=ctx.settings.planner_id, evidence={"seed": ctx.seed})
        motion = ctx.gate.motion(trajectory, cancel=ctx.cancel)
        done = execute(ctx.driver, motion, ctx.settings.execution, ctx.progress)
        self.rest(ctx)
        return done.ok

    def rest(self, ctx: ArmContext) -> None:
        """An arm has come to rest, wherever that is."""
        self.running[ctx.group] = RunningMotion.standing(ctx.whole_scene(), ctx.group, ctx.driver.now)

    # --- waiting for each other ---
    def _rests(self, ctx: ArmContext, group: str) -> bool:
        running = self.running[group]
        if ctx.driver.is_simulated:
            return running.end <= ctx.driver.now
        return running.trajectory.duration == 0.0  # a real one rests when it has said so

    def _behind(self, me: str) -> bool:
        """Whether the other waits for its way as well and began to earlier: it goes first."""
        mine, theirs = self.waits.get(me), self.waits.get(self.other(me))
        if mine is None or theirs is None or theirs[1] != "way":
            return False
        return (theirs[0], self.groups.index(self.other(me))) < (mine[0], self.groups.index(me))

    def _settle(self, ctx: ArmContext) -> None:
        """Make way for an arm that goes first, or ask one that stands about to do so."""
        me, other = ctx.group, self.other(ctx.group)
        if self._behind(me) or me in self.asked:
            self.make_way(ctx)
        elif other in self.waits and self._rests(ctx, other):
            self.asked.add(other)

    def make_way(self, ctx: ArmContext) -> None:
        """Go home, if it can and is not there."""
        self.asked.discard(ctx.group)
        scene = ctx.whole_scene()
        home = scene.model.named_state(ctx.group, HOME)
        if np.max(np.abs(scene.state.reindexed(home.joint_names).positions - home.positions)) < AWAY:
            return
        names = scene.model.group(ctx.group).joint_names
        way = self._plan(ctx, scene, home.reindexed(names).positions)
        if way is not None:
            ctx.emit("note", f"{ctx.group} makes way")
            self.made_way[ctx.group] += 1
            self.perform(ctx, way, f"{ctx.group} makes way")

    def _gave_up(self, ctx: ArmContext, motion: Motion) -> Outcome:
        scene = ctx.whole_scene()
        arms, running = Arms(scene, (ctx.group, self.other(ctx.group))), self.running[self.other(ctx.group)]
        proof = arms.certify(
            motion.trajectory, running.trajectory, (ctx.driver.now, running.start), self.clearance,
            begin=ctx.driver.now,
        )  # fmt: skip
        pair = "" if proof.contact is None else f": {proof.contact.body_a} and {proof.contact.body_b}"
        other = self.other(ctx.group)
        text = f"{motion.name}: waited {self.patience:.0f} s for {other} to be out of the way{pair}"
        return Outcome(ErrorCode.TIMED_OUT, text, {"contact": proof.contact})

    # --- zones and meetings ---
    def choose(self, group: str, items: Sequence[str], zone: Callable[[str], str]) -> str:
        """The first item whose zone the other arm neither has, waits for nor is heading for; else the first.

        Args:
            items: what is left to do, not empty.
            zone: where each is to go.
        """
        other = self.other(group)
        busy = {name for name, queue in self.zones.items() if other in queue} | {self._heading.get(other)}
        item = next((i for i in items if zone(i) not in busy), items[0])
        self._heading[group] = zone(item)
        return item

    @contextmanager
    def reserved(self, ctx: ArmContext, zone: str) -> Iterator[None]:
        """A zone for one arm at a time, in the order they asked.

        Raises:
            InputError: the arm has a zone already (two arms with one zone each could wait for ever).
        """
        for name, queue in self.zones.items():
            if queue and queue[0] == ctx.group:
                raise InputError(
                    f"{ctx.group} has zone {name!r} and asks for {zone!r}", cure="leave it first"
                )
        queue = self.zones.setdefault(zone, [])
        queue.append(ctx.group)
        try:
            while queue[0] != ctx.group and not ctx.cancel.is_set():
                self.waits.setdefault(ctx.group, (ctx.driver.now, zone))
                self._idle(ctx)
                self.waited[ctx.group] += IDLE
            self.waits.pop(ctx.group, None)
            yield
        finally:
            queue.remove(ctx.group)
            self._heading.pop(ctx.group, None)

    def meet(self, ctx: ArmContext, name: str) -> None:
        """Wait until the other arm gets to the same point of its program, or has ended it."""
        here = self._met.setdefault(name, set())
        here.add(ctx.group)
        other = self.other(ctx.group)
        while other not in here and not self.contexts[other].ended and not ctx.cancel.is_set():
            self.waits.setdefault(ctx.group, (ctx.driver.now, name))
            self._idle(ctx)
        self.waits.pop(ctx.group, None)

    def park(self, ctx: ArmContext) -> None:
        """After an arm's program: stay and make way for the other until it has ended as well."""
        ctx.ended = True
        while not self.contexts[self.other(ctx.group)].ended and not ctx.cancel.is_set():
            self.waits.setdefault(ctx.group, (ctx.driver.now, "the end"))
            self._idle(ctx)

    def _idle(self, ctx: ArmContext) -> None:
        if ctx.group in self.asked:
            self.make_way(ctx)
        ctx.advance(IDLE)


__all__ = ["Traffic"]
