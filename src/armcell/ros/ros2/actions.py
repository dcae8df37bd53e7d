"""Actions between the bus and the ROS 2 domain: a server of the bus's actions, and a client.

Source: design.ros2.org/articles/actions.html, rcl_action. The bus has ROS 1's actions, whose server decides
on a goal only after this bridge has accepted it. A goal that the server rejects is therefore aborted, and its
result contains the reason (a ROS 2 rejection cannot). The bridge rejects goals that it cannot decode.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from typing import Any

from armcell.core import ArmcellError
from armcell.ros.actions import MAX_GOALS, ActionOutcome, ActionServer, Goal, GoalState
from armcell.ros.bus import ServiceError
from armcell.ros.faults import write_failure
from armcell.ros.ros2 import names
from armcell.ros.ros2.context import Context
from armcell.ros.ros2.dds import Sample
from armcell.ros.ros2.qos import DEFAULT, LATCHED
from armcell.ros.ros2.services import Client, RequestId, Server

KEPT_FOR = 900.0  # [s] that results are kept: rcl_action's default in Humble

MAX_KEPT = 1000

ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 1, 2, 3, 4, 5, 6  # action_msgs/GoalStatus

NO_ERROR, REJECTED, UNKNOWN_GOAL, TERMINATED = 0, 1, 2, 3  # action_msgs/CancelGoal

RUNNING = {
    GoalState.PENDING: ACCEPTED,
    GoalState.ACTIVE: EXECUTING,
    GoalState.PREEMPTING: CANCELING,
    GoalState.RECALLING: CANCELING,
}


class ServedGoal:
    """Goal that a ROS 2 client has sent to an action of the bus."""

    def __init__(self, uuid: bytes, stamp: Any):
        self.uuid, self.stamp = uuid, stamp
        self.status = ACCEPTED
        self.cancelled = False  # whether a client requested it
        self.result: Any = None
        self.waiting: list[RequestId] = []  # clients that wait for the result
        self.ended: float | None = None  # [s] end of the goal, by `time.monotonic`

    @property
    def is_over(self) -> bool:
        return self.status >= SUCCEEDED


class Ros2ActionServer:
    """Server that offers one action of the bus to clients in the ROS 2 domain.

    A separate thread handles the messages of the bus's action server, in order.
    """

    busy = False  # the action's server is on the bus; once it has left, its goals cannot finish

    def __init__(self, context: Context, owner: object, name: str, type_name: str):
        self._context, self.name, self.type = context, name, type_name
        self._goals: dict[bytes, ServedGoal] = {}
        self._lock = threading.Lock()
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        bus, codec, outside = context.bus, context.codec, names.action_name(name, type_name)
        feedback = names.topic(outside + names.FEEDBACK, f"{type_name}_FeedbackMessage", "action")
        status = names.topic(outside + names.STATUS, "action_msgs/GoalStatusArray")
        for message in (feedback.message, status.message):
            codec.prepare(message)
        self._feedback = context.writer(feedback, DEFAULT)
        self._status = context.writer(status, LATCHED)
        self._goal = bus.advertise(f"{name}/goal", f"{type_name}ActionGoal", owner=owner)
        self._cancel = bus.advertise(f"{name}/cancel", "actionlib_msgs/GoalID", owner=owner)
        self._attached = [
            bus.attach(f"{name}/{part}", message, self._inbox.put, owner)
            for part, message in (
                ("result", f"{type_name}ActionResult"),
                ("feedback", f"{type_name}ActionFeedback"),
                ("status", "actionlib_msgs/GoalStatusArray"),
            )
        ]
        self._thread = threading.Thread(target=self._receive, name=f"ros2 action {name}", daemon=True)
        self._thread.start()
        self._tell()
        # Create the server that accepts goals last, so that everything else is ready for the first goal.
        self._get_server = Server(
            context, outside + names.GET_RESULT, f"{type_name}_GetResult", self._on_get, "action"
        )
        self._servers = [
            Server(context, outside + names.CANCEL_GOAL, "action_msgs/CancelGoal", self._on_cancel),
            Server(context, outside + names.SEND_GOAL, f"{type_name}_SendGoal", self._on_goal, "action"),
        ]

    def close(self) -> None:
        """Stop offering an action to ROS 2. Unfinished goals are aborted, and clients that wait for them
        receive a result.
        """
        for server in self._servers:
            server.close()
        with self._lock:
            running = [g for g in self._goals.values() if not g.is_over]
        for goal in running:
            result = self._context.codec.new(f"{self.type}Result")
            self._end(goal, ABORTED, write_failure(result, "the action's server has left"))
        self._get_server.close()
        for member in (*self._attached, self._goal, self._cancel):
            member.close()
        self._inbox.put(None)
        if self._thread is not threading.current_thread():
            self._thread.join(2.0)
        self._context.drop(self._feedback, self._status)

    # --- requests of ROS 2 clients, in the worker threads ---
    def _on_goal(self, server: Server, request: Any, asked: RequestId) -> None:
        codec, bus = self._context.codec, self._context.bus
        uuid, stamp = bytes(request.goal_id.uuid), bus.stamp()
        with self._lock:
            self._forget_old()
            running = sum(not g.is_over for g in self._goals.values())
            accepted = uuid not in self._goals and running < MAX_GOALS
            if accepted:
                self._goals[uuid] = ServedGoal(uuid, stamp)
        server.reply(asked, codec.new(f"{self.type}_SendGoal_Response", accepted, stamp))
        if accepted:
            goal_id = bus.schema.new("actionlib_msgs/GoalID", stamp, uuid.hex())
            goal = bus.schema.new(f"{self.type}ActionGoal", bus.header(), goal_id, request.goal)
            self._tell()
            self._goal.publish(goal)

    def _on_cancel(self, server: Server, request: Any, asked: RequestId) -> None:
        """Cancel the ROS 2 action goals that a cancel request selects by goal id, by time stamp or by both.

        A stamp selects all goals up to this time. A request without id and stamp cancels all goals.
        """
        codec, info = self._context.codec, request.goal_info
        uuid, stamp = bytes(info.goal_id.uuid), info.stamp.to_nsec()
        everything = not any(uuid) and not stamp
        with self._lock:
            known = self._goals.get(uuid)
            chosen = [
                g
                for g in self._goals.values()
                if not g.is_over and (everything or g.uuid == uuid or (stamp and g.stamp.to_nsec() <= stamp))
            ]
            for goal in chosen:
                goal.cancelled, goal.status = True, CANCELING
        code = NO_ERROR
        if not chosen and any(uuid):
            code = UNKNOWN_GOAL if known is None else TERMINATED
        elif not chosen:
            code = REJECTED
        infos = [self._info(goal) for goal in chosen]
        server.reply(asked, codec.new("action_msgs/CancelGoalResponse", code, infos))
        self._tell()
        for goal in chosen:
            self._cancel.publish(self._context.bus.schema.new("actionlib_msgs/GoalID", id=goal.uuid.hex()))

    def _on_get(self, server: Server, request: Any, asked: RequestId) -> None:
        uuid = bytes(request.goal_id.uuid)
        with self._lock:
            goal = self._goals.get(uuid)
            if goal is not None and not goal.is_over:
                goal.waiting.append(asked)
                return
        if goal is None:
            server.refuse(asked, "unknown goal")  # the default status 0 means unknown
        else:
            self._answer(goal, [asked])

    # --- messages of the bus's action server ---
    def _receive(self) -> None:
        while (message := self._inbox.get()) is not None:
            try:
                self._on_message(message)
            except ArmcellError as error:
                if not self._context.closed:
                    self._context.complain(f"action {self.name}", f"action {self.name}: {error}")

    def _on_message(self, message: Any) -> None:
        if message._type == f"{self.type}ActionFeedback":
            goal = self._find(message.status.goal_id.id)
            if goal is not None and not goal.is_over:
                new = self._context.codec.new
                wrapped = new(f"{self.type}_FeedbackMessage", self._uuid(goal), message.feedback)
                self._feedback.write(self._context.codec.encode(wrapped))
        elif message._type == f"{self.type}ActionResult":
            goal = self._find(message.status.goal_id.id)
            if goal is not None and not goal.is_over:
                self._end(goal, self._final(goal, GoalState(message.status.status)), message.result)
        else:
            changed = False
            for status in message.status_list:
                goal = self._find(status.goal_id.id)
                wanted = RUNNING.get(GoalState(status.status))
                if goal is not None and not goal.is_over and wanted and wanted > goal.status:
                    goal.status = wanted
                    changed = True
            if changed:
                self._tell()

    def _final(self, goal: ServedGoal, state: GoalState) -> int:
        """Return the status that ROS 2 assigns to a finished action goal.

        A goal that a newer one preempted without a cancel request counts as aborted.
        """
        if state is GoalState.SUCCEEDED:
            return SUCCEEDED
        if state in (GoalState.PREEMPTED, GoalState.RECALLED) and goal.cancelled:
            return CANCELED
        return ABORTED

    def _end(self, goal: ServedGoal, status: int, result: Any) -> None:
        with self._lock:
            goal.result, goal.status, goal.ended = result, status, time.monotonic()
            waiting, goal.waiting = goal.waiting, []
        self._answer(goal, waiting)
        self._tell()

    def _answer(self, goal: ServedGoal, waiting: list[RequestId]) -> None:
        response = self._context.codec.new(f"{self.type}_GetResult_Response", goal.status, goal.result)
        for asked in waiting:
            self._get_server.reply(asked, response)

    def _tell(self) -> None:
        """Publish the status of all goals of an action in the ROS 2 domain."""
        new = self._context.codec.new
        with self._lock:
            goals = list(self._goals.values())
        statuses = [new("action_msgs/GoalStatus", self._info(g), g.status) for g in goals]
        if not self._context.closed:
            self._status.write(self._context.codec.encode(new("action_msgs/GoalStatusArray", statuses)))

    # --- goals ---
    def _find(self, text: str) -> ServedGoal | None:
        try:
            return self._goals.get(bytes.fromhex(text))
        except ValueError:  # the goal came from a client on the bus
            return None

    def _uuid(self, goal: ServedGoal) -> Any:
        return self._context.codec.new("unique_identifier_msgs/UUID", list(goal.uuid))

    def _info(self, goal: ServedGoal) -> Any:
        return self._context.codec.new("action_msgs/GoalInfo", self._uuid(goal), goal.stamp)

    def _forget_old(self) -> None:
        over = [g for g in self._goals.values() if g.ended is not None]
        now = time.monotonic()
        for i, goal in enumerate(over):
            if now - (goal.ended or now) > KEPT_FOR or len(over) - i > MAX_KEPT:
                del self._goals[goal.uuid]


FIND = 5.0  # [s] to find the action's server and to learn whether it accepts the goal

POLL = 0.02  # [s]

DONE = {SUCCEEDED: GoalState.SUCCEEDED, CANCELED: GoalState.PREEMPTED, ABORTED: GoalState.ABORTED}


class Ros2ActionClient:
    """Action server on the bus that forwards goals to an action in the ROS 2 domain."""

    def __init__(self, context: Context, owner: object, name: str, type_name: str):
        self._context, self.name, self.type = context, name, type_name
        self._goals: dict[bytes, Goal] = {}
        outside = names.action_name(name, type_name)
        feedback = names.topic(outside + names.FEEDBACK, f"{type_name}_FeedbackMessage", "action")
        self._message = feedback.message
        context.codec.prepare(feedback.message)
        self._send = Client(context, outside + names.SEND_GOAL, f"{type_name}_SendGoal", "action")
        self._cancel = Client(context, outside + names.CANCEL_GOAL, "action_msgs/CancelGoal")
        self._get = Client(context, outside + names.GET_RESULT, f"{type_name}_GetResult", "action")
        self._feedback = context.reader(feedback, DEFAULT, self._on_feedback)
        self._server = ActionServer(context.bus, name, type_name, self._execute, True, owner, accepts=False)

    @property
    def server_is_ready(self) -> bool:
        """Return whether the server of an action has been discovered in the ROS 2 domain."""
        return self._send.service_is_ready and self._get.service_is_ready

    @property
    def busy(self) -> bool:
        """Return whether clients on the bus are waiting for results of the ROS 2 action."""
        return bool(self._goals)

    def close(self) -> None:
        self._server.close()
        for client in (self._send, self._cancel, self._get):
            client.close()
        self._context.drop(self._feedback)

    def _execute(self, goal: Goal) -> ActionOutcome:
        uuid = os.urandom(16)
        self._goals[uuid] = goal
        try:
            return self._follow(goal, uuid)
        except ArmcellError as error:
            return ActionOutcome(
                GoalState.ABORTED, self._context.bus.schema.new(f"{self.type}Result"), str(error)
            )
        finally:
            self._goals.pop(uuid, None)

    def _follow(self, goal: Goal, uuid: bytes) -> ActionOutcome:
        new = self._context.codec.new
        goal_id = new("unique_identifier_msgs/UUID", list(uuid))
        asked = self._send.call(new(f"{self.type}_SendGoal_Request", goal_id, goal.message), FIND)
        if not asked.accepted:
            empty = self._context.bus.schema.new(f"{self.type}Result")
            return ActionOutcome(GoalState.REJECTED, empty, "the ROS 2 server rejected the goal")
        goal.accept()
        answer = self._get.call_async(new(f"{self.type}_GetResult_Request", goal_id))
        cancelled, seen = False, time.monotonic()
        while (response := answer.wait(POLL)) is None:
            if goal.cancel.is_set() and not cancelled:
                cancelled = True
                info = new("action_msgs/GoalInfo", goal_id)
                self._cancel.call_async(new("action_msgs/CancelGoalRequest", info))
            seen = time.monotonic() if self.server_is_ready else seen
            if self._context.closed or time.monotonic() - seen > FIND:
                raise ServiceError("the ROS 2 server went away")
        return ActionOutcome(DONE.get(response.status, GoalState.ABORTED), response.result)

    def _on_feedback(self, sample: Sample) -> None:
        try:
            message = self._context.codec.decode(self._message, sample.data)
        except ArmcellError as error:
            self._context.complain(f"feedback {self.name}", f"action {self.name}: {error}")
            return
        goal = self._goals.get(bytes(message.goal_id.uuid))
        if goal is not None:
            goal.feedback(message.feedback)
