"""Validation of grasps in physics: each grasp is lifted and shaken in noisy trials.

The result is a success rate over noisy trials with its interval, cached on disk per object, gripper and
grasp. The module is in this package because it is the lowest one that may import both grasping and physics.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armcell._array_store import keep, recall
from armcell.core import SE3, SO3
from armcell.core.confidence_interval import wilson
from armcell.grasping import Grasp, Noise, approach_depth, hand_of, surface_of
from armcell.model import Gripper, RobotModel
from armcell.scene import CollisionObject
from armcell.sim import GraspTrial, TrialSettings, run_trials

GRAZE = 5e-4  # [m] by which a finger may enter the object's surface points on the approach
MAX_SLIP, MAX_TURN = 0.008, 0.3  # [m], [rad] maximum motion in the hand for accurate placing
SAME_PLACE, SAME_WAY = 0.012, 0.3  # [m], [rad] closer grasps count as equal
PRIOR_TRIALS, PRIOR_SHARE = 2.0, 0.97  # success rate of grasps that pass the geometric checks (`bench grasp`)
VERSION = 5  # increase when the results of trials change

NOISE = Noise(position=0.001, rotation=0.02)


@dataclass(frozen=True, eq=False)
class GraspProof:
    """Result of the simulated trials that test one grasp: the number of successes, and the slip and rotation
    of the object in the hand.
    """

    grasp: Grasp
    successes: int
    trials: int
    slip: float  # [m] median motion of the object's point between the pads
    turn: float  # [rad] median

    @property
    def probability(self) -> float:
        """Return the probability that a grasp succeeds, as estimated by its proof in simulated trials. It is
        strictly between 0 and 1.

        The estimate is a mean with a prior that counts as `PRIOR_TRIALS` trials.
        """
        return (self.successes + PRIOR_SHARE * PRIOR_TRIALS) / (self.trials + PRIOR_TRIALS)

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 95 % Wilson interval for the success rate of a grasp in the simulated trials of its
        proof.
        """
        return wilson(self.successes, self.trials)


def prove_grasps(
    model: RobotModel,
    gripper: Gripper,
    item: CollisionObject,
    grasps: Sequence[Grasp],
    trials: int = 8,
    noise: Noise = NOISE,
    settings: TrialSettings = TrialSettings(),
    seed: int = 0,
    threads: int | None = None,
) -> list[GraspProof]:
    """Prove grasps by simulation: lift and shake an object with each grasp in noisy physics trials.

    The first of the `trials` trials has no noise. The object rests on its support: its pose is uncertain
    along the surface and about the vertical. A trial also fails if the open hand would touch the displaced
    object on its approach.

    Raises:
        InputError: MuJoCo cannot load the hand or the object.
    """
    surface = surface_of(item)
    digest = hashlib.sha256(f"{VERSION} {model.name} {gripper} {trials} {noise} {settings} {seed}".encode())
    digest.update(surface.triangles.tobytes())
    digest.update(f"{item.mass_kg:.9g} {item.material}".encode())
    up = item.T_world_object.rotation.matrix[2]
    digest.update(up.round(6).tobytes())
    common = digest.hexdigest()[:24]
    keys = [f"{common}{hashlib.sha256(_content(grasp)).hexdigest()[:16]}" for grasp in grasps]
    stored = [recall("proofs", key) for key in keys]
    missing = [i for i, kept in enumerate(stored) if kept is None]
    runs = [trial for i in missing for trial in _noisy(item, grasps[i], trials, noise, seed)]
    hand = hand_of(model, gripper)
    results = run_trials(model, gripper, item, runs, settings, threads)
    for n, i in enumerate(missing):
        own = results[n * trials : (n + 1) * trials]
        poses = [run.T_object_tcp for run in runs[n * trials : (n + 1) * trials]]
        clear = [approach_depth(item, hand, grasps[i], T) <= GRAZE for T in poses]
        good = sum(
            free and not r.lost and r.slip <= MAX_SLIP and r.turn <= MAX_TURN
            for free, r in zip(clear, own, strict=True)
        )
        moved = np.median([(min(r.slip, 1.0), min(r.turn, np.pi)) for r in own], axis=0)
        counts = np.array([good, trials])
        stored[i] = {"counts": counts, "moved": moved}
        keep("proofs", keys[i], counts=counts, moved=moved)
    return [
        GraspProof(grasp, *kept["counts"].tolist(), *kept["moved"].tolist())
        for grasp, kept in zip(grasps, stored, strict=True)
        if kept is not None
    ]


def _content(grasp: Grasp) -> bytes:
    numbers = [grasp.opening, grasp.width, grasp.force]
    return np.concatenate([grasp.T_object_tcp.matrix.ravel(), numbers]).round(7).tobytes()


def _noisy(item: CollisionObject, grasp: Grasp, count: int, noise: Noise, seed: int) -> list[GraspTrial]:
    up = tuple(item.T_world_object.rotation.matrix[2].tolist())
    return [
        GraspTrial(
            real.T_world_object.inverse() @ item.T_world_object @ grasp.T_object_tcp,
            grasp.opening, grasp.width, grasp.force, up, real.material.friction, real.mass_kg,
        )
        for real in sample_object_variants(item, count, np.random.default_rng(seed), noise)
    ]  # fmt: skip


def sample_object_variants(
    item: CollisionObject, count: int, rng: np.random.Generator, noise: Noise = NOISE
) -> list[CollisionObject]:
    """Sample the variants of an object with which its grasps are proven in simulated trials: the pose, the
    friction and the mass vary.

    The pose varies along the support and about the vertical. The first variant is the nominal object.
    """
    up = item.T_world_object.rotation.matrix[2]
    found = []
    for shift, other in zip(noise.poses(count, rng), noise.materials(item, count, rng), strict=True):
        along = shift.translation - (shift.translation @ up) * up
        turn = SE3(SO3.exp((shift.rotation.log() @ up) * up), along)
        found.append(other.at(item.T_world_object @ turn))
    return found


def distinct_grasps(grasps: Sequence[Grasp], count: int) -> list[Grasp]:
    """Select grasps to be proven in simulation: the best ones that differ clearly from each other. If there
    are too few, add the next best grasps.
    """
    chosen: list[Grasp] = []
    rest: list[Grasp] = []
    for grasp in grasps:
        if len(chosen) == count:
            break
        (rest if any(_alike(grasp, other) for other in chosen) else chosen).append(grasp)
    return chosen + rest[: count - len(chosen)]


def _alike(a: Grasp, b: Grasp) -> bool:
    """Return whether two grasps are so similar that only one must be proven in the physics simulation. Grasps
    that differ by half a turn of the hand are similar.
    """
    if np.linalg.norm(a.T_object_tcp.translation - b.T_object_tcp.translation) > SAME_PLACE:
        return False
    A, B = a.T_object_tcp.rotation.matrix, b.T_object_tcp.rotation.matrix
    return bool(A[:, 2] @ B[:, 2] > np.cos(SAME_WAY) and abs(A[:, 1] @ B[:, 1]) > np.cos(SAME_WAY))
