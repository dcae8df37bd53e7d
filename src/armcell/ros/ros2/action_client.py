"""Access for clients on the bus to actions that are served in the ROS 2 domain."""

from __future__ import annotations

import os
import time

from armcell.core import ArmcellError
from armcell.ros.actions import ActionOutcome, ActionServer, Goal, GoalState
from armcell.ros.bus import ServiceError
from armcell.ros.ros2 import names
from armcell.ros.ros2.action_server import ABORTED, CANCELED, SUCCEEDED
from armcell.ros.ros2.context import Context
from armcell.ros.ros2.dds import Sample
from armcell.ros.ros2.qos import DEFAULT
from armcell.ros.ros2.services import Client

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
