"""Conversion of user targets to goals: a named state, a pose, or joint values in any form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
    ConstraintGoal,
    Goal,
    InputError,
    JointGoal,
    JointState,
    NamedGoal,
    PoseGoal,
)
from armcell.model import RobotModel

Target = str | SE3 | JointState | Mapping[str, float] | Sequence[float] | NDArray[np.float64] | Goal


def goal_of(model: RobotModel, group: str, target: Target) -> Goal:
    """Convert a target that a user gives (a named state, a pose or joint values) to a goal of a planning
    group.

    Args:
        target: a named state; a pose of the group's tip in the world; joint values, all of the group's in
            its order (list, tuple, array) or some by name (mapping, JointState); or a goal, which is
            returned unchanged.
    Raises:
        InputError: the number of values differs from the group's number of joints, a value is not a number,
            or the target has an unsupported type.
        UnknownNameError: the named state or joint does not exist.
    """
    names = model.group(group).joint_names
    if isinstance(target, JointGoal | PoseGoal | NamedGoal | ConstraintGoal):
        return target
    if isinstance(target, SE3):
        return PoseGoal(target)
    if isinstance(target, str):
        model.named_state(group, target)
        return NamedGoal(target)
    if isinstance(target, JointState):
        return JointGoal(target)
    if isinstance(target, Mapping):
        for name in target:
            model.joint(name)
        return JointGoal(JointState.from_mapping(target))
    try:
        values = np.asarray(target, dtype=float)
    except (TypeError, ValueError):
        raise InputError(
            f"a {type(target).__name__} is not a valid target",
            hint="give a named state, a pose (SE3), joint values or a goal",
        ) from None
    if values.shape != (len(names),):
        raise InputError(
            f"{values.shape} joint values given, group {group!r} has {len(names)} joints",
            hint=f"its order is {', '.join(names)}; to give some of them, give them by name",
        )
    return JointGoal(JointState(names, values))
