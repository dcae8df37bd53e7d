"""Coordination of arms that work side by side: when an arm may start to move, zones, views and yielding.

A motion starts only when it is certified, with its timing, against the motions and final poses of the other
arms, and when its own final pose is clear of their motions. A resting arm is therefore always safe. If arms
wait for each other, those that started to wait later go home and return when the first one has moved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager

import numpy as np
from numpy.typing import NDArray

from armcell.collision.inter_arm_checker import (
    InterArmChecker,
    arms_in_hull,
    moved_links,
    without_arms,
)
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
from armcell.drivers import Driver
from armcell.execution import execute
from armcell.planning import RunningMotion, plan_around_moving_arms
from armcell.scene import PlanningScene
from armcell.tasks.context import HeldObject, TaskContext
from armcell.tasks.steps import Motion

CLEARANCE = 0.02  # [m] between the arms
LEEWAY = 0.005  # [m] by which arms at rest beside each other may come closer when they move apart
PATIENCE = 30.0  # [s] of the driver's clock that an arm waits until its motion may start
RETRY = 0.1  # [s] between attempts of an arm that waits to move
IDLE = 0.02  # [s] between checks of an arm that waits for a zone or another arm
AWAY = 0.005  # [rad] an arm that has yielded further than this from its motion's start returns there first
HOME = "home"
MOTION = "motion"


class ArmContext(TaskContext):
    """Task context of one of several arms that work side by side."""

    def __init__(self, parent: TaskContext, group: str, driver: Driver, coordinator: MotionCoordinator):
        super().__init__(driver, parent.base, parent.settings, parent.observers, parent.seed, parent.cancel)
        self.parent, self.group, self.coordinator, self.ended = parent, group, coordinator, False
        self.events, self.world = parent.events, parent.world
        self.gate, self.lost = parent.gate, parent.lost
        coordinator.contexts[group] = self
        arm = {g.name for g in parent.base.model.grippers.values() if g.arm_group == group}
        self.holding = {n: h for n, h in parent.holding.items() if h.gripper.name in arm}

    def hands(self) -> Iterable[HeldObject]:
        return self.parent.hands()

    def scene(self) -> PlanningScene:
        return without_arms(self.whole_scene(), *self.coordinator.others(self.group))

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        self.parent.expect_contact(body, others, expected)

    def observe(self) -> None:
        self.parent.observe()

    def request_start(self, motion: Motion) -> JointTrajectory | Outcome:
        return self.coordinator.request_start(self, motion)

    def reserve(self, zone: str) -> AbstractContextManager[None]:
        return self.coordinator.reserved(self, zone)

    def choose(self, items: Sequence[str], zone: Callable[[str], str]) -> str:
        return self.coordinator.choose(self.group, items, zone)

    def await_view(self, corners: NDArray[np.float64]) -> bool:
        return self.coordinator.await_view(self, corners)

    def is_hidden(self, corners: NDArray[np.float64]) -> bool:
        return bool(arms_in_hull(self.whole_scene(), corners, self.coordinator.others(self.group)))

    def rendezvous(self, name: str) -> None:
        self.coordinator.rendezvous(self, name)

    def rested(self) -> None:
        self.coordinator.rest(self)


class MotionCoordinator:
    """Coordinator of the motions of arms that work side by side: it decides when an arm may start to
    move, reserves zones and lets one arm yield to another.

    Only one of the arms' programs runs at a time, so the state needs no locks.
    """

    def __init__(self, groups: tuple[str, ...], clearance: float, patience: float):
        self.groups, self.clearance, self.patience = groups, clearance, patience
        self.contexts: dict[str, ArmContext] = {}
        self.running: dict[str, RunningMotion] = {}
        self.waits: dict[
            str, tuple[float, str]
        ] = {}  # start of the wait [s], and its subject: MOTION or a zone
        self.blockers: dict[str, tuple[str, ...]] = {}  # by arm that waits to move: the arms in its way
        self.asked: dict[str, set[str]] = {group: set() for group in groups}  # to go home, by which arms
        self.zones: dict[str, list[str]] = {}  # the holder, then the queue
        self.waited: dict[str, float] = dict.fromkeys(groups, 0.0)  # [s] in total
        self.yielded: dict[str, int] = dict.fromkeys(groups, 0)
        self.searched: dict[str, int] = dict.fromkeys(groups, 0)  # motions found in space and time
        self._arrived: dict[str, set[str]] = {}
        self._heading: dict[str, str] = {}  # the zone that an arm approaches
        self._away: set[str] = set()  # arms that have yielded since their last motion

    def others(self, group: str) -> tuple[str, ...]:
        return tuple(other for other in self.groups if other != group)

    def _running_besides(self, group: str) -> dict[str, RunningMotion]:
        return {other: self.running[other] for other in self.others(group)}

    # --- motions ---
    def request_start(self, ctx: ArmContext, motion: Motion) -> JointTrajectory | Outcome:
        """Wait until an arm that works side by side with others may start the requested motion or a detour to
        the same goal. Return the allowed motion, or the failure if the wait times out or is canceled.
        """
        me, straight = ctx.group, motion.planner == "cartesian" or motion.exact
        began = ctx.driver.now
        while not ctx.cancel.is_set():
            found = self._try(ctx, motion.trajectory, straight, motion)
            if found is not None:
                self._stop_waiting(me)
                self._away.discard(me)
                return found
            if ctx.driver.now - began > self.patience:
                blockers = self.blockers.get(me, ())
                self._stop_waiting(me)
                return self._timed_out(ctx, motion, blockers)
            self.waits.setdefault(me, (ctx.driver.now, MOTION))
            self._resolve_wait(ctx)
            ctx.advance(RETRY)
            self.waited[me] += RETRY
        self._stop_waiting(me)
        return Outcome(ErrorCode.PREEMPTED, "cancelled")

    def _stop_waiting(self, group: str) -> None:
        self.waits.pop(group, None)
        self.blockers.pop(group, None)
        for askers in self.asked.values():
            askers.discard(group)

    def _try(self, ctx: ArmContext, wanted: JointTrajectory, straight: bool, motion: Motion):
        now, scene, me = ctx.driver.now, ctx.whole_scene(), ctx.group
        others = self._running_besides(me)
        q = scene.state.reindexed(wanted.joint_names).positions
        if me in self._away and np.max(np.abs(q - wanted.positions[0])) > AWAY:
            # return to the motion's start; a contact at the start may shift an arm that has not yielded
            if self._has_lower_priority(me):
                return None
            back = self._plan(ctx, scene, wanted.positions[0])
            if back is None or not self.perform(ctx, back, f"{me} returns"):
                return None
            self._away.discard(me)
            now, scene, others = ctx.driver.now, ctx.whole_scene(), self._running_besides(me)
        if self._free(ctx, scene, wanted, others, now):
            self.running[me] = RunningMotion(wanted, now)
            return wanted
        self.blockers[me] = self._in_the_way(ctx, scene, wanted, others, now)
        if straight or self._has_lower_priority(me):
            return None
        if not ctx.driver.is_simulated and any(o.trajectory.duration > 0 for o in others.values()):
            return None  # a detour in time relies on the timing of the other arms
        found = self._plan(ctx, scene, wanted.positions[-1], motion)
        if found is not None:
            self.searched[me] += 1
            self.running[me] = RunningMotion(found, now)
        return found

    def _free(
        self, ctx: ArmContext, scene: PlanningScene, wanted: JointTrajectory,
        others: Mapping[str, RunningMotion], now: float,
    ) -> bool:  # fmt: skip
        """Return whether an arm that works side by side with others may start a motion while other arms are
        nearby, either moving or at rest.

        Simulated arms keep their timing and are certified with it. Real arms may be slowed by a slider or a
        pause and move during this check, so each pair of them is certified for any timing.
        """
        if not ctx.driver.is_simulated:
            pairs = [(InterArmChecker(scene, (ctx.group, name)), other) for name, other in others.items()]
            return all(
                arms.certify_any_time(wanted, other.trajectory, self._clearance_now(arms, scene))
                for arms, other in pairs
            )
        arms = InterArmChecker(scene, (ctx.group, *others), ctx.group)
        return arms.certify(
            wanted, *(other.trajectory for other in others.values()),
            starts=(now, *(other.start for other in others.values())),
            clearance=self._clearance_now(arms, scene), begin=now,
            until=max(now + wanted.duration, *(other.end for other in others.values())), evidence=False,
        ).free  # fmt: skip

    def _in_the_way(
        self, ctx: ArmContext, scene: PlanningScene, wanted: JointTrajectory,
        others: Mapping[str, RunningMotion], now: float,
    ) -> tuple[str, ...]:  # fmt: skip
        """Return which of the arms that work side by side keep an arm from starting its motion, by their
        motions or poses.
        """
        if len(others) == 1:
            return tuple(others)
        return tuple(n for n in others if not self._free(ctx, scene, wanted, {n: others[n]}, now))

    def _clearance_now(self, arms: InterArmChecker, scene: PlanningScene) -> float:
        """Return the clearance that the coordinator requires between arms side by side. If the arms are
        already closer or nearly as close, return slightly less than their present distance, so that they can
        move apart.
        """
        q = scene.state.reindexed(arms.joint_names).positions
        if arms.find_too_close(q[None], None, self.clearance + LEEWAY) < 0:
            return self.clearance
        near = arms.contact(q)
        return self.clearance if near is None else max(min(self.clearance, near.distance - LEEWAY), 0.0)

    def _plan(self, ctx: ArmContext, scene: PlanningScene, q, motion: Motion | None = None):
        links = moved_links(scene.model, ctx.group)
        carries = any(body.link in links for body in scene.attached.values())
        speed = ctx.settings.carry if carries else ctx.settings.free
        names = scene.model.group(ctx.group).joint_names
        request = PlanRequest(
            ctx.group, (JointGoal(JointState(names, q)),), planner_id=ctx.settings.planner_id,
            planning_time=ctx.settings.planning_time, velocity_scaling=speed.velocity,
            acceleration_scaling=speed.acceleration, seed=ctx.seed,
        )  # fmt: skip
        others = self._running_besides(ctx.group)
        clearance = self._clearance_now(InterArmChecker(scene, (ctx.group, *others), ctx.group), scene)
        result: PlanResult = plan_around_moving_arms(
            scene, request, others, ctx.driver.now, clearance, ctx.cancel
        )
        found = result.trajectory if result.ok else None
        if found is None or ctx.driver.is_simulated:
            return found
        return found if self._free(ctx, scene, found, others, ctx.driver.now) else None

    def perform(self, ctx: ArmContext, trajectory: JointTrajectory, name: str) -> bool:
        """Execute a motion that makes room for another arm: one of several arms side by side clears the
        other arm's path, or returns afterwards to the start of its requested motion.
        """
        self.running[ctx.group] = RunningMotion(trajectory, ctx.driver.now)
        ctx.announce(trajectory, name, planner=ctx.settings.planner_id, evidence={"seed": ctx.seed})
        motion = ctx.gate.motion(trajectory, cancel=ctx.cancel)
        done = execute(ctx.driver, motion, ctx.settings.execution, ctx.progress)
        self.rest(ctx)
        return done.ok

    def rest(self, ctx: ArmContext) -> None:
        """Record in the coordinator of arms that work side by side that one of these arms has come
        to rest.
        """
        self.running[ctx.group] = RunningMotion.at_rest(ctx.whole_scene(), ctx.group, ctx.driver.now)

    # --- waiting for each other ---
    def _rests(self, ctx: ArmContext, group: str) -> bool:
        running = self.running[group]
        if ctx.driver.is_simulated:
            return running.end <= ctx.driver.now
        return running.trajectory.duration == 0.0  # a real arm rests when its driver reports it

    def _has_lower_priority(self, me: str) -> bool:
        """Return whether, of two arms that work side by side, this arm must let the other one move first: the
        other arm has waited longer to start its motion, and this arm blocks that motion.
        """
        mine = self.waits.get(me)
        return mine is not None and any(
            (self.waits[other][0], self.groups.index(other)) < (mine[0], self.groups.index(me))
            for other in self.others(me)
            if other in self.waits and self.waits[other][1] == MOTION and me in self.blockers.get(other, ())
        )

    def _resolve_wait(self, ctx: ArmContext) -> None:
        """Resolve a deadlock of arms that work side by side. If another arm has priority or has asked this
        arm to yield, this arm yields. Otherwise, it asks the resting arms that block its motion to yield.
        """
        me = ctx.group
        if self._has_lower_priority(me) or self.asked[me]:
            self.yield_to_others(ctx)
            return
        for other in self.blockers.get(me, ()):
            if other in self.waits and self._rests(ctx, other):
                self.asked[other].add(me)

    def yield_to_others(self, ctx: ArmContext) -> None:
        """Make an arm yield to the arms that work side by side with it: move it to its home state, if
        possible.

        An arm that is already there does not move. If the arms that asked leave no path home, they yield.
        """
        askers = set(self.asked[ctx.group])
        self.asked[ctx.group].clear()
        scene = ctx.whole_scene()
        home = scene.model.named_state(ctx.group, HOME)
        if np.max(np.abs(scene.state.reindexed(home.joint_names).positions - home.positions)) < AWAY:
            return
        names = scene.model.group(ctx.group).joint_names
        motion = self._plan(ctx, scene, home.reindexed(names).positions)
        if motion is not None:
            ctx.emit("note", f"{ctx.group} yields")
            self.yielded[ctx.group] += 1
            self._away.add(ctx.group)
            self.perform(ctx, motion, f"{ctx.group} yields")
        else:
            for asker in askers:
                self.asked[asker].add(ctx.group)

    def _timed_out(self, ctx: ArmContext, motion: Motion, blockers: tuple[str, ...]) -> Outcome:
        scene, others = ctx.whole_scene(), self._running_besides(ctx.group)
        proof = InterArmChecker(scene, (ctx.group, *others), ctx.group).certify(
            motion.trajectory, *(other.trajectory for other in others.values()),
            starts=(ctx.driver.now, *(other.start for other in others.values())),
            clearance=self.clearance, begin=ctx.driver.now,
        )  # fmt: skip
        pair = "" if proof.contact is None else f": {proof.contact.body_a} and {proof.contact.body_b}"
        who = " and ".join(blockers or tuple(others))
        text = f"{motion.name}: waited {self.patience:.0f} s for {who} to clear the path{pair}"
        return Outcome(ErrorCode.TIMED_OUT, text, {"contact": proof.contact})

    # --- zones and rendezvous ---
    def choose(self, group: str, items: Sequence[str], zone: Callable[[str], str]) -> str:
        """Return the first remaining item whose destination zone is free: no other of the arms that work side
        by side uses the zone, waits for it or is heading there.

        If all zones are busy, return the first of all items. In both cases, the coordinator records that the
        arm approaches the zone of the returned item.

        Args:
            items: the remaining items, not empty.
            zone: the destination of each item.
        """
        others = self.others(group)
        busy = {name for name, queue in self.zones.items() if any(other in queue for other in others)}
        busy |= {self._heading.get(other) for other in others}
        item = next((i for i in items if zone(i) not in busy), items[0])
        self._heading[group] = zone(item)
        return item

    @contextmanager
    def reserved(self, ctx: ArmContext, zone: str) -> Iterator[None]:
        """Reserve a zone for one of the arms that work side by side. Arms receive the zone in the order of
        their requests.

        Raises:
            InputError: the arm already holds a zone (arms with a zone each could wait forever).
        """
        for name, queue in self.zones.items():
            if queue and queue[0] == ctx.group:
                raise InputError(
                    f"{ctx.group} holds zone {name!r} and asks for {zone!r}", hint="leave it first"
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

    def await_view(self, ctx: ArmContext, corners: NDArray[np.float64]) -> bool:
        """Wait until no other of the arms that work side by side hides a region from a camera, and return
        whether that took time. A resting arm that hides the region moves to its home state.

        After `patience`, the wait ends although an arm still hides the region.

        Args:
            corners: (k, 3) points [m, world frame] whose convex hull contains the view: camera and region.
        """
        began, me = ctx.driver.now, ctx.group
        while not ctx.cancel.is_set() and ctx.driver.now - began < self.patience:
            hiding = arms_in_hull(ctx.whole_scene(), corners, self.others(me))
            if not hiding:
                break
            self.waits.setdefault(me, (ctx.driver.now, "a view"))
            for other in hiding:
                if other in self.waits and self._rests(ctx, other):
                    self.asked[other].add(me)
            self._idle(ctx)
            self.waited[me] += IDLE
        self._stop_waiting(me)
        return began < ctx.driver.now < began + self.patience

    def rendezvous(self, ctx: ArmContext, name: str) -> None:
        """Pause the program of an arm that works side by side with others until all of them have reached the
        same rendezvous or their programs have ended.
        """
        here = self._arrived.setdefault(name, set())
        here.add(ctx.group)
        while not ctx.cancel.is_set() and any(
            other not in here and not self.contexts[other].ended for other in self.others(ctx.group)
        ):
            self.waits.setdefault(ctx.group, (ctx.driver.now, name))
            self._idle(ctx)
        self.waits.pop(ctx.group, None)

    def park(self, ctx: ArmContext) -> None:
        """Keep an arm at rest after its program has ended, until the programs of all arms side by side have
        ended. If another arm needs the space, the resting arm moves to its home state.
        """
        ctx.ended = True
        while not ctx.cancel.is_set() and not all(
            self.contexts[other].ended for other in self.others(ctx.group)
        ):
            self.waits.setdefault(ctx.group, (ctx.driver.now, "the end"))
            self._idle(ctx)

    def _idle(self, ctx: ArmContext) -> None:
        if self.asked[ctx.group]:
            self.yield_to_others(ctx)
        ctx.advance(IDLE)
