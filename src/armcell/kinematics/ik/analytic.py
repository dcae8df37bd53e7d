"""Analytic inverse kinematics for arms with the kinematic structure of Universal Robots.

The solver finds all (up to eight) solution branches exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import InputError
from armcell.kinematics.ik.chain import chain_of
from armcell.kinematics.ik.full_turns import wrap_and_sort_solutions
from armcell.kinematics.ik.solver import ChainData, IKSolver, ik_solvers, other_columns, tip_of
from armcell.kinematics.ik.ur import BRANCHES, ur_branches, ur_geometry
from armcell.kinematics.tree import FIXED, kinematic_tree
from armcell.model import RobotModel

Array = NDArray[np.float64]


@ik_solvers.register("analytic")
class AnalyticIK(IKSolver):
    """Analytic IK solver for UR arms, which returns up to eight solutions, the one nearest to the reference
    first.

    Raises:
        InputError: the kinematic structure of the chain is not that of a UR arm.
    """

    method = "analytic"
    nearest_first = True

    @classmethod
    def solves(cls, model: RobotModel, group: str, tip_link: str | None = None) -> bool:
        return is_analytic(model, group, tip_link)

    def _prepare(self, positions: Array) -> ChainData:
        prepared = super()._prepare(positions)
        geometry = ur_geometry(prepared.chain)
        if geometry is None:
            raise InputError(
                f"group {self.group.name!r} of {self.model.name!r} is not built like a UR arm",
                hint="use ik_solver, which takes the solver that fits",
            )
        return replace(prepared, geometry=geometry)

    def _search(self, prepared: ChainData, goal: Array, reference: Array, rng: np.random.Generator | None,
                outside: dict[str, int]) -> Iterator[Array]:  # fmt: skip
        chain, found = prepared.chain, np.empty((BRANCHES, 6))
        forbidden = np.zeros(6, dtype=np.int64)
        count = ur_branches(prepared.geometry, goal, reference, found)
        yield from found[
            : wrap_and_sort_solutions(found, count, reference, chain.bounds, chain.turning, forbidden)
        ]
        outside.update({self.joint_names[k]: int(forbidden[k]) for k in np.flatnonzero(forbidden)})


def is_analytic(model: RobotModel, group: str, tip_link: str | None = None) -> bool:
    """Return whether analytic IK can be used: the kinematic chain of the planning group must have the
    structure of a UR arm.

    The result is True only if it does not depend on the positions of the robot's other joints.
    """
    names, tip = model.group(group).joint_names, tip_of(model, group, tip_link)
    tree = kinematic_tree(model)
    columns, others = set(model.columns(names)), set(other_columns(model, names, tip))
    moving = [int(tree.column[j]) for j in tree.path_to(tip) if tree.kind[j] != FIXED]
    own = [k for k, column in enumerate(moving) if column in columns]
    if len(own) != 6 or others & set(moving[own[0] : own[-1]]):
        return False
    return ur_geometry(chain_of(tree, names, tip, model.default_positions())) is not None
