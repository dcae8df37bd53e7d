"""The plan library: finished motions in a folder, proven again in the present scene before they are reused.

A motion is looked for by robot, group and goal, among those that start near the present start. What is still
free is kept; where something is in the way now, the part around it is planned anew.
"""

from __future__ import annotations

import json
import logging
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armcell.collision.arms import arms_of
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    ADAPTERS,
    ConstraintGoal,
    ErrorCode,
    InputError,
    JointGoal,
    JointPath,
    JointState,
    NamedGoal,
    PlanRequest,
    PlanResult,
    PoseGoal,
)
from armcell.model import RobotModel
from armcell.planning.apart import room_between
from armcell.planning.fingerprint import fingerprint
from armcell.planning.finish import clearance_along, finish, torque_model
from armcell.planning.goal_regions import reaches
from armcell.planning.pipeline import plan
from armcell.planning.problem import (
    INDUSTRIAL,
    Problem,
    find_planner,
    pipeline_for,
    sampling_bounds,
)
from armcell.planning.simplify import simplify
from armcell.scene import PlanningScene
from armcell.timing import TorqueLimitError, check_scaling

log = logging.getLogger(__name__)

Array = NDArray[np.float64]

VERSION = 1
MAX_BYTES = 2_000_000
MAX_WAYPOINTS = 10_000
POSE_TOLERANCE = (1e-4, 1e-3)  # [m], [rad] that inverse kinematics may leave, where a goal allows less


@dataclass
class LibraryStatistics:
    """How the requests so far were answered."""

    hits: int = 0  # a stored motion, proven again
    repairs: int = 0  # a stored motion with parts planned anew
    misses: int = 0  # planned from nothing
    passed_on: int = 0  # requests that are not stored: with constraints, a workspace, a speed limit, adapters
    unreadable: int = 0  # files that were left out


@dataclass(frozen=True, eq=False)
class _Stored:
    """A motion of the library: waypoints (k, n) of the group's joints, and the scene it was made in."""

    scene: str
    waypoints: Array


