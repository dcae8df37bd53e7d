"""Inverse kinematics with a free rotation about one axis, for arms with fewer than six joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import SE3, UnknownNameError
from armcell.core.checks import float_array, require
from armcell.kinematics.ik.numeric import NumericIK
from armcell.model import Joint, Link, RobotModel

SOLUTIONS = 16  # of the arm, among which distinct angles are searched
APART = 1e-3  # [rad] distinct angles


def free_axis_angles(
    model: RobotModel, group: str, tip_link: str, T_tip_axis: SE3, T_world_axis: SE3, reference: ArrayLike
) -> Iterator[float]:
    """Solve the inverse kinematics of a goal that may rotate freely about one axis: yield the rotation angles
    [rad] at which the arm reaches the goal.

    The z axis of the frame `axis` is the axis of rotation. The tip reaches the pose
    `T_world_axis @ Rz(angle) @ inverse(T_tip_axis)` within the joint limits. A continuous joint about the
    axis extends the chain, so that an arm with five joints has a finite number of solutions.

    Args:
        reference: positions (dof,) of all joints of the model.
    Raises:
        UnknownNameError: no such group or link.
        InputError: an axis is not a pose, or the reference is not (dof,) finite numbers.
    """
    arm = model.group(group)
    if tip_link not in model.links:
        raise UnknownNameError("link", tip_link, model.links)
    require(isinstance(T_tip_axis, SE3) and isinstance(T_world_axis, SE3), "the axes must be poses (SE3)")
    start = np.append(float_array(reference, (model.dof,), "reference"), 0.0)
    spin = Joint(f"{tip_link}/spin", "continuous", tip_link, f"{tip_link}/axis", T_tip_axis, axis=(0, 0, 1))
    names = (*arm.joint_names, spin.name)
    extended = replace(
        model,
        links={**model.links, spin.child: Link(spin.child)},
        joints={**model.joints, spin.name: spin},
        groups={**model.groups, group: replace(arm, joint_names=names, tip_link=spin.child)},
    )
    solver = NumericIK(extended, group, spin.child)
    found: list[float] = []
    for q in islice(solver.solutions(T_world_axis, start, np.random.default_rng(0)), SOLUTIONS):
        angle = -float(q[-1])
        if all(abs(np.sin((angle - other) / 2)) > APART / 2 for other in found):
            found.append(angle)
            yield angle
