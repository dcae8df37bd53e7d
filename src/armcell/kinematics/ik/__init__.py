"""Inverse kinematics solvers; `ik_solver` selects the best solver for a planning group."""

from __future__ import annotations

from functools import lru_cache

from armcell.kinematics.ik.analytic import AnalyticIK, is_analytic
from armcell.kinematics.ik.numeric import NumericIK
from armcell.kinematics.ik.solver import IKSettings, IKSolver
from armcell.model import RobotModel


@lru_cache(maxsize=128)
def ik_solver(
    model: RobotModel, group: str, tip_link: str | None = None, settings: IKSettings = IKSettings()
) -> IKSolver:
    """Return the inverse kinematics solver for a planning group: analytic if possible.

    The solver is cached, because robot models are immutable.

    Args:
        model: the robot.
        group: name of the planning group.
        tip_link: link to place; by default the group's tip link.
        settings: tolerances and limits of the search.
    Raises:
        UnknownNameError: the group or link does not exist.
        InputError: the group has no tip link and `tip_link` is None, or no joint of the group moves the link.
    """
    kind = AnalyticIK if is_analytic(model, group, tip_link) else NumericIK
    return kind(model, group, tip_link, settings)


__all__ = ["AnalyticIK", "IKSettings", "IKSolver", "NumericIK", "ik_solver"]
