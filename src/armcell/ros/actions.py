"""Actions in the style of ROS 1: five topics and the goal states of actionlib.

The topics are goal, cancel, status, feedback and result. Any transport can carry topics, so clients in this
process, in Unity and in ROS 1 all use the same server. States and transitions:
wiki.ros.org/actionlib/DetailedDescription.
"""

from __future__ import annotations

import itertools
import logging
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from armcell.core import ArmcellError, ErrorCode, InputError
from armcell.ros.bus import Bus
from armcell.ros.faults import write_failure
from armcell.ros.names import resolve

logger = logging.getLogger(__name__)
STATUS_PERIOD = 0.2  # [s] actionlib's status_frequency is 5 Hz
KEPT_FOR = 5.0  # [s] a finished goal stays in the status list: actionlib's status_list_timeout
GOAL_QUEUE = 50
INBOX = 256  # queue size for a client's results, feedback and status messages
CANCELED, REPLACED = "canceled by a client", "preempted by a newer goal"
MAX_GOALS = 32  # unfinished goals; the server rejects further goals


class GoalState(IntEnum):
    """States of a ROS 1 action goal, as defined in actionlib_msgs/GoalStatus. Only clients use the state
    LOST.
    """

    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5
    PREEMPTING = 6
    RECALLING = 7
    RECALLED = 8
    LOST = 9

    @classmethod
    def _missing_(cls, value: object) -> GoalState:
        return cls.LOST  # a received number that is not a valid state

    @property
    def is_terminal(self) -> bool:
        return self in _OVER


_OVER = (
    GoalState.PREEMPTED,
    GoalState.SUCCEEDED,
    GoalState.ABORTED,
    GoalState.REJECTED,
    GoalState.RECALLED,
    GoalState.LOST,
)


@dataclass(frozen=True)
class ActionOutcome:
    """Outcome of a ROS action goal: its final state, its result message and its status text."""

    state: GoalState
    result: Any  # the action's Result message
    text: str = ""


class Goal:
    """Goal of a ROS action, which an `ActionServer` passes to its `execute` function."""

    def __init__(self, server: ActionServer, goal_id: Any, message: Any):
        self._server = server
        self.id, self.message = goal_id, message
        self.state, self.text = GoalState.PENDING, ""
        self.cancel = threading.Event()
        """Set when a cancel message or a newer goal requires this goal to stop."""
        self.why_stopped = ""
        self.accepted = False
        self.finished_at: float | None = None

    def accept(self) -> None:
        """Accept a pending goal in the ROS action server.

        A pending goal becomes active; a goal whose cancellation is already requested becomes preempting, as
        with `setAccepted` of actionlib.
        """
        self._server._accept(self)

    def feedback(self, feedback: Any) -> None:
        """Send a Feedback message to the action client. A goal that is still pending is accepted first."""
        self.accept()
        self._server._publish("feedback", feedback=feedback, status=self.status())

    def status(self) -> Any:
        schema = self._server.bus.schema
        return schema.new(
            "actionlib_msgs/GoalStatus", goal_id=self.id, status=int(self.state), text=self.text
        )


Execute = Callable[[Goal], ActionOutcome]


