"""Plan library: stores motions as files and proves them again before reuse.

The library looks up motions by robot, group and goal and uses those that start near the current start. It
keeps the parts of a motion that are still free and replans the blocked parts.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.inter_arm_checker import arms_of
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
from armcell.planning.arm_clearance import achievable_arm_clearance
from armcell.planning.certify import certify_and_time, clearance_along, torque_model
from armcell.planning.goals.sampling import reaches_goal
from armcell.planning.pipeline import plan
from armcell.planning.planners.problem import Problem, sampling_bounds
from armcell.planning.planners.registry import PILZ, find_planner, pipeline_for
from armcell.planning.planners.rrt_connect import simplify
from armcell.scene import PlanningScene
from armcell.timing import TorqueLimitError, check_scaling

Array = NDArray[np.float64]


def fingerprint(*values: Any) -> str:
    """Return a key for the plan library: a hash (32 hexadecimal digits) of the contents of all arguments.

    Equal robots, scenes and goals give equal hashes. File locations do not count.

    Raises:
        TypeError: a value has a type that cannot be hashed.
    """
    digest = hashlib.blake2b(digest_size=16)
    _add(digest, values)
    return digest.hexdigest()


def _add(digest: Any, value: Any) -> None:
    match value:
        case None | bool() | int() | float() | str() | np.generic():
            text = repr(value.item() if isinstance(value, np.generic) else value)
            digest.update(f"{type(value).__name__}:{len(text)}:{text}".encode())
        case Path():
            digest.update(b"path")
        case np.ndarray():
            digest.update(f"array:{value.dtype.str}:{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        case Mapping():
            digest.update(f"map:{len(value)}".encode())
            for key, item in sorted(((fingerprint(k), v) for k, v in value.items()), key=lambda kv: kv[0]):
                digest.update(key.encode())
                _add(digest, item)
        case set() | frozenset():
            digest.update(f"set:{','.join(sorted(fingerprint(v) for v in value))}".encode())
        case tuple() | list():
            digest.update(f"list:{len(value)}".encode())
            for item in value:
                _add(digest, item)
        case _ if is_dataclass(value) and not isinstance(value, type):
            digest.update(type(value).__name__.encode())
            for field in fields(value):
                _add(digest, field.name)
                _add(digest, getattr(value, field.name))
        case _:
            raise TypeError(f"a {type(value).__name__} has no fingerprint")


log = logging.getLogger(__name__)


VERSION = 1
MAX_BYTES = 2_000_000
MAX_WAYPOINTS = 10_000
POSE_TOLERANCE = (1e-4, 1e-3)  # [m], [rad] smallest tolerances: the accuracy of inverse kinematics


@dataclass
class LibraryStatistics:
    """Counts of the motions that a plan library has reused, repaired and newly planned."""

    hits: int = 0  # stored motions, proven again
    repairs: int = 0  # stored motions with replanned parts
    misses: int = 0  # motions planned without a stored motion
    passed_on: int = 0  # requests with options that the library does not cover
    unreadable: int = 0  # unreadable files


@dataclass(frozen=True, eq=False)
class _Stored:
    """Motion that a plan library has stored: waypoints (k, n) of the group's joints, and a hash of the
    scene.
    """

    scene: str
    waypoints: Array


class PlanLibrary:
    """Plan library, which stores planned motions in a folder with one JSON file per motion and reuses them.

    Args:
        start_region: largest distance of each joint from a stored motion's start [rad or m].
        most: number of motions kept per goal; the oldest are deleted.
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
        """Plan like `planning.plan`, but reuse a stored motion from the plan library if it can be proven
        collision-free.

        `evidence["library"]` reports what happened: "hit", "repaired" or "planned".
        """
        began = time.monotonic()
        if _needs_new_plan(request):
            self.statistics.passed_on += 1
            return plan(scene, request, cancel)
        check_scaling(request.velocity_scaling, "velocity scaling")
        check_scaling(request.acceleration_scaling, "acceleration scaling")
        find_planner(request.pipeline_id, request.planner_id)  # raises for misuse even if nothing is planned
        group = scene.model.group(request.group)
        here = scene
        if request.start is not None:
            here = replace(scene, positions=scene.state.updated(request.start).positions)
        problem = _problem_hash(scene.model, request)
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
        """Return a stored motion of the plan library that fits the start and goal of the request, after
        proving it collision-free again or repairing it.

        Return None if no stored motion is usable.
        """
        names = scene.model.group(request.group).joint_names
        start = scene.positions[scene.model.columns(names)]
        world = _scene_hash(scene)
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
            return None  # the pipeline reports the contact
        checker.relax_margins(start)
        arms, ends = arms_of(scene.model, request.group), [s.waypoints[-1] for s in near]
        arm_clearance = achievable_arm_clearance(scene, arms, checker, start, ends, request.arm_clearance)
        if arm_clearance is not None:
            checker = arm_clearance.apply_to(checker)
        motions = [np.vstack([start, s.waypoints[1:]]) for s in near]
        for waypoints in motions:
            if _is_free(checker, waypoints):
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
        world = _scene_hash(scene)
        data = {
            "version": VERSION, "scene": world, "joint_names": list(names), "waypoints": waypoints.tolist()
        }  # fmt: skip
        file = self.folder / f"{problem}_{fingerprint(world, waypoints[0])}.json"
        try:
            descriptor, temporary = tempfile.mkstemp(dir=self.folder, suffix=".part")
            with os.fdopen(descriptor, "w", encoding="ascii") as stream:
                json.dump(data, stream)
            os.replace(temporary, file)  # readers see either the old or the new motion
            every = sorted(self.folder.glob(f"{problem}_*.json"), key=lambda f: f.stat().st_mtime_ns)
            for old in every[: -self.most]:
                old.unlink(missing_ok=True)
        except OSError as error:
            log.warning("%s: the motion is not kept: %s", file, error.strerror)


