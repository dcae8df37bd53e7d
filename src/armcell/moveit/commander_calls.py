"""Functions that moveit_commander's classes share: goals, results and constraints."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.moveit.session import CHECK, Session, current_session
from armcell.ros import ActionClient
from armcell.ros.actions import ClientGoalHandle, GoalState
from armcell.scene import PlanningScene

SUCCESS, FAILURE, PREEMPTED = 1, 99999, -7  # moveit_msgs/MoveItErrorCodes


def measured_scene() -> PlanningScene:
    """Return the planning scene with the measured robot state, which several calls of
    moveit_commander need.
    """
    return current_session().served.cell.scene()


def send(session: Session, action: str, type_name: str, goal: Any) -> ClientGoalHandle:
    """Send the goal of a moveit_commander call to its action server, using the client of the session.

    Raises:
        RuntimeError: the action has no server.
    """
    if action not in session.clients:
        session.clients[action] = ActionClient(session.bus, action, type_name)
    name = session.clients[action].name
    if not any(t.name == f"{name}/goal" and t.subscribers for t in session.bus.topics()):
        raise RuntimeError(f"Unable to connect to move_group action server '{action}' within allotted time")
    return session.clients[action].send_goal(session.messages.local(goal))


def wait_for_result(session: Session, sent: ClientGoalHandle) -> Any:
    """Wait until the action goal of a moveit_commander call has ended, and return its result.

    Raises:
        KeyboardInterrupt: the user pressed Ctrl-C, or the session is shutting down.
    """
    try:
        while not sent.wait(CHECK):
            if session.shutting_down.is_set() or not session.served.is_running:
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        sent.cancel()
        session.shut_down("interrupted")
        raise
    if sent.state is not GoalState.SUCCEEDED and sent.text and not session.has_logged(sent.text):
        session.say("WARN", sent.text)
    return session.messages.local(sent.result)


def joint_constraints(session: Session, values: dict[str, float], tolerance: float) -> Any:
    """Create the goal constraints for given joint positions that any call of moveit_commander's classes
    sends.

    Args:
        values: joint name -> position [rad or m].
        tolerance: tolerance below and above each position [rad or m].
    """
    joints = [
        session.new("moveit_msgs/JointConstraint", name, float(value), tolerance, tolerance, 1.0)
        for name, value in values.items()
    ]
    return session.new("moveit_msgs/Constraints", joint_constraints=joints)


def pose_constraints(
    session: Session, link: str, target: Any, position: float | None, orientation: float | None
) -> Any:
    """Create the goal constraints for the pose of a link that any call of moveit_commander's classes sends.

    Args:
        target: a PoseStamped.
        position: radius [m] of the sphere of valid positions; None leaves the position free.
        orientation: tolerance [rad] about each axis; None leaves the orientation free.
    """
    found = session.new("moveit_msgs/Constraints")
    if position is not None:
        ball = session.new("shape_msgs/SolidPrimitive", type=2, dimensions=[float(position)])
        upright = session.new("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)
        p = target.pose.position
        center = session.new("geometry_msgs/Pose", session.new("geometry_msgs/Point", p.x, p.y, p.z), upright)
        volume = session.new("moveit_msgs/BoundingVolume", [ball], [center], [], [])
        offset = session.new("geometry_msgs/Vector3")
        found.position_constraints = [
            session.new("moveit_msgs/PositionConstraint", target.header, link, offset, volume, 1.0)
        ]
    if orientation is not None:
        q = target.pose.orientation
        if not np.isfinite([q.x, q.y, q.z, q.w]).all() or not any((q.x, q.y, q.z, q.w)):
            session.hint("quaternion", "a target's orientation is all zeros; taken as no rotation (w = 1)")
            q = session.new("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)
        found.orientation_constraints = [
            session.new(
                "moveit_msgs/OrientationConstraint", target.header, q, link, *3 * [orientation], weight=1.0
            )
        ]
    return found