class ActionServer:
    """Server of one ROS action, which uses five topics of the message bus as ROS 1's actionlib does.

    Args:
        bus: the message bus.
        name: name of the action.
        type_name: action type without the suffix `Action`, e.g. "moveit_msgs/MoveGroup".
        execute: executes one goal in a separate thread, monitors `goal.cancel`, and returns the final state
            and result.
        concurrent: if False, a new goal cancels the current goal and waits until it ends, as in actionlib's
            SimpleActionServer; if True, goals run in parallel.
        owner: the transport for which this server acts, if the real server is remote (see `Bus.advertise`).
        accepts: if True, the server accepts each goal before it calls `execute`; if False, the goal stays
            pending until `execute` calls `goal.accept()`, so that `execute` can still return REJECTED.
    Raises:
        UnknownNameError: the action type does not exist.
    """

    def __init__(
        self, bus: Bus, name: str, type_name: str, execute: Execute, concurrent: bool = False,
        owner: object = None, accepts: bool = True,
    ):  # fmt: skip
        self.bus, self.name = bus, resolve(name)
        self.type = bus.schema.action(type_name)
        self._execute, self._concurrent, self._owner = execute, concurrent, owner
        self._accepts = accepts
        self._lock = threading.Lock()
        self._goals: dict[str, Goal] = {}
        self._turn = threading.Lock()  # held by the goal that executes, unless `concurrent`
        self._numbers = itertools.count(1)  # for ids of goals that arrive without an id
        self._cancelled_until = 0  # [ns] goals with a stamp up to this time are canceled on arrival
        self._stop = threading.Event()
        self._pub = {
            "feedback": bus.advertise(f"{self.name}/feedback", f"{self.type}ActionFeedback"),
            "result": bus.advertise(f"{self.name}/result", f"{self.type}ActionResult"),
            "status": bus.advertise(f"{self.name}/status", "actionlib_msgs/GoalStatusArray"),
        }
        self._subs = [
            bus.subscribe(f"{self.name}/goal", f"{self.type}ActionGoal", self._on_goal, GOAL_QUEUE),
            bus.subscribe(f"{self.name}/cancel", "actionlib_msgs/GoalID", self._on_cancel, GOAL_QUEUE),
        ]
        for member in (*self._subs, *self._pub.values()):
            member.owner = owner
        threading.Thread(target=self._tell, name=f"status {self.name}", daemon=True).start()

    def close(self) -> None:
        """Cancel all goals of the action server and remove the server from the bus."""
        self._stop.set()
        with self._lock:
            goals = list(self._goals.values())
        for goal in goals:
            goal.cancel.set()
        for member in [*self._subs, *self._pub.values()]:
            member.close()

    def __enter__(self) -> ActionServer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # --- incoming ---
    def _on_goal(self, message: Any) -> None:
        stamp = message.goal_id.stamp.to_nsec()
        text = message.goal_id.id or f"{self.name}-{next(self._numbers)}-{self.bus.clock.now():.9f}"
        goal_id = self.bus.schema.new("actionlib_msgs/GoalID", stamp=message.goal_id.stamp, id=text)
        goal = Goal(self, goal_id, message.goal)
        with self._lock:
            if goal_id.id in self._goals:
                return  # as in actionlib, a repeated goal id is ignored
            others = [g for g in self._goals.values() if not g.state.is_terminal]
            self._goals[goal_id.id] = goal
        if 0 < stamp <= self._cancelled_until:
            goal.why_stopped = CANCELED
            goal.cancel.set()
        if len(others) >= MAX_GOALS:
            self._finish(
                goal,
                ActionOutcome(GoalState.REJECTED, self._empty_result(), f"{MAX_GOALS} goals wait already"),
            )
            return
        if not self._concurrent:
            for other in others:
                self._ask_to_stop(other, REPLACED)
        threading.Thread(target=self._work, args=(goal,), name=f"goal {self.name}", daemon=True).start()

    def _on_cancel(self, message: Any) -> None:
        """Cancel the action goals that a cancel message (GoalID) selects by goal id, by time stamp or by
        both.

        A stamp selects all goals up to this time. A message without id and stamp cancels all goals.
        """
        stamp = message.stamp.to_nsec()
        with self._lock:
            goals = [g for g in self._goals.values() if not g.state.is_terminal]
            self._cancelled_until = max(self._cancelled_until, stamp)
        everything = not message.id and not stamp
        for goal in goals:
            if everything or goal.id.id == message.id or (stamp and goal.id.stamp.to_nsec() <= stamp):
                self._ask_to_stop(goal, CANCELED)

    def _ask_to_stop(self, goal: Goal, why: str) -> None:
        with self._lock:
            goal.why_stopped = goal.why_stopped or why
            after = {GoalState.PENDING: GoalState.RECALLING, GoalState.ACTIVE: GoalState.PREEMPTING}
            goal.state = after.get(goal.state, goal.state)
        goal.cancel.set()
        self._publish_status()

    # --- working ---
    def _work(self, goal: Goal) -> None:
        if self._concurrent:
            self._run(goal)
        else:
            with self._turn:
                self._run(goal)

    def _run(self, goal: Goal) -> None:
        if goal.cancel.is_set():
            done = ActionOutcome(GoalState.RECALLED, self._empty_result(), "cancelled before it began")
        else:
            if self._accepts:
                self._accept(goal)
            else:
                self._publish_status()  # clients see the pending state before a rejection
            try:
                done = self._execute(goal)
            except ArmcellError as error:  # an expected failure: the result states the reason
                logger.warning("action %s: %s", self.name, error)
                done = ActionOutcome(GoalState.ABORTED, self._empty_result(), str(error))
            except Exception as error:
                logger.exception("action %s failed", self.name)
                done = ActionOutcome(
                    GoalState.ABORTED, self._empty_result(), f"{type(error).__name__}: {error}"
                )
        self._finish(goal, done)

    def _empty_result(self) -> Any:
        return self.bus.schema.new(f"{self.type}Result")

    def _accept(self, goal: Goal) -> None:
        with self._lock:
            if goal.accepted:
                return
            goal.accepted = True
            after = {GoalState.PENDING: GoalState.ACTIVE, GoalState.RECALLING: GoalState.PREEMPTING}
            goal.state = after.get(goal.state, goal.state)
        self._publish_status()

    def _finish(self, goal: Goal, done: ActionOutcome) -> None:
        """Publish the final state of a ROS action goal.
        A state that actionlib does not allow is replaced by one that it does allow.

        Only a pending goal can be rejected or recalled; only an accepted goal can succeed, abort or be
        preempted.
        """
        if self._owner is None:  # otherwise the server behind the transport has stated the reason
            done = _explained(done, goal.why_stopped)
        state = done.state
        if goal.accepted:
            state = {GoalState.REJECTED: GoalState.ABORTED, GoalState.RECALLED: GoalState.PREEMPTED}.get(
                state, state
            )
        elif state is GoalState.PREEMPTED:
            state = GoalState.RECALLED
        elif state not in (GoalState.REJECTED, GoalState.RECALLED):
            self._accept(goal)
        with self._lock:
            goal.state, goal.text = state, done.text
            goal.finished_at = self.bus.clock.now()
        self._publish("result", result=done.result, status=goal.status())
        self._publish_status()

    # --- outgoing ---
    def _publish(self, part: str, **fields: Any) -> None:
        name = f"{self.type}Action{part.capitalize()}"
        self._put(part, self.bus.schema.new(name, header=self.bus.header(), **fields))

    def _put(self, part: str, message: Any) -> None:
        try:
            self._pub[part].publish(message)
        except InputError:
            if not self._stop.is_set():  # otherwise `close` was called in the meantime
                raise

    def _publish_status(self) -> None:
        now = self.bus.clock.now()
        with self._lock:
            for key, goal in list(self._goals.items()):
                if goal.finished_at is not None and not 0 <= now - goal.finished_at <= KEPT_FOR:
                    del self._goals[key]
            statuses = [goal.status() for goal in self._goals.values()]
        message = self.bus.schema.new(
            "actionlib_msgs/GoalStatusArray", header=self.bus.header(), status_list=statuses
        )
        self._put("status", message)

    def _tell(self) -> None:
        while not self._stop.wait(STATUS_PERIOD):
            self._publish_status()


