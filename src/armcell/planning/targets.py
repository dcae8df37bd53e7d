"""What people give as a target, as a goal: a name, a pose, joint values in any of their forms."""

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
    """The goal that a target stands for.

    Args:
        target: a named state; a pose of the group's tip in the world; joint values, all of the group's in its
            order (list, tuple, array) or some by name (mapping, JointState); or a goal, which stays as it is.
    Raises:
        InputError: another number of values than the group has joints, values that are no numbers, or
            something that is none of these.
        UnknownNameError: a named state or joint that does not exist.
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
            f"a {type(target).__name__} is no target",
            cure="give a named state, a pose (SE3), joint values or a goal",
        ) from None
    if values.shape != (len(names),):
        raise InputError(
            f"{values.shape} joint values given, group {group!r} has {len(names)} joints",
            cure=f"its order is {', '.join(names)}; to give some of them, give them by name",
        )
    return JointGoal(JointState(names, values))
