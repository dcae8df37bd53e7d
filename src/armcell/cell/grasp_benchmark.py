"""Grasp benchmark: a simulated robot picks and places one object after the other in physics."""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.cell.grasp_predictions import Prediction, predictions, scores
from armcell.cell.live import LiveCell
from armcell.core import SE3, SO3, Box, ErrorCode, InputError, Mesh, Outcome
from armcell.core.confidence_interval import wilson
from armcell.drivers import DriverOptions, drivers
from armcell.grasping import Grasp, grasp_candidates, grasp_quality, hand_of, nearest_miss, stable_poses
from armcell.model import Gripper, SuctionGripper, load_robot, load_urdf
from armcell.model.assets import MESH_SUFFIXES
from armcell.scene import (
    CollisionObject,
    Material,
    PlanningScene,
    library_object,
    mesh_object,
    object_names,
)
from armcell.sim import PhysicsSettings, SimWorld
from armcell.tasks import TaskContext, TaskSettings, distinct_grasps, hold, pick, place, prove_grasps, release
from armcell.tasks.stages import ChoosePlacement

Array = NDArray[np.float64]

LIFT, HOLD, NEAR_ENOUGH = 0.20, 5.0, 0.01  # [m], [s], [m]: lift height, hold time, largest placement error
SHARE = 0.75  # narrowest side of a scaled object, as share of the gripper's opening
FRICTION = 0.5  # of objects from mesh and URDF files, which have no friction
REACH = {"panda": 0.5}  # [m] from the base to the table's center
TABLE, OBJECT = "table", "object"
AT_REST = 5e-4  # [m] and 10 [rad] of motion in 0.5 s: an object below both is at rest


@dataclass(frozen=True)
class TrialOptions:
    """Options for the grasp benchmark, which runs trials in the physics simulation."""

    robot: str = "panda"
    candidates: int = 16  # grasps tried in physics before one is chosen
    proof_trials: int = 8
    seed: int = 0
    predictions: int = 6  # trials with random grasps per object, to validate P
    recovery: bool = True  # if the first attempt fails, repeat with three attempts


@dataclass
class ObjectResult:
    """Results of all trials with one object in the grasp benchmark: grasps, attempts, predictions
    and times.
    """

    name: str
    scale: float
    graspable: bool
    reason: str = ""
    success: bool | None = None  # first attempt
    recovered: bool | None = None
    probability: float | None = None
    interval: tuple[float, float] | None = None
    epsilon: float | None = None
    grasp: str = ""
    error_m: float | None = None  # placement error
    slip_m: float | None = None  # during the hold
    candidates: int = 0
    generation_s: float = 0.0  # CPU
    proof_s: float = 0.0  # wall
    cpu_s: float = 0.0  # CPU time of the whole row, all threads
    predictions: list[Prediction] = field(default_factory=list)


# --- objects ---
def made_objects() -> Iterator[tuple[str, CollisionObject, float]]:
    """Yield (name, object, scale) for each object of the object library, for the grasp benchmark. The scale
    is always 1.
    """
    for kind in object_names():
        yield kind, library_object(kind), 1.0


def objects_of(
    folder: Path, gripper: Gripper, count: int, scale: float = 1.0, skip: int = 0
) -> Iterator[tuple[str, CollisionObject | InputError, float]]:
    """Yield objects for the grasp benchmark from URDF or mesh files in a folder.
    Each is scaled such that the gripper's jaws can grasp it.

    If the folder has URDFs, mesh files are ignored. An unreadable file yields its error as the object.

    Args:
        count: number of files, in alphabetical order.
        scale: scale of the mesh files before the objects are fitted to the gripper.
        skip: number of files to skip first.
    Yields:
        Name, object or error, and the scale that fits the object to the gripper.
    Raises:
        InputError: the folder does not exist, contains no suitable file, or all files are skipped.
    """
    if not os.path.isdir(folder):
        raise InputError("is not a folder", file=folder)
    files = sorted(folder.rglob("*.urdf")) or sorted(
        f for f in folder.rglob("*") if f.suffix.lower() in MESH_SUFFIXES
    )
    if not files:
        raise InputError(
            "has no mesh and no URDF in it", file=folder, hint=f"put {', '.join(sorted(MESH_SUFFIXES))} there"
        )
    if skip >= len(files):
        raise InputError(f"has {len(files)} files, {skip} are to be skipped", file=folder)
    limit = np.inf if isinstance(gripper, SuctionGripper) else SHARE * gripper.max_width
    for file in files[skip : skip + count]:
        try:
            item = _of_urdf(file) if file.suffix == ".urdf" else mesh_object(file.stem, file, scale=scale)
            item = replace(item, material=Material(FRICTION))
            low, high = item.bounds()
            shrink = min(1.0, limit / float((high - low).min()))
            yield file.stem, item if shrink == 1.0 else _scaled(item, shrink), shrink
        except InputError as error:  # continue with the other files
            yield file.stem, error, 1.0


