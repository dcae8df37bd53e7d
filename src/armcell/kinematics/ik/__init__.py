"""Inverse kinematics solvers; `ik_solver` selects the best solver for a planning group."""

from __future__ import annotations

from functools import lru_cache

from armcell.core import InputError
from armcell.kinematics.ik.analytic import AnalyticIK
from armcell.kinematics.ik.numeric import NumericIK, TurnedPose, poses_about_axis
from armcell.kinematics.ik.solver import POSE_JOINTS, IKSettings, IKSolver, ik_solvers
from armcell.model import RobotModel


@lru_cache(maxsize=128)
def ik_solver(
    model: RobotModel, group: str, tip_link: str | None = None, settings: IKSettings = IKSettings()
) -> IKSolver:
    """Select the inverse kinematics solver for a planning group, analytic or numeric.

    The robot may name the solver (`ik_solvers` in robot.yaml); otherwise it is analytic if possible, else
    numeric. The solver is cached, because robot models are immutable.

    Args:
        model: the robot.
        group: name of the planning group.
        tip_link: link to place; by default the group's tip link.
        settings: tolerances and limits of the search.
    Raises:
        UnknownNameError: the group or link does not exist.
        InputError: the group has no tip link and `tip_link` is None, or no joint of the group moves the link;
            the solver that the robot names does not exist or cannot solve the group.
    """
    named = model.group(group).ik_solver
    if named:
        kind = ik_solvers[named]
        if not kind.solves(model, group, tip_link):
            raise InputError(
                f"IK solver {named!r} cannot solve group {group!r} of {model.name!r}",
                hint="name another one under 'ik_solvers' in robot.yaml, or none",
            )
        return kind(model, group, tip_link, settings)
    kind = next(k for k in (AnalyticIK, NumericIK) if k.solves(model, group, tip_link))
    return kind(model, group, tip_link, settings)


__all__ = [
    "POSE_JOINTS",
    "AnalyticIK",
    "IKSettings",
    "IKSolver",
    "NumericIK",
    "TurnedPose",
    "ik_solver",
    "ik_solvers",
    "poses_about_axis",
]
