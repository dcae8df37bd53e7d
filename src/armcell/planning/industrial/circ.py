"""CIRC: the tip on an arc, through an interim point or around a center."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import WORLD, InputError, Outcome
from armcell.planning.industrial.command import Command, Made
from armcell.planning.industrial.lin import along
from armcell.planning.industrial.paths import arc_around, arc_through
from armcell.planning.industrial.settings import AUXILIARY
from armcell.planning.placed import Placed
from armcell.planning.problem import INDUSTRIAL, pipelines
from armcell.planning.question import Question

Array = NDArray[np.float64]


@pipelines[INDUSTRIAL].register("CIRC")
def circ(command: Command) -> Made | Outcome:
    kind, point, link = auxiliary_point(command.question)
    placed = command.placed(link)
    start, goal = placed.pose(command.start), command.goal_pose(placed)
    arc = arc_through(start, goal, point) if kind == "interim" else arc_around(start, goal, point)
    if isinstance(arc, Outcome):
        return arc
    return along(command, arc, placed)


def auxiliary_point(question: Question) -> tuple[str, Array, str | None]:
    """Which point is given, where it is (3,) in the world [m], and the link it is for (None: not said).

    It is a parameter, or, as in MoveIt, the position of the first shape of the one position constraint of
    path constraints with the name of the point.

    Raises:
        InputError: none or two, or constraints that are none of these.
    """
    constraints, given = question.request.path_constraints, question.choice.settings.auxiliary
    if not constraints:
        if given is None:
            raise InputError("CIRC has no auxiliary point", cure=_CURE)
        return given[0], np.array(given[1]), None
    if given is not None:
        raise InputError(f"CIRC is given {given[0]} as a parameter and path constraints", cure=_CURE)
    if constraints.name not in AUXILIARY:
        raise InputError(
            f"the path constraints of CIRC are named {constraints.name!r}, not 'interim' or 'center'",
            cure=_CURE,
        )
    if len(constraints.positions) != 1 or constraints.orientations or constraints.joints:
        raise InputError(f"the {constraints.name} point of CIRC is not one position constraint", cure=_CURE)
    return constraints.name, *_place(question, constraints.positions[0])


def _place(question: Question, constraint: Any) -> tuple[Array, str | None]:
    if len(constraint.region) != 1:
        raise InputError("the region of CIRC's auxiliary point is not one shape", cure=_CURE)
    if constraint.link is not None:
        Placed(question.scene, question.request.group, constraint.link)  # an unknown link raises
    pose = question.scene.transform(WORLD, constraint.frame) @ constraint.region[0][1]
    return pose.translation, constraint.link


_CURE = (
    "give parameters={'interim': (x, y, z)} or {'center': (x, y, z)}, "
    "or path constraints of one of these names with one position constraint"
)
