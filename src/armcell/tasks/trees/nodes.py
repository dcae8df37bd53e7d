"""Behavior tree nodes: recipes and checks, `transfer` with its recovery as a tree, trees as text."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from weakref import WeakKeyDictionary

import numpy as np
from py_trees import display
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector
from py_trees.composites import Sequence as InTurn
from py_trees.decorators import Retry, SuccessIsFailure

from armcell.collision import neighbors
from armcell.core import ErrorCode, Event, Goal, InputError, JointTrajectory, Outcome, StateSample
from armcell.core.checks import require
from armcell.grasping import surface_for
from armcell.model import Gripper
from armcell.tasks.context import TaskContext
from armcell.tasks.pick import back_off, pick
from armcell.tasks.recipes import move_to, place
from armcell.tasks.recovery import Look, RecoverySettings
from armcell.tasks.search import Stage
from armcell.tasks.steps import DONE, perform_all
from armcell.tasks.task import plan_stages

TICK = 0.1  # [s] duration of a tick on the driver's clock
Recipe = Callable[[TaskContext], Outcome]

_at_work: WeakKeyDictionary[TaskContext, Behaviour] = WeakKeyDictionary()
"""Node that currently moves a cell: only one at a time, because all nodes share the cell's clock."""
Vector = tuple[float, float, float]


class Act(Behaviour):
    """Node of a behavior tree that runs a recipe.
    Its status is RUNNING, then SUCCESS, or FAILURE with the reason.

    A tick ends after `tick` seconds of the driver's clock or when the recipe ends; planning takes no time of
    that clock. The recipe has its own thread, which runs only during ticks, so equal seeds give equal runs.
    If the tree switches to another branch, the arm is stopped.

    Attributes:
        outcome: outcome of the last run; None before the first.
    """

    def __init__(self, name: str, ctx: TaskContext, recipe: Recipe, tick: float = TICK):
        super().__init__(name)
        require(tick > 0, f"tick is {tick:g} s, it must be positive")
        self.ctx = ctx
        self.outcome: Outcome | None = None
        self._recipe, self._tick = recipe, tick
        self._turn: _RecipeThread | None = None

    def initialise(self) -> None:
        other = _at_work.get(self.ctx)
        if other is not None:
            raise InputError(
                f"{self.name!r} and {other.name!r} would move the same cell at once",
                hint="several arms at once: cell.side_by_side, as one node",
            )
        _at_work[self.ctx] = self
        self.feedback_message = ""
        self._turn = _RecipeThread(self.ctx, self._recipe)

    def update(self) -> Status:
        assert self._turn is not None
        try:
            outcome = self._turn.step(self._tick)
        except InputError as error:  # for a tree, an input error is a failure like any other
            outcome = Outcome(ErrorCode.FAILURE, str(error))
        if outcome is None:
            self.feedback_message = self._turn.stage
            return Status.RUNNING
        self.outcome, self._turn = outcome, None
        self.feedback_message = "" if outcome.ok else outcome.message or outcome.code.name
        return Status.SUCCESS if outcome.ok else Status.FAILURE

    def terminate(self, new_status: Status) -> None:
        """Clean up when a behavior tree node ends or the tree switches to another branch. If the node's
        recipe (for example a pick) still runs, stop it.
        """
        if self._turn is not None:
            self._turn.stop()
            self._turn = None
        if _at_work.get(self.ctx) is self:
            del _at_work[self.ctx]


class Check(Behaviour):
    """Node of a behavior tree that finishes in one tick, such as a query of the scene or an observation with
    a camera.
    """

    def __init__(self, name: str, ask: Callable[[], Outcome]):
        super().__init__(name)
        self._ask = ask
        self.outcome: Outcome | None = None

    def update(self) -> Status:
        self.outcome = self._ask()
        self.feedback_message = "" if self.outcome.ok else self.outcome.message
        return Status.SUCCESS if self.outcome.ok else Status.FAILURE