class PlanLibrary:
    """A folder of motions, one JSON file each.

    Args:
        start_region: how far each joint may be from a stored motion's start [rad or m].
        most: motions kept for one goal; the oldest are deleted.
    """

    def __init__(self, folder: str | Path, start_region: float = 0.1, most: int = 16):
        if not (np.isfinite(start_region) and start_region >= 0):
            raise InputError(f"start_region is {start_region:g}, it must be a number >= 0")
        if most < 1:
            raise InputError(f"most is {most}, a library keeps at least one motion per goal")
        self.folder, self.start_region, self.most = Path(folder), start_region, most
        self.statistics = LibraryStatistics()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as error:
            raise InputError(f"cannot be a plan library's folder: {error}", file=folder) from None

    def plan(
        self, scene: PlanningScene, request: PlanRequest, cancel: threading.Event | None = None
    ) -> PlanResult:
        """As `planning.plan`, but a stored motion is used where there is one that can be proven.

        `evidence["library"]` says what was done: "hit", "repaired" or "planned".
        """
        began = time.monotonic()
        if _asks_more(request):
            self.statistics.passed_on += 1
            return plan(scene, request, cancel)
        check_scaling(request.velocity_scaling, "velocity scaling")
        check_scaling(request.acceleration_scaling, "acceleration scaling")
        find_planner(request.pipeline_id, request.planner_id)  # misuse is said also where nothing is planned
        group = scene.model.group(request.group)
        here = scene
        if request.start is not None:
            here = replace(scene, positions=scene.state.updated(request.start).positions)
        problem = _problem_key(scene.model, request)
        found = self._reused(here, request, problem, began, cancel)
        if found is None:
            result = plan(scene, request, cancel)
            self.statistics.misses += 1
            if result.ok and result.path is not None:
                self._store(problem, here, group.joint_names, result.path.waypoints)
            return replace(result, evidence={**result.evidence, "library": "planned"})
        return found

    # --- reuse ---
    def _reused(
        self, scene: PlanningScene, request: PlanRequest, problem: str, began: float,
        cancel: threading.Event | None,
    ) -> PlanResult | None:  # fmt: skip
        """A stored motion for this start and goal, proven or repaired; None: none can be used."""
        names = scene.model.group(request.group).joint_names
        start = scene.positions[scene.model.columns(names)]
        world = _scene_key(scene)
        near = [
            s for s in self._stored(problem, scene.model, names)
            if np.max(np.abs(s.waypoints[0] - start)) <= self.start_region
            and _reaches(scene, request, names, s.waypoints[-1])
        ]  # fmt: skip
        if not near or not names:
            return None
        near.sort(key=lambda s: (s.scene != world, float(np.max(np.abs(s.waypoints[0] - start)))))
        checker = KernelChecker(scene, names)
        if checker.touches(start):
            return None  # the pipeline says what touches
        checker.relax_margins(start)
        arms, ends = arms_of(scene.model, request.group), [s.waypoints[-1] for s in near]
        room = room_between(scene, arms, checker, start, ends, request.arm_clearance)
        if room is not None:
            checker = room.kept_by(checker)
        motions = [np.vstack([start, s.waypoints[1:]]) for s in near]
        for waypoints in motions:
            if checker.certify(waypoints, padded=True, evidence=False).free:
                result = _finished(checker, scene, request, waypoints, began, "hit")
                if result is not None:
                    self.statistics.hits += 1
                    return result
        for waypoints in motions[:2]:
            whole = _repaired(checker, scene, request, waypoints, began, cancel)
            result = None if whole is None else _finished(checker, scene, request, whole, began, "repaired")
            if result is not None and result.path is not None:
                self.statistics.repairs += 1
                self._store(problem, scene, names, result.path.waypoints)
                return result
        return None

    # --- files ---
    def _stored(self, problem: str, model: RobotModel, names: tuple[str, ...]) -> Iterator[_Stored]:
        for file in sorted(self.folder.glob(f"{problem}_*.json")):
            try:
                yield _read(file, model, names)
            except InputError as error:
                self.statistics.unreadable += 1
                log.warning("%s; the motion is left out", error)

    def _store(self, problem: str, scene: PlanningScene, names: tuple[str, ...], waypoints: Array) -> None:
        world = _scene_key(scene)
        data = {
            "version": VERSION, "scene": world, "joint_names": list(names), "waypoints": waypoints.tolist()
        }  # fmt: skip
        file = self.folder / f"{problem}_{fingerprint(world, waypoints[0])}.json"
        try:
            descriptor, temporary = tempfile.mkstemp(dir=self.folder, suffix=".part")
            with os.fdopen(descriptor, "w", encoding="ascii") as stream:
                json.dump(data, stream)
            os.replace(temporary, file)  # whoever reads sees the old motion or the new one
            every = sorted(self.folder.glob(f"{problem}_*.json"), key=lambda f: f.stat().st_mtime_ns)
            for old in every[: -self.most]:
                old.unlink(missing_ok=True)
        except OSError as error:
            log.warning("%s: the motion is not kept: %s", file, error.strerror)


def _read(file: Path, model: RobotModel, names: tuple[str, ...]) -> _Stored:
    """A stored motion; nothing in the file is trusted but its numbers, which are proven before use."""
    try:
        if file.stat().st_size > MAX_BYTES:
            raise InputError(f"is larger than {MAX_BYTES} bytes", file=file)
        data = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(data, dict) or data.get("version") != VERSION:
            raise InputError("is no motion of this version's plan library", file=file)
        if data["joint_names"] != list(names):
            raise InputError("is a motion of other joints", file=file)
        waypoints = np.array(data["waypoints"], dtype=float)
        if waypoints.ndim != 2 or not 1 <= len(waypoints) <= MAX_WAYPOINTS:
            raise InputError(f"has waypoints of shape {waypoints.shape}", file=file)
        for q in waypoints:
            model.check_positions(q, names, margin=1e-3)
        return _Stored(str(data["scene"]), waypoints)
    except InputError as error:
        raise error if error.file else InputError(error.reason, file=file) from None
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(f"cannot be read as a motion: {error!r}", file=file) from None


@lru_cache(maxsize=16)
def _model_key(model: RobotModel) -> str:
    return fingerprint(model)


def _problem_key(model: RobotModel, request: PlanRequest) -> str:
    """Robot, group and goals; when a state was measured does not matter."""
    goals = [
        (dict(zip(g.state.joint_names, g.state.positions.tolist(), strict=True)), g.tolerance)
        if isinstance(g, JointGoal) else g
        for g in request.goals
    ]  # fmt: skip
    return fingerprint(_model_key(model), request.group, goals)


