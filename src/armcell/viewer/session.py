"""`PlanningSession`: what the planning panel does, without a browser: goal, settings, plan, execute."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.cell import LiveCell
from armcell.core import (
    SE3,
    CartesianRequest,
    ErrorCode,
    Explanation,
    Goal,
    InputError,
    JointGoal,
    JointState,
    NamedGoal,
    Observer,
    Outcome,
    PlanRequest,
    PlanResult,
    PoseGoal,
    Suggestion,
)
from armcell.planning import plan, plan_cartesian
from armcell.planning.explanation import explain_misuse
from armcell.scene import PlanningScene
from armcell.tasks import Motion, perform_all
from armcell.viewer.job import Job, Jobs
from armcell.viewer.session_goal import (
    FREE,
    LINE,
    UPRIGHT,
    GoalView,
    PlanSettings,
    judged,
    keep_upright,
    posed,
    random_positions,
)

Array = NDArray[np.float64]
Connect = Callable[[PlanningScene, Sequence[Observer]], LiveCell]
logger = logging.getLogger(__name__)

EXPLAIN_S = 10.0  # [s] about the most that finding out what would help may take
START_TOLERANCE = 0.01  # [rad or m], the executor's
CLOSE_S = 5.0


class PlanningSession:
    """One person's planning in one scene. Thread-safe; long work runs in a thread of its own.

    Attributes are values that are replaced, never changed: read them at any time. Whoever wants to know of
    changes gives a function to `listen`; it is called with "goal", "scene", "settings" or "result", from
    whichever thread made the change.

    Attributes:
        scene: the world and the robot where it is now.
        start: positions (dof,) a plan begins at; None where the robot is.
        goal: where it shall go, and whether it can stand there.
        settings: planner, times, speeds, kind of motion.
        result, explanation: of the last plan; the explanation comes a while after the result that failed.
        outcome: of the last execution.
        message: what was last done or went wrong, in words.
        observers: of the live cell; to be set before the first execution.

    Args:
        connect: makes a live cell of a scene with observers, for `execute`; without it plans are only
            looked at.
        seed: of planners and random states.
    """

    def __init__(self, scene: PlanningScene, connect: Connect | None = None, seed: int = 0):
        self.scene = scene
        self.start: Array | None = None
        self.settings = PlanSettings()
        self.result: PlanResult | None = None
        self.explanation: Explanation | None = None
        self.outcome: Outcome | None = None
        self.message = ""
        self.observers: list[Observer] = []
        self.group = _first_group(scene)
        self._seed, self._rng = seed, np.random.default_rng(seed)
        self._connect, self._live = connect, None
        self._listeners: list[Callable[[str], None]] = []
        self._lock = threading.RLock()
        self._jobs = Jobs(self._lock, self._failed, lambda: self._tell("result"))
        self._given: PlanRequest | CartesianRequest | None = None  # a suggestion's, until something is set
        self._edits = 0  # of the world, by the user
        self._planned_with = self._live_with = -1  # `_edits` at the last plan, and when connected
        self.goal: GoalView = judged(scene, self.group, scene.positions, scene.positions)

    # --- who listens ---
    def listen(self, listener: Callable[[str], None]) -> None:
        self._listeners.append(listener)

    def _tell(self, *topics: str) -> None:
        for topic in topics:
            for listener in self._listeners:
                try:
                    listener(topic)
                except Exception:  # a view that fails must not end the work it shows
                    logger.exception("a listener of the planning session failed")

    def say(self, text: str) -> None:
        """Set `message`."""
        self.message = text
        self._tell("result")

    # --- what to plan ---
    @property
    def groups(self) -> tuple[str, ...]:
        """Planning groups with joints."""
        return tuple(g.name for g in self.scene.model.groups.values() if g.joint_names)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.scene.model.group(self.group).joint_names

    @property
    def state_names(self) -> tuple[str, ...]:
        """Named states of the group."""
        return tuple(self.scene.model.named_states.get(self.group, {}))

    @property
    def tip_link(self) -> str | None:
        return self.scene.model.group(self.group).tip_link

    @property
    def start_positions(self) -> Array:
        """Where a plan begins (dof,)."""
        return self.scene.positions if self.start is None else self.start

    def set_group(self, name: str) -> None:
        """Another group; its goal is where it is at the start.

        Raises:
            UnknownNameError: no such group.
        """
        with self._lock:
            self.scene.model.group(name)
            self.group, self._given = name, None
            self._judge(self.start_positions)
            self._forget_result()
        self._tell("settings", "goal", "result")

    def set(self, **fields) -> None:
        """Change some of `settings`.

        Raises:
            InputError: a value that cannot be; nothing is changed then.
        """
        with self._lock:
            settings = replace(self.settings, **fields)
            settings.check()
            self.settings, self._given = settings, None
        self._tell("settings")

    def set_goal_pose(self, T_world_tip: SE3) -> None:
        """The group's tip shall be at a pose; the goal says whether that can be."""
        with self._lock:
            self._given = None
            self.goal = posed(self._start_scene(), self.group, T_world_tip, self.goal.positions, self._seed)
        self._tell("goal")

    def set_positions(self, state: JointState, start: bool = False) -> None:
        """Some joints of the goal, or of the start; the others stay.

        Raises:
            InputError: outside limits. UnknownNameError: no such joint.
        """
        with self._lock:
            model = self.scene.model
            base = self.start_positions if start else self.goal.positions
            q = JointState(model.joint_names, base).updated(state).positions
            model.check_positions(q, margin=1e-3)
            self._given = None
            if start:
                self.start = q
            self._judge(self.goal.positions if start else q)
        self._tell("goal")

    def set_named(self, name: str, start: bool = False) -> None:
        """A named state of the group as goal, or as start.

        Raises:
            UnknownNameError: no such state.
        """
        self.set_positions(self.scene.model.named_state(self.group, name), start)

    def set_random(self, start: bool = False) -> None:
        """A random state of the group that is within limits and free.

        Raises:
            InputError: none was found.
        """
        q = random_positions(self._start_scene(), self.group, self._rng)
        self.set_positions(JointState(self.joint_names, q), start)

    def set_present(self, start: bool = False) -> None:
        """The robot as it is now as goal, or as start."""
        with self._lock:
            self._given = None
            if start:
                self.start = None
            self._judge(self.goal.positions if start else self.scene.positions)
        self._tell("goal")

    def _start_scene(self) -> PlanningScene:
        return replace(self.scene, positions=self.start_positions)

    def _judge(self, positions: Array) -> None:
        self.goal = judged(self._start_scene(), self.group, positions, self.start_positions)

    def request(self) -> PlanRequest | CartesianRequest:
        """What is asked of the planner.

        Raises:
            InputError: a straight line or an upright tip of a group that has no tip.
        """
        if self._given is not None:
            return self._given
        s, goal = self.settings, self.goal
        start = None if self.start is None else JointState(self.scene.model.joint_names, self.start)
        speeds: dict[str, Any] = {
            "velocity_scaling": s.velocity_scaling,
            "acceleration_scaling": s.acceleration_scaling,
        }
        if s.motion != FREE and goal.T_world_tip is None:
            raise InputError(
                f"group {self.group!r} is not a chain, so no tip keeps to a line or stays upright",
                cure=f"choose the motion {FREE!r}",
            )
        if s.motion == LINE:
            assert goal.T_world_tip is not None
            return CartesianRequest(self.group, (goal.T_world_tip,), start=start, **speeds)
        request = PlanRequest(
            self.group, (_asked(self.scene, self.group, goal),), start=start, planner_id=s.planner,
            pipeline_id=s.pipeline, planning_time=s.planning_time, attempts=s.attempts, seed=self._seed,
            **speeds,
        )  # fmt: skip
        if s.motion == UPRIGHT:
            request = replace(request, path_constraints=keep_upright(self._start_scene(), self.group))
        return request

    # --- the world ---
    def change_scene(self, change: Callable[[PlanningScene], PlanningScene], said: str = "") -> None:
        """Replace the scene by what a function makes of it: objects, attached ones, what may touch.

        Raises:
            InputError: what the function raises, and while a motion is executed; nothing is changed then.
        """
        with self._lock:
            if self.busy == "executing":
                raise InputError("the robot moves", cure="wait for its end, or stop it")
            self.scene = change(self.scene)
            self._edits += 1
            goal = self.goal
            if goal.by_pose and goal.T_world_tip is not None:
                self.goal = posed(
                    self._start_scene(), self.group, goal.T_world_tip, goal.positions, self._seed
                )
            else:
                self._judge(goal.positions)
            self.message = said or self.message
        self._tell("scene", "goal", "result")

    def apply(self, suggestion: Suggestion) -> None:
        """Make the change that an explanation suggests: to the scene, the goal, the start or the settings.

        The next plan asks just what was suggested, until something else is set.
        """
        with self._lock:
            scene, request = suggestion.apply(self.scene, self.request())
            if not np.array_equal(scene.positions, self.scene.positions):  # where the robot is, it is
                request = replace(request, start=scene.state)
                scene = replace(scene, positions=self.scene.positions)
            if scene is not self.scene:
                self.scene, self._edits = scene, self._edits + 1
            if request.start is not None:
                self.start = scene.state.updated(request.start).positions
            self._adopt_goal(request)
            self.settings = self.settings.as_in(request)
            self._given = request
            self._forget_result()
            self.message = f"done: {suggestion.text}"
        self._tell("scene", "settings", "goal", "result")

    def _adopt_goal(self, request: PlanRequest | CartesianRequest) -> None:
        """Show the first goal of a request."""
        goal = PoseGoal(request.waypoints[-1]) if isinstance(request, CartesianRequest) else request.goals[0]
        if isinstance(goal, NamedGoal):
            goal = JointGoal(self.scene.model.named_state(request.group, goal.name))
        if isinstance(goal, JointGoal):
            self._judge(
                JointState(self.scene.model.joint_names, self.goal.positions).updated(goal.state).positions
            )
        elif isinstance(goal, PoseGoal) and goal.link in (None, self.tip_link):
            self.goal = posed(
                self._start_scene(), self.group, goal.T_world_link, self.goal.positions, self._seed
            )

    # --- planning ---
    @property
    def busy(self) -> str:
        """ "planning", "explaining", "executing" or nothing."""
        return self._jobs.busy

    def plan(self) -> None:
        """Begin to plan; `result` tells how it went, `explanation` later why not.

        Raises:
            InputError: something else is being done, or the request is none.
        """
        with self._lock:
            scene, request, edits = self.scene, self.request(), self._edits
            self._jobs.begin("planning", lambda job: self._plan(job, scene, request, edits))
            self._forget_result()
            self.message = "planning"
        self._tell("result")

    def _plan(
        self, job: Job, scene: PlanningScene, request: PlanRequest | CartesianRequest, edits: int
    ) -> None:
        try:
            if isinstance(request, CartesianRequest):
                result = plan_cartesian(scene, request, job.cancel)
            else:
                result = plan(scene, request, job.cancel)
        except InputError as error:  # misuse is explained as well
            explanation = explain_misuse(scene, request, error, EXPLAIN_S)
            self._publish(job, message=str(error), explanation=explanation)
            return
        if result.ok:
            _ = result.min_clearance  # worked out here, not in the thread that shows it
        text = "planned" if result.ok else f"{result.code.name}: {result.message}"
        self._publish(job, message=text, result=result, planned_with=edits)
        if result.ok or result.code is ErrorCode.PREEMPTED or job.cancel.is_set():
            return
        job.kind = "explaining"
        self._tell("result")
        self._publish(job, explanation=result.explain(EXPLAIN_S))

    def _publish(self, job: Job, *, planned_with: int | None = None, **fields) -> None:
        """Set attributes, unless the job was given up meanwhile."""
        with self._lock:
            if self._jobs.current is not job:
                return
            for name, value in fields.items():
                setattr(self, name, value)
            if planned_with is not None:
                self._planned_with = planned_with
        self._tell("result")

    def _forget_result(self) -> None:
        self.result = self.explanation = self.outcome = None

    def positions_at(self, t: float) -> Array:
        """All joints (dof,) at a time [s] of the planned motion.

        Raises:
            InputError: there is no motion.
        """
        trajectory = self.result.trajectory if self.result is not None else None
        if trajectory is None:
            raise InputError("there is no motion to look at", cure="plan first")
        at = JointState(trajectory.joint_names, trajectory.sample(t)[0])
        return JointState(self.scene.model.joint_names, self.start_positions).updated(at).positions

    # --- executing ---
    @property
    def why_not_executable(self) -> str:
        """Why the last plan cannot be executed; empty where it can."""
        result = self.result
        if self._connect is None:
            return "there is no robot to execute it: this is a scene, not a cell"
        if result is None or not result.ok or result.trajectory is None:
            return "there is no plan"
        if self.busy:
            return f"busy {self.busy}"
        if self._planned_with != self._edits:
            return "the scene was changed since it was planned: plan again"
        begin = result.trajectory.start
        here = self.scene.state.reindexed(begin.joint_names)
        if np.max(np.abs(begin.positions - here.positions)) > START_TOLERANCE:
            return "it does not begin where the robot is: plan again from the present state"
        return ""

    def execute(self) -> None:
        """Begin to move the robot along the last plan.

        Raises:
            InputError: see `why_not_executable`.
        """
        with self._lock:
            why = self.why_not_executable
            if why:
                raise InputError(why)
            result = self.result
            assert result is not None
            self._jobs.begin("executing", lambda job: self._execute(job, result))
            self.message = "executing"
        self._tell("result")

    def _execute(self, job: Job, result: PlanResult) -> None:
        live = self._connected(job)
        assert result.trajectory is not None
        motion = Motion(
            "execute", result.trajectory, result.planner_id, result.planning_time, result.min_clearance
        )
        outcome = perform_all(live.ctx, (motion,))
        with self._lock:
            self.scene, self.outcome, self.start = live.scene(), outcome, None
            self._judge(self.goal.positions)
            self.message = "executed" if outcome.ok else f"{outcome.code.name}: {outcome.message}"
        self._tell("scene", "goal", "result")

    def _connected(self, job: Job) -> LiveCell:
        """The live cell, made anew where the user has changed the world since."""
        if self._live is not None and self._live_with != self._edits:
            self._disconnect()
        if self._live is None:
            assert self._connect is not None
            live = self._connect(self.scene, self.observers)
            if live.driver.name == "sim" and self.scene.attached:
                raise InputError(
                    f"physics does not hold what was attached by hand ({', '.join(self.scene.attached)})",
                    cure="detach it, or use the fake driver (--mode fake)",
                )
            self._live, self._live_with = live.__enter__(), self._edits
        self._live.ctx.cancel = job.cancel
        return self._live

    def _disconnect(self) -> None:
        live, self._live = self._live, None
        if live is not None:
            live.__exit__(None, None, None)

    # --- jobs ---
    def _failed(self, message: str) -> None:
        self.message = message

    def stop(self) -> None:
        """Stop planning, explaining or the robot."""
        if self._jobs.stop():
            self._tell("result")

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until nothing is being done; whether that came within the time [s]."""
        return self._jobs.wait(timeout)

    def close(self) -> None:
        """Stop everything and disconnect. The session can be used on, but nothing runs."""
        self.stop()
        self.wait(CLOSE_S)
        self._disconnect()


def _first_group(scene: PlanningScene) -> str:
    """The group that carries a gripper, else the first chain, else the first with joints.

    Raises:
        InputError: the robot has no group with joints.
    """
    model = scene.model
    names = [g.arm_group for g in model.grippers.values()]
    names += [g.name for g in model.groups.values() if g.tip_link and g.joint_names]
    names += [g.name for g in model.groups.values() if g.joint_names]
    if not names:
        raise InputError(
            f"robot {model.name!r} has no planning group with joints", cure="run armcell setup on its URDF"
        )
    return names[0]


def _asked(scene: PlanningScene, group: str, goal: GoalView) -> Goal:
    """The state that is shown; where it cannot be, the pose that was asked for, so that it is explained."""
    if goal.by_pose and goal.status != "free":
        assert goal.T_world_tip is not None
        return PoseGoal(goal.T_world_tip)
    names = scene.model.group(group).joint_names
    return JointGoal(JointState(scene.model.joint_names, goal.positions).reindexed(names))


__all__ = ["FREE", "LINE", "UPRIGHT", "GoalView", "PlanSettings", "PlanningSession"]
