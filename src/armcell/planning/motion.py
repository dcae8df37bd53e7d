"""The last steps of a plan: a path proven, timed, slowed, and led to from where the robot is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting import certify_from_rest
from armcell.core import ErrorCode, JointTrajectory, Outcome
from armcell.planning.finish import finish, torque_model
from armcell.planning.placed import Placed
from armcell.planning.question import Question
from armcell.planning.speed import slowed
from armcell.timing import BlendedPath, TimingSettings, TorqueLimitError, jerk_limited, parameterize

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """A path (k, n) that is proven (`done`), with its trajectory if timing was asked for; or why not."""

    waypoints: Array
    trajectory: JointTrajectory | None = None
    done: bool = False
    why: str = ""
    words: str = ""  # what a caller must know about a motion that is done
    roomy: bool = True  # it keeps the scene's padding all along, not only at what was looked at


def timed_motion(question: Question, checker: KernelChecker, waypoints: Array) -> Motion | Outcome:
    """Prove and time a path; an outcome where no other path would do either."""
    request = question.request
    if question.workspace is not None and (q := question.workspace.left_at(waypoints)) is not None:
        return Motion(waypoints, why=f"the paths found leave the workspace: {question.workspace.describe(q)}")
    torque = torque_model(question.scene, question.joint_names) if request.torque_limits else None
    padded = question.scene.padding > 0 or any(p > 0 for p in question.scene.link_padding.values())
    try:
        finished = finish(
            checker, waypoints, request.velocity_scaling, request.acceleration_scaling,
            torque=torque, jerk_limits=request.jerk_limits,
            with_room=partial(_keeps, checker) if padded else None,
        )  # fmt: skip
    except TorqueLimitError as error:
        evidence = {"joint": error.joint, "torque": error.torque, "limit": error.limit}
        return Outcome(ErrorCode.PLANNING_FAILED, str(error), evidence)
    if finished.trajectory is None:
        return Motion(waypoints)
    made = completed(question, checker, waypoints, finished.trajectory)
    return replace(made, roomy=finished.roomy or not padded)


def _keeps(checker: KernelChecker, chords: Array, slack: Array | None) -> bool:
    return checker.certify(chords, slack, padded=True, evidence=False).free


def completed(
    question: Question, checker: KernelChecker, waypoints: Array, trajectory: JointTrajectory
) -> Motion:
    """A proven motion led to from where the robot is, and slowed to the speed that the request allows."""
    request, words = question.request, ""
    if question.lead_in is not None:
        lead = lead_in(question, checker)
        if lead is None:
            words = "the motion begins at the start within limits, the way to it is not free"
        else:
            waypoints = np.vstack([question.lead_in[:-1], waypoints])
            trajectory = joined(lead, trajectory)
            words = left_first(question)
    elif "start_repaired" in question.evidence:
        words = "the motion begins at the repaired start, not where the robot is"
    if request.max_cartesian_speed is not None:
        placed = Placed(question.scene, request.group, request.speed_link)
        trajectory = slowed(trajectory, placed, request.max_cartesian_speed)
    timing = "timing" in question.adapters
    return Motion(waypoints, trajectory if timing else None, done=True, words=words)


def left_first(question: Question) -> str:
    """What a caller must know of a motion that leads out of contact."""
    contacts = question.evidence.get("start_repaired", {}).get("contacts", ())
    return "the motion first leaves contact: " + "; ".join(c.describe() for c in contacts) if contacts else ""


def lead_in(question: Question, checker: KernelChecker) -> JointTrajectory | None:
    """From where the robot is to the repaired start, both at rest; None where that is not free."""
    lead = question.lead_in
    if lead is None:
        return None
    checker = checker.without_room or checker  # the way to where room between arms can be kept
    if not certify_from_rest(checker, lead, deepest=np.inf, evidence=False).free:
        return None
    names, request = question.joint_names, question.request
    velocity = checker.model.limits(names, "velocity") * request.velocity_scaling
    acceleration = checker.model.limits(names, "acceleration") * request.acceleration_scaling
    path = BlendedPath(lead, 0.0)
    if request.jerk_limits:
        return jerk_limited(path, names, velocity, acceleration, checker.model.limits(names, "jerk"))
    torque = torque_model(question.scene, names) if request.torque_limits else None
    return parameterize(path, names, velocity, acceleration, TimingSettings(), torque)


def joined(first: JointTrajectory, second: JointTrajectory) -> JointTrajectory:
    """One motion after the other; they meet at rest."""

    def both(a: Array | None, b: Array | None) -> Array | None:
        return None if a is None or b is None else np.vstack([a, b[1:]])

    return replace(
        second,
        times=np.concatenate([first.times, first.times[-1] + second.times[1:]]),
        positions=np.vstack([first.positions, second.positions[1:]]),
        velocities=both(first.velocities, second.velocities),
        accelerations=both(first.accelerations, second.accelerations),
    )
