"""Actions in ROS 1's style: five topics (goal, cancel, status, feedback, result) with actionlib's states.

Written on topics so that any transport carries them: a client in this process, in Unity or behind ROS 1 is
served alike. States and transitions: wiki.ros.org/actionlib/DetailedDescription.
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

from armcell.core import ArmcellError, InputError
from armcell.ros.bus import Bus
from armcell.ros.names import resolve

logger = logging.getLogger(__name__)
STATUS_PERIOD = 0.2  # [s] actionlib's status_frequency is 5 Hz
KEPT_FOR = 5.0  # [s] a finished goal stays in the status list: actionlib's status_list_timeout
GOAL_QUEUE = 50
INBOX = 256  # a client's results, feedback and status
MAX_GOALS = 32  # waiting and at work; further ones are rejected


class State(IntEnum):
    """actionlib_msgs/GoalStatus, and LOST, which only clients use."""

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
    def _missing_(cls, value: object) -> State:
        return cls.LOST  # a number that came over a wire and means nothing

    @property
    def is_over(self) -> bool:
        return self in _OVER


_OVER = (State.PREEMPTED, State.SUCCEEDED, State.ABORTED, State.REJECTED, State.RECALLED, State.LOST)


@dataclass(frozen=True)
class Done:
    """How a goal ended."""

    state: State
    result: Any  # the action's Result message
    text: str = ""


class Goal:
    """A goal being worked on, as its `execute` function sees it."""

    def __init__(self, server: ActionServer, goal_id: Any, message: Any):
        self._server = server
        self.id, self.message = goal_id, message
        self.state, self.text = State.PENDING, ""
        self.cancel = threading.Event()
        """Set when the goal shall stop: by a cancel message or by a newer goal."""
        self.finished_at: float | None = None

    def feedback(self, feedback: Any) -> None:
        """Tell the client how it goes; a Feedback message of the action."""
        self._server._publish("feedback", feedback=feedback, status=self.status())

    def status(self) -> Any:
        schema = self._server.bus.schema
        return schema.new(
            "actionlib_msgs/GoalStatus", goal_id=self.id, status=int(self.state), text=self.text
        )


Execute = Callable[[Goal], Done]


class ActionServer:
    """Serves an action.

    Args:
        type_name: without the suffix, e.g. "moveit_msgs/MoveGroup".
        execute: works on a goal in a thread of its own, watches `goal.cancel`, returns how it ended.
        concurrent: False as actionlib's SimpleActionServer: a new goal cancels the one at work and waits
            for its end; True: each starts at once.
        owner: a transport that serves it for somebody behind its wire (see `Bus.advertise`).
    Raises:
        UnknownNameError: no such action.
    """

    def __init__(
        self, bus: Bus, name: str, type_name: str, execute: Execute, concurrent: bool = False,
        owner: object = None,
    ):  # fmt: skip
        self.bus, self.name = bus, resolve(name)
        self.type = bus.schema.action(type_name)
        self._execute, self._concurrent = execute, concurrent
        self._lock = threading.Lock()
        self._goals: dict[str, Goal] = {}
        self._turn = threading.Lock()  # held by the goal at work, unless concurrent
        self._numbers = itertools.count(1)  # of goals that come without an id
        self._cancelled_until = 0  # [ns] goals stamped up to here are cancelled on arrival
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
        """Cancel what is at work and leave the bus."""
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
                return  # actionlib: a goal is taken once
            others = [g for g in self._goals.values() if not g.state.is_over]
            self._goals[goal_id.id] = goal
        if 0 < stamp <= self._cancelled_until:
            goal.cancel.set()
        if len(others) >= MAX_GOALS:
            self._finish(goal, Done(State.REJECTED, self._empty_result(), f"{MAX_GOALS} goals wait already"))
            return
        if not self._concurrent:
            for other in others:
                self._ask_to_stop(other)
        threading.Thread(target=self._work, args=(goal,), name=f"goal {self.name}", daemon=True).start()

    def _on_cancel(self, message: Any) -> None:
        """By id; by time (every goal up to the stamp); by both; or all, when neither is given."""
        stamp = message.stamp.to_nsec()
        with self._lock:
            goals = [g for g in self._goals.values() if not g.state.is_over]
            self._cancelled_until = max(self._cancelled_until, stamp)
        everything = not message.id and not stamp
        for goal in goals:
            if everything or goal.id.id == message.id or (stamp and goal.id.stamp.to_nsec() <= stamp):
                self._ask_to_stop(goal)

    def _ask_to_stop(self, goal: Goal) -> None:
        with self._lock:
            after = {State.PENDING: State.RECALLING, State.ACTIVE: State.PREEMPTING}
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
        with self._lock:
            recalled = goal.cancel.is_set()
            if not recalled:
                goal.state = State.ACTIVE
        if recalled:
            done = Done(State.RECALLED, self._empty_result(), "cancelled before it began")
        else:
            self._publish_status()
            try:
                done = self._execute(goal)
            except ArmcellError as error:  # what was asked cannot be: told, as services do
                logger.warning("action %s: %s", self.name, error)
                done = Done(State.ABORTED, self._empty_result(), str(error))
            except Exception as error:
                logger.exception("action %s failed", self.name)
                done = Done(State.ABORTED, self._empty_result(), f"{type(error).__name__}: {error}")
        self._finish(goal, done)

    def _empty_result(self) -> Any:
        return self.bus.schema.new(f"{self.type}Result")

    def _finish(self, goal: Goal, done: Done) -> None:
        with self._lock:
            goal.state, goal.text = done.state, done.text
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
            if not self._stop.is_set():  # else closed meanwhile
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


class SentGoal:
    """A goal as its client sees it."""

    def __init__(self, client: ActionClient, goal_id: Any, on_feedback: Callable[[Any], None] | None):
        self._client, self._on_feedback = client, on_feedback
        self.id = goal_id
        self.state, self.text, self.result = State.PENDING, "", None
        self._over = threading.Event()

    def wait(self, timeout: float | None = None) -> bool:
        """Whether the result is there, after waiting for it up to `timeout` [s]."""
        return self._over.wait(timeout)

    def cancel(self) -> None:
        self._client._cancel.publish(self._client.bus.schema.new("actionlib_msgs/GoalID", id=self.id.id))


class ActionClient:
    """Sends goals to an action served on the bus, here or behind a transport."""

    _numbers = itertools.count(1)

    def __init__(self, bus: Bus, name: str, type_name: str):
        self.bus, self.name = bus, resolve(name)
        self.type = bus.schema.action(type_name)
        self._goals: dict[str, SentGoal] = {}
        self._lock = threading.Lock()
        self._goal = bus.advertise(f"{self.name}/goal", f"{self.type}ActionGoal")
        self._cancel = bus.advertise(f"{self.name}/cancel", "actionlib_msgs/GoalID")
        # One queue for the three topics: a goal's feedback must not be overtaken by its result.
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
        """Whether somebody takes goals and all five topics are connected, after waiting for that."""
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

    def send(self, goal: Any, on_feedback: Callable[[Any], None] | None = None) -> SentGoal:
        """Send a Goal message of the action."""
        schema, stamp = self.bus.schema, self.bus.stamp()
        text = f"/armcell-{os.getpid()}-{next(self._numbers)}-{stamp.to_sec():.9f}"
        goal_id = schema.new("actionlib_msgs/GoalID", stamp=stamp, id=text)
        sent = SentGoal(self, goal_id, on_feedback)
        with self._lock:
            self._goals[text] = sent
        message = schema.new(f"{self.type}ActionGoal", header=self.bus.header(), goal_id=goal_id, goal=goal)
        self._goal.publish(message)
        return sent

    @property
    def unfinished(self) -> list[SentGoal]:
        """Goals that were sent and have no result yet."""
        with self._lock:
            return list(self._goals.values())

    def cancel_all(self) -> None:
        """Cancel every goal of the server, other clients' too."""
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
            state = State(status.status)
            if sent is not None and not sent._over.is_set() and state is not State.LOST:
                sent.state, sent.text = state, status.text

    def _on_feedback(self, message: Any) -> None:
        sent = self._goals.get(message.status.goal_id.id)
        if sent is not None and sent._on_feedback is not None:
            sent._on_feedback(message.feedback)

    def _on_result(self, message: Any) -> None:
        with self._lock:
            sent = self._goals.pop(message.status.goal_id.id, None)
        if sent is not None:
            sent.state, sent.text = State(message.status.status), message.status.text
            sent.result = message.result
            sent._over.set()