def _explained(done: ActionOutcome, why_stopped: str) -> ActionOutcome:
    """Return the outcome of an action goal. If the goal failed, the reason is copied into the result
    message.
    """
    if done.state is GoalState.SUCCEEDED:
        return done
    stopped = done.state in (GoalState.PREEMPTED, GoalState.RECALLED)
    why = why_stopped if stopped and why_stopped not in done.text else ""
    text = ": ".join(part for part in (why, done.text) if part)
    code = ErrorCode.PREEMPTED if stopped else ErrorCode.FAILURE
    return ActionOutcome(done.state, write_failure(done.result, text, code), text)


class ClientGoalHandle:
    """Goal that a ROS action client has sent, with the state, status text and result that the server
    reports.
    """

    def __init__(self, client: ActionClient, goal_id: Any, on_feedback: Callable[[Any], None] | None):
        self._client, self._on_feedback = client, on_feedback
        self.id = goal_id
        self.state, self.text, self.result = GoalState.PENDING, "", None
        self._over = threading.Event()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait up to `timeout` [s] for the result of a ROS action goal. Return False on timeout."""
        return self._over.wait(timeout)

    def cancel(self) -> None:
        self._client._cancel.publish(self._client.bus.schema.new("actionlib_msgs/GoalID", id=self.id.id))


class ActionClient:
    """Client that sends goals to a ROS action server, which is on the same bus or is reached through a
    transport.
    """

    _numbers = itertools.count(1)

    def __init__(self, bus: Bus, name: str, type_name: str):
        self.bus, self.name = bus, resolve(name)
        self.type = bus.schema.action(type_name)
        self._goals: dict[str, ClientGoalHandle] = {}
        self._lock = threading.Lock()
        self._goal = bus.advertise(f"{self.name}/goal", f"{self.type}ActionGoal")
        self._cancel = bus.advertise(f"{self.name}/cancel", "actionlib_msgs/GoalID")
        # The three topics share one queue, so that a goal's result cannot overtake its feedback.
        self._inbox = bus.subscribe(f"{self.name}/result", f"{self.type}ActionResult", None, INBOX)
        self._inbox.join(f"{self.name}/feedback", f"{self.type}ActionFeedback")
        self._inbox.join(f"{self.name}/status", "actionlib_msgs/GoalStatusArray")
        self._inbox.run(self._receive)

    def close(self) -> None:
        for member in (self._goal, self._cancel, self._inbox):
            member.close()

    def __enter__(self) -> ActionClient:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def wait_for_server(self, timeout: float | None = None) -> bool:
        """Wait up to `timeout` [s] for the server of a ROS action. The server is ready once it is connected
        to all five topics of the action.

        Returns:
            True if a server receives goals and cancels and publishes result, feedback and status.
        """
        give_up = None if timeout is None else time.monotonic() + timeout
        while True:
            version = self.bus.wait_change(-1, 0)
            topics = {t.name: t for t in self.bus.topics()}
            heard = all(topics[f"{self.name}/{t}"].subscribers for t in ("goal", "cancel"))
            if heard and all(topics[f"{self.name}/{t}"].publishers for t in ("result", "feedback", "status")):
                return True
            left = None if give_up is None else give_up - time.monotonic()
            if left is not None and left <= 0:
                return False
            self.bus.wait_change(version, left)

    def send_goal(self, goal: Any, on_feedback: Callable[[Any], None] | None = None) -> ClientGoalHandle:
        """Send a Goal message to the action server and return a handle with which the client follows the
        goal.

        Args:
            goal: Goal message of the action.
            on_feedback: called with each Feedback message for this goal.
        """
        schema, stamp = self.bus.schema, self.bus.stamp()
        text = f"/armcell-{os.getpid()}-{next(self._numbers)}-{stamp.to_sec():.9f}"
        goal_id = schema.new("actionlib_msgs/GoalID", stamp=stamp, id=text)
        sent = ClientGoalHandle(self, goal_id, on_feedback)
        with self._lock:
            self._goals[text] = sent
        message = schema.new(f"{self.type}ActionGoal", header=self.bus.header(), goal_id=goal_id, goal=goal)
        self._goal.publish(message)
        return sent

    @property
    def unfinished_goals(self) -> list[ClientGoalHandle]:
        """Return the goals that this action client has sent and that still have no result."""
        with self._lock:
            return list(self._goals.values())

    def cancel_all(self) -> None:
        """Cancel all goals of the ROS action to which this client is connected, including the goals of other
        clients.
        """
        self._cancel.publish(self.bus.schema.new("actionlib_msgs/GoalID"))

    def _receive(self, message: Any) -> None:
        if message._type == "actionlib_msgs/GoalStatusArray":
            self._on_status(message)
        elif message._type == f"{self.type}ActionFeedback":
            self._on_feedback(message)
        else:
            self._on_result(message)

    def _on_status(self, message: Any) -> None:
        for status in message.status_list:
            sent = self._goals.get(status.goal_id.id)
            state = GoalState(status.status)
            if sent is not None and not sent._over.is_set() and state is not GoalState.LOST:
                sent.state, sent.text = state, status.text

    def _on_feedback(self, message: Any) -> None:
        sent = self._goals.get(message.status.goal_id.id)
        if sent is not None and sent._on_feedback is not None:
            sent._on_feedback(message.feedback)

    def _on_result(self, message: Any) -> None:
        with self._lock:
            sent = self._goals.pop(message.status.goal_id.id, None)
        if sent is not None:
            sent.state, sent.text = GoalState(message.status.status), message.status.text
            sent.result = message.result
            sent._over.set()