def _of_urdf(file: Path) -> CollisionObject:
    model = load_urdf(file)
    link = model.links[model.root_link]
    shapes = tuple((c.shape, c.T_link_shape) for c in link.collisions)
    mass = link.inertial.mass if link.inertial else None
    return CollisionObject(file.stem, shapes, movable=True, mass=mass)


def _scaled(item: CollisionObject, scale: float) -> CollisionObject:
    shapes = []
    for shape, T in item.shapes:
        if not isinstance(shape, Mesh):
            raise InputError(f"object {item.name!r}: only meshes are scaled to fit")
        moved = SE3(T.rotation, T.translation * scale)
        shapes.append((Mesh(shape.vertices * scale, shape.faces, shape.file), moved))
    return replace(item, shapes=tuple(shapes))


# --- one object ---
class Bench:
    """Grasp benchmark in the physics simulation, in which a robot at a
    table picks and places one object after the other.
    """

    def __init__(self, options: TrialOptions):
        self.options = options
        self.model = load_robot(options.robot)
        self.gripper = self.model.gripper()
        x = REACH.get(options.robot, 0.7)
        self.spot, self.goal = (x, -0.15), (0.0, 0.2)
        table = CollisionObject.single(TABLE, Box(1.0, 1.4, 0.04), SE3.from_xyz(x, 0.0, -0.021))
        self.table = PlanningScene.of(self.model, objects=[table]).with_padding(0.003)
        self.settings = TaskSettings(
            lift_distance=LIFT, lower_distance=0.06, retreat_distance=0.08, attempts=1,
            prove_grasps=options.candidates, proof_trials=options.proof_trials,
            planning_budget=600.0,  # large, so that no trial fails on a busy machine
        )  # fmt: skip

    def run(self, name: str, item: CollisionObject | InputError, scale: float) -> ObjectResult:
        """Run the trials of one object in the grasp benchmark: plan grasps, attempt picks and test
        predictions.
        """
        if isinstance(item, InputError):
            return ObjectResult(name, scale, False, str(item))
        began = time.process_time()
        row = self._tried(name, item, scale)
        row.cpu_s = time.process_time() - began
        return row

    def _tried(self, name: str, item: CollisionObject, scale: float) -> ObjectResult:
        item, hand = replace(item, name=OBJECT), hand_of(self.model, self.gripper)
        began = time.thread_time()
        grasp_candidates(item, hand)
        row = ObjectResult(name, scale, False, generation_s=time.thread_time() - began)
        placed = next(self.at_rest(item), None)
        if placed is None:
            row.reason = "does not come to rest on any side"
            return row
        grasps, rejected = grasp_candidates(placed, hand)
        row.graspable, row.candidates = bool(grasps), len(grasps)
        if not grasps:
            miss = nearest_miss(rejected)
            row.reason = miss.reason if miss else "no candidates"
            return row
        scene, options = self.table.with_object(placed), self.options
        began = time.perf_counter()
        prove_grasps(
            self.model,
            self.gripper,
            placed,
            distinct_grasps(grasps, options.candidates),
            options.proof_trials,
        )
        row.proof_s = time.perf_counter() - began
        first = self._attempt(scene, self.settings)
        row.success, row.reason = first.ok, first.message
        row.error_m, row.slip_m = first.evidence.get("error_m"), first.evidence.get("slip_m")
        if first.evidence.get("proof") is not None:
            proof = first.evidence["proof"]
            row.grasp, row.probability, row.interval = proof.grasp.name, proof.probability, proof.interval
            row.epsilon = grasp_quality(placed, proof.grasp).epsilon
        if not first.ok and options.recovery:
            row.recovered = self._attempt(scene, replace(self.settings, attempts=3), tries=3).ok
        row.predictions = self._predictions(scene, placed, name, grasps)
        return row

    def _predictions(
        self, scene: PlanningScene, item: CollisionObject, name: str, grasps: Sequence[Grasp]
    ) -> list[Prediction]:
        """Benchmark the grasp predictions for one object in trials with random grasps. The benchmark's seed
        and the object's name seed the random numbers.
        """
        o, settings = self.options, replace(self.settings, prove_grasps=0)
        seed = o.seed, zlib.crc32(name.encode())
        return predictions(scene, item, self.gripper, grasps, settings, o.predictions, HOLD, seed)

    def _attempt(self, scene: PlanningScene, settings: TaskSettings, tries: int = 1) -> Outcome:
        """Run one trial of the grasp benchmark and return the measurements. The robot picks, lifts, holds and
        places an object by friction only.
        """
        driver = drivers["sim"](scene, DriverOptions(self.options.seed, physics=PhysicsSettings()))
        with LiveCell("grasp trial", scene, driver, settings, (), self.options.seed) as live:
            outcome = Outcome(ErrorCode.FAILURE, "not tried")
            for _ in range(tries):
                outcome = self._once(live.ctx)
                if outcome.ok:
                    break
                if live.ctx.holding:
                    release(live.ctx, self.gripper)
            return outcome

    def _once(self, ctx: TaskContext) -> Outcome:
        picked = self._picked(ctx)
        evidence = {k: picked.evidence.get(k) for k in ("grasp", "proof")}
        if not picked.ok:
            return replace(picked, evidence=evidence)
        hold(ctx, HOLD)
        evidence["slip_m"] = ctx.reports[-1].slip_m
        if ctx.driver.gripper(self.gripper.name).held != OBJECT:
            ctx.holding.clear()
            return Outcome(ErrorCode.CONTROL_FAILED, "dropped while held", evidence)
        try:
            placed = place(ctx, OBJECT, TABLE, self.goal)
        except InputError as error:
            return Outcome(ErrorCode.PLANNING_FAILED, str(error), evidence)
        if not placed.ok:
            return replace(placed, evidence=evidence)
        ctx.advance(0.5)
        wanted = placed.evidence["placement"].T_world_object
        evidence["error_m"] = wanted.distance_to(ctx.driver.object_poses()[OBJECT])[0]
        if evidence["error_m"] > NEAR_ENOUGH:
            text = f"is {evidence['error_m'] * 1000:.1f} mm from its target pose"
            return Outcome(ErrorCode.CONTROL_FAILED, text, evidence)
        if unwanted := ctx.driver.unwanted_contacts():
            text = f"{unwanted[0].body_a} touched {unwanted[0].body_b}"
            return Outcome(ErrorCode.CONTROL_FAILED, text, evidence)
        return Outcome(ErrorCode.SUCCESS, "", evidence)

    def _picked(self, ctx: TaskContext) -> Outcome:
        """Pick the object in a trial of the grasp benchmark. Prefer a grasp with which the arm can also reach
        the goal; otherwise use any grasp.
        """
        s = self.settings
        goal = ChoosePlacement(OBJECT, TABLE, self.gripper, s.near, s.lower_distance, self.goal)
        picked = pick(ctx, OBJECT, self.gripper, ahead=[goal])
        return picked if picked.code is not ErrorCode.PLANNING_FAILED else pick(ctx, OBJECT, self.gripper)

    def at_rest(self, item: CollisionObject, yaw: float = 0.0) -> Iterator[CollisionObject]:
        """Yield the object of the grasp benchmark at rest on the table in the physics simulation, once for
        each of its three most stable sides.

        Sides from which the object rolls away are skipped.

        Args:
            yaw: rotation of the object about the vertical [rad].
        """
        for rest in stable_poses(item)[:3]:
            R = SO3.exp((0.0, 0.0, yaw)) @ SO3.between(rest.up, (0.0, 0.0, 1.0))
            corners = R.matrix @ rest.foot.mean(0)  # center the foot, not the origin
            start = item.at(SE3(R, np.array([*(np.array(self.spot) - corners[:2]), rest.height + 2e-4])))
            with SimWorld(self.table.with_object(start)) as world:
                world.step(int(1.0 / world.timestep))
                before = world.object_pose(item.name)
                world.step(int(0.5 / world.timestep))
                after = world.object_pose(item.name)
            moved, turned = before.distance_to(after)
            drift = np.linalg.norm(before.apply(rest.foot.mean(0))[:2] - self.spot)
            if moved < AT_REST and turned < 10 * AT_REST and drift < 0.05:
                yield item.at(after)