class _RecipeThread:
    """Thread that executes the recipe of a behavior tree node (for example a pick). The thread runs only
    during calls of `step`.

    It observes its cell to follow the driver's clock.
    """

    def __init__(self, ctx: TaskContext, recipe: Recipe):
        self.stage = ""  # name of the running stage
        self._ctx, self._recipe = ctx, recipe
        self._go, self._back = threading.Semaphore(0), threading.Semaphore(0)
        self._until = 0.0
        self._outcome: Outcome | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="behaviour tree", daemon=True)
        self._thread.start()
        ctx.observers.append(self)

    def step(self, duration: float) -> Outcome | None:
        """Let the recipe of a behavior tree node (for example a pick) run for a duration [s] on the driver's
        clock.

        Returns:
            The recipe's outcome if it has ended, else None.
        """
        self._until = self._ctx.driver.now + duration
        self._go.release()
        self._back.acquire()
        if self._outcome is None and self._error is None:
            return None
        self._leave()
        if self._error is not None:
            raise self._error
        return self._outcome

    def stop(self) -> None:
        """Cancel the recipe of a behavior tree node, and wait until it has ended."""
        if not self._thread.is_alive():
            return
        cancelled = self._ctx.cancel.is_set()
        self._ctx.cancel.set()
        self._until = float("inf")
        self._go.release()
        self._leave()
        if not cancelled:
            self._ctx.cancel.clear()

    def _leave(self) -> None:
        self._thread.join()
        if self in self._ctx.observers:
            self._ctx.observers.remove(self)

    def _run(self) -> None:
        self._go.acquire()
        try:
            self._outcome = self._recipe(self._ctx)
        except BaseException as error:  # re-raised in the tree's thread
            self._error = error
        self._back.release()

    # --- Observer ---
    def on_state(self, sample: StateSample) -> None:
        if threading.current_thread() is self._thread and sample.time >= self._until:
            self._back.release()
            self._go.acquire()

    def on_event(self, event: Event) -> None:
        if event.kind == "stage" and event.data.get("phase") == "begin":
            self.stage = event.text

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None: ...


def run(root: Behaviour, most_ticks: int = 100_000) -> Outcome:
    """Tick the nodes of a behavior tree until the tree succeeds or fails.

    Returns:
        SUCCESS, FAILURE with the reasons of the failed nodes, or TIMED_OUT. Evidence: `ticks`.
    """
    ticks = 0
    try:
        while ticks < most_ticks:
            root.tick_once()
            ticks += 1
            if root.status is Status.SUCCESS:
                return Outcome(ErrorCode.SUCCESS, "", {"ticks": ticks})
            if root.status is not Status.RUNNING:
                return Outcome(ErrorCode.FAILURE, "; ".join(reasons(root)), {"ticks": ticks})
    finally:
        if root.status is Status.RUNNING:
            root.stop(Status.INVALID)
    return Outcome(ErrorCode.TIMED_OUT, f"still running after {ticks} ticks", {"ticks": ticks})


def drawn(root: Behaviour, status: bool = True) -> str:
    """Draw a behavior tree as text, with the status and feedback of each node."""
    return display.ascii_tree(root, show_status=status).rstrip("\n")


def as_dot(root: Behaviour) -> str:
    """Return the nodes of a behavior tree as a graph in the Graphviz format (for `dot -Tsvg`)."""
    return display.dot_tree(root).to_string()


def reasons(root: Behaviour) -> list[str]:
    """Return the failure messages of all leaf nodes that failed in the last run of a behavior tree."""
    return [
        f"{node.name}: {node.feedback_message}"
        for node in root.iterate()
        if not node.children and node.feedback_message and _failed(node)
    ]


def _failed(node: Behaviour) -> bool:
    outcome = getattr(node, "outcome", None)  # composites with memory reset the status of finished children
    return node.status is Status.FAILURE if outcome is None else not outcome.ok


def picking(ctx: TaskContext, item: str, gripper: Gripper, ahead: Sequence[Stage] = ()) -> Act:
    """Return a behavior tree node that runs the recipe `pick`."""
    return Act(f"pick {item}", ctx, lambda c: pick(c, item, gripper, ahead=ahead))


