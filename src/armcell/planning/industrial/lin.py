"""LIN: the tip on a straight line, position and orientation together, by a trapezoid of its speed."""

from __future__ import annotations

import numpy as np

from armcell.core import ErrorCode, Outcome
from armcell.planning.industrial.command import AT_GOAL, Command, Made, timed
from armcell.planning.industrial.follow import follow, solver_for
from armcell.planning.industrial.limits import within_limits
from armcell.planning.industrial.paths import Line, TipPath
from armcell.planning.placed import Placed
from armcell.planning.problem import INDUSTRIAL, pipelines


@pipelines[INDUSTRIAL].register("LIN")
def lin(command: Command) -> Made | Outcome:
    placed = command.placed()
    line = Line(placed.pose(command.start), command.goal_pose(placed))
    if max(line.length, line.angle) > AT_GOAL:
        return along(command, line, placed)
    joints = command.goal_joints
    if joints is None or np.max(np.abs(joints - command.start)) <= AT_GOAL:
        return command.standing()
    text = f"has nowhere to go: the goal has {placed.name} where it is, with other joint positions (use PTP)"
    return Outcome(ErrorCode.PLANNING_FAILED, text, {"fraction": 0.0})


def along(command: Command, path: TipPath, placed: Placed) -> Made | Outcome:
    """The motion with the tip on a way, within the limits of the joints."""
    ik = solver_for(placed, command.request.group)
    curve = follow(path, placed, ik, command.start, command.goal_joints, command.stopped)
    if isinstance(curve, Outcome):
        return curve
    names = command.question.joint_names
    trajectory = timed(curve, command.along(path.length, path.angle), names)
    beyond = within_limits(command.question.scene.model, trajectory, command.request)
    return Made(curve, trajectory, placed) if beyond is None else beyond