def _read(file: Path, model: RobotModel, names: tuple[str, ...]) -> _Stored:
    """Read a stored motion of a plan library from a JSON file.

    Only the motion's numbers are used, and they are proven before use.
    """
    try:
        if file.stat().st_size > MAX_BYTES:
            raise InputError(f"is larger than {MAX_BYTES} bytes", file=file)
        data = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(data, dict) or data.get("version") != VERSION:
            raise InputError("is not a motion of this version's plan library", file=file)
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
def _model_hash(model: RobotModel) -> str:
    return fingerprint(model)


def _problem_hash(model: RobotModel, request: PlanRequest) -> str:
    """Return a hash of the robot, the group and the goals of a request for the plan library; time stamps do
    not count.
    """
    goals = [
        (dict(zip(g.state.joint_names, g.state.positions.tolist(), strict=True)), g.tolerance)
        if isinstance(g, JointGoal) else g
        for g in request.goals
    ]  # fmt: skip
    return fingerprint(_model_hash(model), request.group, goals)


def _scene_hash(scene: PlanningScene) -> str:
    """Return a hash of the obstacles and attached objects in a scene for the plan library; the robot's state
    does not count.
    """
    held = {n: (b.object.shapes, b.link, b.T_link_object, b.touch_links) for n, b in scene.attached.items()}
    things = {n: (o.shapes, o.T_world_object) for n, o in scene.objects.items()}
    arm_clearance = (scene.padding, scene.link_padding, scene.link_scale, scene.allowed)
    return fingerprint(things, held, arm_clearance)


def _needs_new_plan(request: PlanRequest) -> bool:
    """Return whether a planning request has options that do not permit the reuse of stored motions from a
    plan library.
    """
    return (
        bool(request.path_constraints)
        or pipeline_for(request.pipeline_id, request.planner_id) == PILZ
        or any(isinstance(goal, ConstraintGoal) for goal in request.goals)
        or request.workspace is not None
        or request.max_cartesian_speed is not None
        or request.adapters != ADAPTERS
    )


def _reaches(scene: PlanningScene, request: PlanRequest, names: tuple[str, ...], q: Array) -> bool:
    """Return whether the end q (n,) of a stored motion in the plan library satisfies one of the goals of the
    request.
    """
    there = replace(scene, positions=scene.state.updated(JointState(names, q)).positions)
    for goal in request.goals:
        match goal:
            case JointGoal() | NamedGoal():
                state = (
                    goal.state if isinstance(goal, JointGoal)
                    else scene.model.named_state(request.group, goal.name)
                )  # fmt: skip
                tolerance = goal.tolerance if isinstance(goal, JointGoal) else 1e-6
                wanted = scene.state.updated(state).positions  # unnamed joints keep their position
                if np.max(np.abs(there.positions - wanted)) <= tolerance + 1e-9:
                    return True
            case PoseGoal() | ConstraintGoal():
                if reaches_goal(scene, request.group, goal, q, POSE_TOLERANCE):
                    return True
    return False


def _is_free(checker: KernelChecker, waypoints: Array) -> bool:
    """Return whether a motion of the plan library is as safe as a newly planned one: proven collision-free
    without padding, and collision-free with padding at samples.

    A proof that includes the padding would fail for some planned motions, which would then be repaired at
    every use.
    """
    return checker.certify(waypoints, evidence=False).free and all(
        checker.edge_is_free(a, b) for a, b in pairwise(waypoints)
    )


def _repaired(
    checker: KernelChecker, scene: PlanningScene, request: PlanRequest, waypoints: Array, began: float,
    cancel: threading.Event | None,
) -> Array | None:  # fmt: skip
    """Replan the blocked parts of a stored motion in the plan library, then simplify the motion. Return None
    on failure.
    """
    free = [checker.is_free(q) for q in waypoints]
    if not free[-1]:
        return None
    kept, i = [waypoints[0]], 0
    while i < len(waypoints) - 1:
        if free[i + 1] and _is_free(checker, waypoints[i : i + 2]):
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
    """Round the corners of a stored motion in the plan library, certify it and compute its timing. Return
    None if that fails.
    """
    torque = torque_model(scene, checker.joint_names) if request.torque_limits else None
    try:
        finished = certify_and_time(
            checker, waypoints, request.velocity_scaling, request.acceleration_scaling,
            torque=torque, jerk_limits=request.jerk_limits,
        )  # fmt: skip
    except TorqueLimitError:
        return None  # replan: another path may need less torque
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
