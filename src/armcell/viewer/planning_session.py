"""`PlanningSession`: state and logic of the planning panel, without a GUI."""

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
from armcell.planning import explain_invalid_request, plan, plan_cartesian
from armcell.scene import PlanningScene
from armcell.tasks import Motion, perform_all
from armcell.viewer.background_jobs import Job, Jobs
from armcell.viewer.session_goal import (
    FREE,
    LINE,
    UPRIGHT,
    GoalView,
    PlanSettings,
    check_goal_positions,
    first_group,
    keep_upright,
    random_positions,
    requested_goal,
    solve_goal_pose,
)

Array = NDArray[np.float64]
Connect = Callable[[PlanningScene, Sequence[Observer]], LiveCell]
logger = logging.getLogger(__name__)

EXPLAIN_S = 10.0  # [s] approximate time limit for finding suggestions
START_TOLERANCE = 0.01  # [rad or m], same as the executor's start tolerance
CLOSE_S = 5.0


class PlanningSession:
    """Thread-safe planning session of a panel in one scene: goal, settings, planning and execution.

    Long operations run in a background thread. Attributes hold immutable values that are replaced on change,
    so they can be read at any time. Register a callback with `listen`: it is called with "goal", "scene",
    "settings" or "result" from the thread that made the change.

    Attributes:
        scene: the world and the robot's current state.
        start: joint positions (dof,) at which plans start; None for the robot's current state.
        goal: goal state and whether it is reachable and collision-free.
        settings: planner, planning time, velocity scaling and kind of motion.
        result, explanation: of the last plan; the explanation of a failed plan arrives later than the result.
        outcome: result of the last execution.
        message: last action or error, as text.
        observers: observers of the live cell; set them before the first execution.

    Args:
        connect: returns a live cell for a scene and observers, for `execute`; without it the session can
            only plan.
        seed: random seed of the planners and random states.
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
        self.group = first_group(scene)
        self._seed, self._rng = seed, np.random.default_rng(seed)
        self._connect, self._live = connect, None
        self._listeners: list[Callable[[str], None]] = []
        self._lock = threading.RLock()
        self._jobs = Jobs(self._lock, self._failed, lambda: self._tell("result"))
        self._given: PlanRequest | CartesianRequest | None = None  # request of an applied suggestion
        self._edits = 0  # number of user edits of the world
        self._planned_with = self._live_with = -1  # `_edits` at the last plan, and when connected
        self.goal: GoalView = check_goal_positions(scene, self.group, scene.positions, scene.positions)

    # --- listeners ---
    def add_listener(self, listener: Callable[[str], None]) -> None:
        self._listeners.append(listener)

    def _tell(self, *topics: str) -> None:
        for topic in topics:
            for listener in self._listeners:
                try:
                    listener(topic)
                except Exception:  # an error in a view must not end the work it shows
                    logger.exception("a listener of the planning session failed")

    def say(self, text: str) -> None:
        """Set the status message of the planning session and notify its listeners."""
        self.message = text
        self._tell("result")

    # --- goal and settings ---
    @property
    def groups(self) -> tuple[str, ...]:
        """Return the groups for which the planning session can plan: the groups that have joints."""
        return tuple(g.name for g in self.scene.model.groups.values() if g.joint_names)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.scene.model.group(self.group).joint_names

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the named states of the planning session's group."""
        return tuple(self.scene.model.named_states.get(self.group, {}))

    @property
    def tip_link(self) -> str | None:
        return self.scene.model.group(self.group).tip_link

    @property
    def start_positions(self) -> Array:
        """Return the joint positions (dof,) at which the plan of the planning session starts."""
        return self.scene.positions if self.start is None else self.start

    def set_group(self, name: str) -> None:
        """Select the group for which the planning session plans, and reset the goal to the start state.

        Raises:
            UnknownNameError: the group does not exist.
        """
        with self._lock:
            self.scene.model.group(name)
            self.group, self._given = name, None
            self._judge(self.start_positions)
            self._forget_result()
        self._tell("settings", "goal", "result")

    def change_settings(self, **fields) -> None:
        """Change settings of the planning session.

        Raises:
            InputError: a value is invalid; the settings stay unchanged.
        """
        with self._lock:
            settings = replace(self.settings, **fields)
            settings.check()
            self.settings, self._given = settings, None
        self._tell("settings")

    def set_goal_pose(self, T_world_tip: SE3) -> None:
        """Set the goal of the planning session to a tip pose; `goal.status` reports the outcome."""
        with self._lock:
            self._given = None
            self.goal = solve_goal_pose(
                self._start_scene(), self.group, T_world_tip, self.goal.positions, self._seed
            )
        self._tell("goal")

    def set_positions(self, state: JointState, start: bool = False) -> None:
        """Set some joints in the goal or start state of the planning session; others stay unchanged.

        Raises:
            InputError: a position is outside the joint limits.
            UnknownNameError: a joint does not exist.
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
        """Set the goal or start state of the planning session to a named state of the group.

        Raises:
            UnknownNameError: the state does not exist.
        """
        self.set_positions(self.scene.model.named_state(self.group, name), start)

    def set_random(self, start: bool = False) -> None:
        """Set the goal or start state of the planning session to a random collision-free state.

        Raises:
            InputError: no collision-free sample was found.
        """
        q = random_positions(self._start_scene(), self.group, self._rng)
        self.set_positions(JointState(self.joint_names, q), start)

    def set_current_state(self, start: bool = False) -> None:
        """Set the goal or start state of the planning session to the robot's current state."""
        with self._lock:
            self._given = None
            if start:
                self.start = None
            self._judge(self.goal.positions if start else self.scene.positions)
        self._tell("goal")

    def _start_scene(self) -> PlanningScene:
        return replace(self.scene, positions=self.start_positions)

    def _judge(self, positions: Array) -> None:
        self.goal = check_goal_positions(self._start_scene(), self.group, positions, self.start_positions)

    def request(self) -> PlanRequest | CartesianRequest:
        """Return a request with the goal and the settings of the planning session.

        Raises:
            InputError: the settings ask for a straight line or an upright tip, but the group has no tip link.
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
                hint=f"choose the motion {FREE!r}",
            )
        if s.motion == LINE:
            assert goal.T_world_tip is not None
            return CartesianRequest(self.group, (goal.T_world_tip,), start=start, **speeds)
        request = PlanRequest(
            self.group, (requested_goal(self.scene, self.group, goal),), start=start, planner_id=s.planner,
            pipeline_id=s.pipeline, planning_time=s.planning_time, attempts=s.attempts, seed=self._seed,
            **speeds,
        )  # fmt: skip
        if s.motion == UPRIGHT:
            request = replace(request, path_constraints=keep_upright(self._start_scene(), self.group))
        return request

    # --- the world ---
    def change_scene(self, change: Callable[[PlanningScene], PlanningScene], said: str = "") -> None:
        """Replace the scene of the planning session by `change(scene)`, e.g. to add or attach objects.

        Raises:
            InputError: raised by `change`, or the robot is executing a motion; the scene stays unchanged.
        """
        with self._lock:
            if self.busy == "executing":
                raise InputError("the robot moves", hint="wait for its end, or stop it")
            self.scene = change(self.scene)
            self._edits += 1
            goal = self.goal
            if goal.by_pose and goal.T_world_tip is not None:
                self.goal = solve_goal_pose(
                    self._start_scene(), self.group, goal.T_world_tip, goal.positions, self._seed
                )
            else:
                self._judge(goal.positions)
            self.message = said or self.message
        self._tell("scene", "goal", "result")

    def apply(self, suggestion: Suggestion) -> None:
        """Apply a change that an explanation suggests to the session's scene, goal, start or settings.

        The next plan uses exactly the suggested request until a goal or setting changes.
        """
        with self._lock:
            scene, request = suggestion.apply(self.scene, self.request())
            # a suggestion cannot move the robot: plan from its state instead
            if not np.array_equal(scene.positions, self.scene.positions):
                request = replace(request, start=scene.state)
                scene = replace(scene, positions=self.scene.positions)
            if scene is not self.scene:
                self.scene, self._edits = scene, self._edits + 1
            if request.start is not None:
                self.start = scene.state.updated(request.start).positions
            self._adopt_goal(request)
            self.settings = self.settings.with_request_values(request)
            self._given = request
            self._forget_result()
            self.message = f"done: {suggestion.text}"
        self._tell("scene", "settings", "goal", "result")

    def _adopt_goal(self, request: PlanRequest | CartesianRequest) -> None:
        """Use the first goal of a request as the goal that the planning session shows."""
        goal = PoseGoal(request.waypoints[-1]) if isinstance(request, CartesianRequest) else request.goals[0]
        if isinstance(goal, NamedGoal):
            goal = JointGoal(self.scene.model.named_state(request.group, goal.name))
        if isinstance(goal, JointGoal):
            self._judge(
                JointState(self.scene.model.joint_names, self.goal.positions).updated(goal.state).positions
            )
        elif isinstance(goal, PoseGoal) and goal.link in (None, self.tip_link):
            self.goal = solve_goal_pose(
                self._start_scene(), self.group, goal.T_world_link, self.goal.positions, self._seed
            )

    # --- planning ---
    @property
    def busy(self) -> str:
        """Return the session's activity: "planning", "explaining", "executing" or an empty string."""
        return self._jobs.busy

    def plan(self) -> None:
        """Start planning for the session in the background. The plan or the failure is stored in `result`.

        If planning fails and was not canceled, the `explanation` of the failure follows. If the planner
        rejects the request as invalid, only `explanation` is set.

        Raises:
            InputError: another job is running, or the request is invalid.
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
        except InputError as error:  # invalid requests are explained, too
            explanation = explain_invalid_request(scene, request, error, EXPLAIN_S)
            self._publish(job, message=str(error), explanation=explanation)
            return
        if result.ok:
            _ = result.min_clearance  # compute the cached value here, not in the GUI thread
        text = "planned" if result.ok else f"{result.code.name}: {result.message}"
        self._publish(job, message=text, result=result, planned_with=edits)
        if result.ok or result.code is ErrorCode.PREEMPTED or job.cancel.is_set():
            return
        job.kind = "explaining"
        self._tell("result")
        self._publish(job, explanation=result.explain(EXPLAIN_S))

    def _publish(self, job: Job, *, planned_with: int | None = None, **fields) -> None:
        """Set attributes of the planning session, unless the background job that sets them was abandoned."""
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
        """Return the joint positions (dof,) at a time [s] of the motion that the session planned.

        Raises:
            InputError: there is no planned motion.
        """
        trajectory = self.result.trajectory if self.result is not None else None
        if trajectory is None:
            raise InputError("there is no motion to look at", hint="plan first")
        at = JointState(trajectory.joint_names, trajectory.sample(t)[0])
        return JointState(self.scene.model.joint_names, self.start_positions).updated(at).positions

    # --- executing ---
    @property
    def why_not_executable(self) -> str:
        """Explain why the planning session cannot execute its last plan; the text is empty if it can."""
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
        """Start executing the last plan of the planning session in the background.

        Raises:
            InputError: the plan cannot be executed; the text is `why_not_executable`.
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
        """Return the live cell of the planning session; reconnect it if the user has edited the world."""
        if self._live is not None and self._live_with != self._edits:
            self._disconnect()
        if self._live is None:
            assert self._connect is not None
            live = self._connect(self.scene, self.observers)
            if live.driver.name == "sim" and self.scene.attached:
                raise InputError(
                    f"physics does not hold what was attached by hand ({', '.join(self.scene.attached)})",
                    hint="detach it, or use the fake driver (--mode fake)",
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
        """Cancel planning or explanation in the session, or stop the robot if it executes the plan."""
        if self._jobs.stop():
            self._tell("result")

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the planning session is idle. Return False if `timeout` [s] expires first."""
        return self._jobs.wait(timeout)

    def close(self) -> None:
        """Stop all jobs of the planning session and disconnect from the robot. The session stays usable."""
        self.stop()
        self.wait(CLOSE_S)
        self._disconnect()


__all__ = ["FREE", "LINE", "UPRIGHT", "GoalView", "PlanSettings", "PlanningSession"]