# --- results ---
def summary(rows: Sequence[ObjectResult], recovery: bool = True) -> dict[str, Any]:
    """Summarize the results of the grasp benchmark: success rates with confidence intervals, times and
    prediction scores.

    Args:
        recovery: whether failed first attempts were repeated with recovery.
    """
    tried = [r for r in rows if r.graspable]
    first = sum(bool(r.success) for r in tried)
    after = sum(bool(r.success or r.recovered) for r in tried)
    times = [r.generation_s for r in rows if r.generation_s > 0] or [0.0]
    found: dict[str, Any] = {
        "objects": len(rows),
        "graspable": len(tried),
        "first_attempt": _share(first, len(tried)),
        **({"with_recovery": _share(after, len(tried))} if recovery else {}),
        "generation_ms_median": 1000 * float(np.median(times)),
        "generation_ms_max": 1000 * max(times),
        "proof_s_median": float(np.median([r.proof_s for r in tried])) if tried else None,
        "proof_s_max": max((r.proof_s for r in tried), default=None),
        "cpu_s": sum(r.cpu_s for r in rows),
    }
    judged = [(r.name, p.probability, p.epsilon, p.success) for r in tried for p in r.predictions]
    return {**found, **(scores(*zip(*judged, strict=True)) if judged else {})}


def _share(successes: int, trials: int) -> dict[str, Any]:
    low, high = wilson(successes, trials)
    share = successes / trials if trials else None
    return {"successes": successes, "trials": trials, "share": share, "low": low, "high": high}