def _scene_key(scene: PlanningScene) -> str:
    """What stands in the way, but for the robot's own state."""
    held = {n: (b.object.shapes, b.link, b.T_link_object, b.touch_links) for n, b in scene.attached.items()}
    things = {n: (o.shapes, o.T_world_object) for n, o in scene.objects.items()}
    room = (scene.padding, scene.link_padding, scene.link_scale, scene.allowed)
    return fingerprint(things, held, room)


def _asks_more(request: PlanRequest) -> bool:
    """Whether a request asks what stored motions are not looked at for."""
    return (
        bool(request.path_constraints)
        or pipeline_for(request.pipeline_id, request.planner_id) == INDUSTRIAL
        or any(isinstance(goal, ConstraintGoal) for goal in request.goals)
        or request.workspace is not None
        or request.max_cartesian_speed is not None
        or request.adapters != ADAPTERS
    )


def _reaches(scene: PlanningScene, request: PlanRequest, names: tuple[str, ...], q: Array) -> bool:
    """Whether the group's joints (n,) at q are one of the request's goals."""
    there = replace(scene, positions=scene.state.updated(JointState(names, q)).positions)
    for goal in request.goals:
        match goal:
            case JointGoal() | NamedGoal():
                state = (
                    goal.state if isinstance(goal, JointGoal)
                    else scene.model.named_state(request.group, goal.name)
                )  # fmt: skip
                tolerance = goal.tolerance if isinstance(goal, JointGoal) else 1e-6
                wanted = scene.state.updated(state).positions  # joints that are not named stay
                if np.max(np.abs(there.positions - wanted)) <= tolerance + 1e-9:
                    return True
            case PoseGoal() | ConstraintGoal():
                if reaches(scene, request.group, goal, q, POSE_TOLERANCE):
                    return True
    return False


def _repaired(
    checker: KernelChecker, scene: PlanningScene, request: PlanRequest, waypoints: Array, began: float,
    cancel: threading.Event | None,
) -> Array | None:  # fmt: skip
    """The motion with the parts that are no longer free planned anew, and shortened; None: not possible."""
    free = [checker.is_free(q) for q in waypoints]
    if not free[-1]:
        return None
    kept, i = [waypoints[0]], 0
    while i < len(waypoints) - 1:
        if free[i + 1] and checker.certify(waypoints[i : i + 2], padded=True, evidence=False).free:
            i += 1
            kept.append(waypoints[i])
            continue
        left = began + request.planning_time - time.monotonic()
        if left <= 0:
            return None
        j = next(k for k in range(i + 1, len(waypoints)) if free[k])
        names = checker.joint_names
        between = replace(
            request, goals=(JointGoal(JointState(names, waypoints[j])),),
            start=JointState(names, waypoints[i]), planning_time=left,
        )  # fmt: skip
        result = plan(scene, between, cancel)
        if not result.ok or result.path is None:
            return None
        kept += list(result.path.waypoints[1:])
        i = j
    whole = np.array(kept)
    lower, upper = sampling_bounds(scene.model, checker.joint_names, whole[0], list(whole))
    deadline = began + request.planning_time
    shortened = simplify(
        Problem(checker, whole[0], (whole[-1],), lower, upper, request.seed, deadline), whole
    )  # fmt: skip
    return whole if shortened is None else shortened


def _finished(
    checker: KernelChecker, scene: PlanningScene, request: PlanRequest, waypoints: Array, began: float,
    how: str,
) -> PlanResult | None:  # fmt: skip
    """The motion rounded, proven and timed; None where the proof fails."""
    torque = torque_model(scene, checker.joint_names) if request.torque_limits else None
    try:
        finished = finish(
            checker, waypoints, request.velocity_scaling, request.acceleration_scaling,
            torque=torque, jerk_limits=request.jerk_limits,
        )  # fmt: skip
    except TorqueLimitError:
        return None  # planned anew, another way may be easier
    if finished.trajectory is None:
        return None
    return PlanResult(
        ErrorCode.SUCCESS,
        path=JointPath(checker.joint_names, waypoints),
        trajectory=finished.trajectory,
        planner_id="library",
        planning_time=time.monotonic() - began,
        clearance=partial(clearance_along, checker, finished.trajectory),
        evidence={"library": how},
    )
