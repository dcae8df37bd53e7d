"""Shim of actionlib: SimpleActionClient and SimpleActionServer for the bus's actions.

Source of names and behavior: actionlib's documentation (docs.ros.org/en/noetic/api/actionlib).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from armcell.moveit.message_classes import classes
from armcell.moveit.session import CHECK, current_session
from armcell.moveit.shims.rospy import ROSInterruptException, get_time, is_shutdown
from armcell.ros import ActionClient as BusClient
from armcell.ros import ActionServer as BusServer
from armcell.ros.actions import ActionOutcome, Goal, GoalState

GoalStatus = classes()["actionlib_msgs/GoalStatus"]


class SimpleGoalState:
    PENDING, ACTIVE, DONE = 0, 1, 2


def _plain(action_spec: Any) -> str:
    return action_spec._type.removesuffix("Action")


def _seconds(duration: Any) -> float:
    return duration.to_sec() if hasattr(duration, "to_sec") else float(duration)


class SimpleActionClient:
    """Action client with one goal at a time, like actionlib.SimpleActionClient. A new goal replaces the
    previous one.
    """

    def __init__(self, ns: str, ActionSpec: Any):
        session = current_session()
        self._client = session.close_on_shutdown(BusClient(session.bus, ns, _plain(ActionSpec)))
        self._session, self._sent = session, None

    def wait_for_server(self, timeout: Any = 0.0) -> bool:
        """Wait for the action server, as in actionlib, and return whether the server is available.

        Args:
            timeout: limit [s, wall clock] or Duration; 0 waits without limit.
        """
        seconds = _seconds(timeout)
        give_up = time.monotonic() + seconds if seconds > 0 else None
        while not self._client.wait_for_server(CHECK):
            if is_shutdown() or (give_up is not None and time.monotonic() > give_up):
                return False
        return True

    def send_goal(
        self, goal: Any, done_cb: Callable[..., None] | None = None,
        active_cb: Callable[[], None] | None = None, feedback_cb: Callable[[Any], None] | None = None,
    ) -> None:  # fmt: skip
        local = self._session.messages.local
        on_feedback = None if feedback_cb is None else (lambda message: feedback_cb(local(message)))
        sent = self._sent = self._client.send_goal(local(goal), on_feedback)
        if done_cb is not None or active_cb is not None:
            threading.Thread(target=self._watch, args=(sent, done_cb, active_cb), daemon=True).start()

    def _watch(self, sent: Any, done_cb: Any, active_cb: Any) -> None:
        while not sent.wait(0.02):
            if active_cb is not None and sent.state is GoalState.ACTIVE:
                active_cb()
                active_cb = None
            if self._session.shutting_down.is_set():
                return
        if active_cb is not None:
            active_cb()
        if done_cb is not None:
            done_cb(int(sent.state), self._session.messages.local(sent.result))

    def send_goal_and_wait(self, goal: Any, execute_timeout: Any = 0.0, preempt_timeout: Any = 0.0) -> int:
        self.send_goal(goal)
        if not self.wait_for_result(execute_timeout):
            self.cancel_goal()
            self.wait_for_result(preempt_timeout if _seconds(preempt_timeout) > 0 else 2.0)
        return self.get_state()

    def wait_for_result(self, timeout: Any = 0.0) -> bool:
        """Wait for the result of the action goal, as in actionlib, and return whether it has arrived.

        Args:
            timeout: limit [s, cell clock] or Duration; 0 waits without limit.
        """
        if self._sent is None:
            return False
        seconds = _seconds(timeout)
        give_up = get_time() + seconds if seconds > 0 else None
        try:
            while not self._sent.wait(CHECK if give_up is None else 0.01):
                if is_shutdown():
                    return False
                if give_up is not None and get_time() > give_up:
                    return False
        except KeyboardInterrupt:
            self.cancel_goal()
            self._session.shut_down("interrupted")
            raise ROSInterruptException("interrupted while waiting for a result") from None
        return True

    def get_result(self) -> Any:
        return None if self._sent is None or self._sent.result is None else (
            self._session.messages.local(self._sent.result)
        )  # fmt: skip

    def get_state(self) -> int:
        return int(GoalState.LOST) if self._sent is None else int(self._sent.state)

    def get_goal_status_text(self) -> str:
        return "" if self._sent is None else self._sent.text

    def cancel_goal(self) -> None:
        if self._sent is not None:
            self._sent.cancel()

    def cancel_all_goals(self) -> None:
        self._client.cancel_all()

    def cancel_goals_at_and_before_time(self, time: Any) -> None:
        stamp = self._session.new("actionlib_msgs/GoalID", stamp=time)
        self._client._cancel.publish(stamp)

    def stop_tracking_goal(self) -> None:
        self._sent = None


class SimpleActionServer:
    """Action server that runs its callback in a separate thread, like actionlib.SimpleActionServer."""

    def __init__(
        self,
        name: str,
        ActionSpec: Any,
        execute_cb: Callable[[Any], None] | None = None,
        auto_start: bool = True,
    ):
        self._session = current_session()
        self._name, self._type, self._callback = name, _plain(ActionSpec), execute_cb
        self._server: BusServer | None = None
        self._goal: Goal | None = None
        self._next: list[Goal] = []
        self._ended: dict[str, ActionOutcome] = {}
        self._over: dict[str, threading.Event] = {}
        self._on_goal: Callable[[], None] | None = None
        self._on_preempt: Callable[[], None] | None = None
        if auto_start:
            self.start()

    def start(self) -> None:
        if self._server is None:
            server = BusServer(
                self._session.bus, self._name, self._type, self._execute, accepts=self._callback is not None
            )
            self._server = self._session.close_on_shutdown(server)

    def _execute(self, goal: Goal) -> ActionOutcome:
        over = self._over[goal.id.id] = threading.Event()
        threading.Thread(target=self._watch_cancel, args=(goal, over), daemon=True).start()
        try:
            if self._callback is not None:
                self._goal = goal
                self._callback(self._session.messages.local(goal.message))
                unsaid = "not set by the callback"  # actionlib aborts a goal whose callback sets no result
            else:
                self._next.append(goal)
                if self._on_goal is not None:
                    self._on_goal()
                while not over.wait(CHECK) and not self._session.shutting_down.is_set():
                    pass
                unsaid = "shutdown"
        finally:
            over.set()
            del self._over[goal.id.id]
        return self._ended.pop(goal.id.id, None) or ActionOutcome(
            GoalState.ABORTED, self._result(None), unsaid
        )

    def _watch_cancel(self, goal: Goal, over: threading.Event) -> None:
        while not over.is_set() and not self._session.shutting_down.is_set():
            if goal.cancel.wait(0.02):
                if self._on_preempt is not None and goal is self._goal:
                    self._on_preempt()
                return

    def _result(self, result: Any) -> Any:
        return result if result is not None else self._session.new(f"{self._type}Result")

    def _end(self, state: GoalState, result: Any, text: str) -> None:
        if self._goal is None:
            return
        over = self._over.get(self._goal.id.id)
        if over is None:
            return  # the goal has ended already
        self._ended[self._goal.id.id] = ActionOutcome(state, self._result(result), text)
        if self._callback is None:
            over.set()

    def set_succeeded(self, result: Any = None, text: str = "") -> None:
        self._end(GoalState.SUCCEEDED, result, text)

    def set_aborted(self, result: Any = None, text: str = "") -> None:
        self._end(GoalState.ABORTED, result, text)

    def set_preempted(self, result: Any = None, text: str = "") -> None:
        self._end(GoalState.PREEMPTED, result, text)

    def publish_feedback(self, feedback: Any) -> None:
        if self._goal is not None:
            self._goal.feedback(feedback)

    def get_default_result(self) -> Any:
        return self._result(None)

    def is_preempt_requested(self) -> bool:
        return self._goal is not None and self._goal.cancel.is_set()

    def is_new_goal_available(self) -> bool:
        return bool(self._next)

    def is_active(self) -> bool:
        return self._goal is not None and not self._goal.state.is_terminal

    def accept_new_goal(self) -> Any:
        self._goal = self._next.pop(0)
        self._goal.accept()
        return self._session.messages.local(self._goal.message)

    def register_goal_callback(self, cb: Callable[[], None]) -> None:
        self._on_goal = cb

    def register_preempt_callback(self, cb: Callable[[], None]) -> None:
        self._on_preempt = cb
