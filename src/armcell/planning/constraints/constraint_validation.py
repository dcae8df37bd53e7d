"""Validation of constraints: unknown names, impossible tolerances, contradictions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    Constraints,
    InputError,
    JointConstraint,
    OrientationConstraint,
    PositionConstraint,
    UnknownNameError,
)
from armcell.kinematics import ik_solver
from armcell.planning.constraints.evaluation import PARAMETERIZATIONS, distance_to_shape, region_distance
from armcell.planning.constraints.visibility import check_visibility
from armcell.planning.moved_frame import MovedFrame
from armcell.scene import PlanningScene

Array = NDArray[np.float64]


def check_constraints(scene: PlanningScene, group: str, constraints: Constraints) -> None:
    """Validate constraints: raise an error if one of them is invalid in every scene.

    Raises:
        UnknownNameError: no such joint, link, frame or parameterization.
        InputError: a joint or link that the group does not move, an impossible tolerance or region.
    """
    names = scene.model.group(group).joint_names
    for joint in constraints.joints:
        if joint.joint not in names:
            scene.model.joint(joint.joint)
            raise InputError(f"a constraint names joint {joint.joint!r}, which group {group!r} does not move")
        _tolerances(f"joint {joint.joint}", (joint.tolerance_above, joint.tolerance_below))
        if not np.isfinite(joint.position):
            raise InputError(f"the constraint of joint {joint.joint} has a position that is not finite")
    for item in (*constraints.positions, *constraints.orientations):
        ik_solver(
            scene.model, group, MovedFrame(scene, group, item.link).link
        )  # raises if the group does not move the link
        scene.frame_pose(item.frame)
    for position in constraints.positions:
        if not position.region:
            raise InputError("a position constraint has no region", hint="give it a shape and its pose")
        if np.shape(position.point) != (3,) or not np.all(np.isfinite(position.point)):
            raise InputError(f"a position constraint's point is {position.point!r}, three numbers are needed")
        for shape, _ in position.region:
            distance_to_shape(shape, np.zeros(3))
    for orientation in constraints.orientations:
        if np.shape(orientation.tolerance) != (3,):
            raise InputError(
                f"an orientation constraint's tolerance is {orientation.tolerance!r}",
                hint="give three angles, about x, y and z",
            )
        _tolerances("an orientation", orientation.tolerance)
        if orientation.parameterization not in PARAMETERIZATIONS:
            raise UnknownNameError("parameterization", orientation.parameterization, PARAMETERIZATIONS)
    for view in constraints.visibilities:
        check_visibility(scene, view)


def _tolerances(what: str, values: tuple[float, ...]) -> None:
    if any(np.isnan(v) or v < 0 for v in values):
        raise InputError(f"the constraint of {what} has a tolerance below zero or not a number: {values}")


def contradiction(scene: PlanningScene, group: str, constraints: Constraints) -> str:
    """Validate the constraints of a request together. If they contradict each other, explain why no state
    satisfies all of them.

    Return "" if the checks find no contradiction.
    """
    if text := contradictory_joint(scene, group, constraints.joints):
        return text
    for c in constraints.positions:
        if text := _out_of_reach(scene, group, c):
            return text
    seen: dict[str, OrientationConstraint] = {}
    for o in constraints.orientations:
        name = MovedFrame(scene, group, o.link).name
        if (before := seen.setdefault(name, o)) is not o and (text := _apart(scene, name, before, o)):
            return text
    return ""


def joint_ranges(
    scene: PlanningScene, group: str, constraints: tuple[JointConstraint, ...]
) -> tuple[Array, Array]:
    """Intersect the joint limits of a group with its joint constraints, to validate the constraints.

    Return the lower and upper bounds (n,), (n,).
    """
    names = scene.model.group(group).joint_names
    columns = scene.model.columns(names)
    low, high = scene.model.lower[columns].copy(), scene.model.upper[columns].copy()
    for c in constraints:
        k = names.index(c.joint)
        low[k] = max(low[k], c.position - c.tolerance_below)
        high[k] = min(high[k], c.position + c.tolerance_above)
    return low, high


def contradictory_joint(scene: PlanningScene, group: str, constraints: tuple[JointConstraint, ...]) -> str:
    """Validate the joint constraints of a group: if they are contradictory, explain why a joint has no
    allowed position.

    Return "" if every joint has an allowed position.
    """
    names = scene.model.group(group).joint_names
    low, high = joint_ranges(scene, group, constraints)
    for k in np.flatnonzero(low > high + 1e-9):
        limits = scene.model.joint(names[k]).limits
        asked = " and ".join(
            f"[{c.position - c.tolerance_below:.4g}, {c.position + c.tolerance_above:.4g}]"
            for c in constraints
            if c.joint == names[k]
        )
        return (
            f"no position of joint {names[k]} is in {asked} and within its limits "
            f"[{limits.lower:.4g}, {limits.upper:.4g}]"
        )
    return ""


def _out_of_reach(scene: PlanningScene, group: str, c: PositionConstraint) -> str:
    moved_frame = MovedFrame(scene, group, c.link)
    chain = ik_solver(scene.model, group, moved_frame.link).chain_data.chain
    matrix = chain.inverse_base.reshape(3, 4)
    first_joint = -matrix[:, :3].T @ matrix[:, 3]
    reach = chain.reach + float(np.linalg.norm(moved_frame.T_link_point.apply(c.point)))
    distance = region_distance(scene, c, first_joint)
    if distance <= reach:
        return ""
    return (
        f"the region of {moved_frame.name} is out of reach: {distance:.2f} m from the first joint, "
        f"the arm reaches {reach:.2f} m at most"
    )


def _apart(scene: PlanningScene, name: str, a: OrientationConstraint, b: OrientationConstraint) -> str:
    """Validate two orientation constraints on the same link: if they are contradictory, explain why.

    Return "" if a rotation can satisfy both.
    """
    one, other = (scene.frame_pose(c.frame).rotation @ c.rotation for c in (a, b))
    angle = float(np.linalg.norm((one.inverse() @ other).log()))
    # A rotation vector with components below the tolerances is at most as long as the norm of the
    # tolerances. (The total of angles about x, y and z is at most the sum of the tolerances.)
    most = sum(
        float(np.linalg.norm(c.tolerance))
        if c.parameterization == "rotation_vector"
        else float(np.sum(c.tolerance))
        for c in (a, b)
    )
    if angle <= most:
        return ""
    return (
        f"two orientations of {name} are {np.rad2deg(angle):.0f} deg apart, "
        f"their tolerances allow {np.rad2deg(most):.0f} deg"
    )
