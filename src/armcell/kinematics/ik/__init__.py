"""Inverse kinematics: `ik_solver` gives the solver that fits a group of a robot."""

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
    """The solver for a planning group and a link (its tip by default): analytic where the arm allows it.

    Made once and kept: models are frozen.

    Raises:
        UnknownNameError: no such group or link.
        InputError: the group has no tip and no link is named, or none of its joints moves the link.
    """
    kind = AnalyticIK if is_analytic(model, group, tip_link) else NumericIK
    return kind(model, group, tip_link, settings)


__all__ = ["AnalyticIK", "IKSettings", "IKSolver", "NumericIK", "ik_solver"]