def placing(
    ctx: TaskContext, item: str, on: str, at: tuple[float, float] | None = None, up: Vector | None = None
) -> Act:
    """Return a behavior tree node that runs the recipe `place`."""
    return Act(f"place {item} on {on}", ctx, lambda c: place(c, item, on, at, up))


def moving_to(ctx: TaskContext, group: str, goal: Goal | str) -> Act:
    """Return a behavior tree node that runs the recipe `move_to`."""
    name = goal if isinstance(goal, str) else type(goal).__name__
    return Act(f"move to {name}", ctx, lambda c: move_to(c, group, goal))


def performing(ctx: TaskContext, name: str, stages: Callable[[TaskContext], Sequence[Stage]]) -> Act:
    """Return a behavior tree node that creates, plans and executes
    the stages of a recipe when the tree reaches it.
    """

    def act(c: TaskContext) -> Outcome:
        solution, outcome = plan_stages(c, stages(c), name)
        return outcome if solution is None else perform_all(c, solution.steps)

    return Act(name, ctx, act)


def looking(name: str, look: Look) -> Check:
    """Return a behavior tree node that takes a camera image to check the scene before the tree continues.

    Example: `looking("look", lambda: cell.look("above"))`.
    """
    return Check(name, look)


def held_node(ctx: TaskContext, item: str) -> Check:
    """Return a behavior tree node that checks whether an object is held. Both the task and the gripper's
    sensors must report the object as held.
    """

    def ask() -> Outcome:
        holding = ctx.holding.get(item)
        if holding is not None and ctx.driver.gripper(holding.gripper.name).held == item:
            return DONE
        return Outcome(ErrorCode.FAILURE, f"no hand holds {item}")

    return Check(f"{item} held?", ask)


def rests_on(
    ctx: TaskContext, item: str, on: str, at: tuple[float, float] | None = None, tolerance: float = 0.015
) -> Check:
    """Return a behavior tree node that checks whether an object rests on another object,
    optionally near a given point [m].
    """

    def ask() -> Outcome:
        scene = ctx.scene()
        if item in ctx.holding or item not in scene.objects:
            return Outcome(ErrorCode.FAILURE, f"{item} is {'held' if item in ctx.holding else 'not seen'}")
        if on not in neighbors(scene, item):
            return Outcome(ErrorCode.FAILURE, f"{item} does not stand on {on}")
        if at is not None:
            frame = surface_for(scene.object(item), scene.object(on))[0]
            where = frame.inverse().apply(scene.object(item).T_world_object.translation)[:2]
            away = float(np.linalg.norm(where - np.asarray(at)))
            if away > tolerance:
                return Outcome(ErrorCode.FAILURE, f"{item} is {away * 1000:.0f} mm from its place on {on}")
        return DONE

    return Check(f"{item} on {on}?", ask)


def transferring(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None = None,
    up: Vector | None = None, look: Look | None = None, settings: RecoverySettings = RecoverySettings(),
) -> Behaviour:  # fmt: skip
    """Return a behavior tree that moves an object to its goal by picking and placing, and recovers from
    failures as `transfer` does.

    The tree makes up to `settings.tries` attempts. Between attempts objects come to rest and the open hand
    retreats.
    """
    fetch: Behaviour = picking(ctx, item, gripper)
    if look is not None:
        fetch = InTurn(f"find and pick {item}", memory=True, children=[looking("look", look), fetch])
    in_hand = Selector(f"get {item}", memory=True, children=[held_node(ctx, item), fetch])
    there = rests_on(ctx, item, on, at, settings.tolerance)
    way = InTurn(
        f"bring {item}", memory=True,
        children=[in_hand, placing(ctx, item, on, at, up), rests_on(ctx, item, on, at, settings.tolerance)],
    )  # fmt: skip

    def rest(c: TaskContext) -> Outcome:
        c.advance(settings.settle)
        if item not in c.holding and item in c.scene().objects:
            back_off(c, item, gripper)
        return DONE

    again = SuccessIsFailure("and again", Act("come to rest", ctx, rest))
    return Retry(
        f"{settings.tries} times", Selector(f"{item} to {on}", memory=True, children=[there, way, again]),
        settings.tries,
    )  # fmt: skip
