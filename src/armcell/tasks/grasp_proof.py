"""Validation of grasps in physics: each grasp is lifted and shaken in noisy trials.

The result is a success rate over noisy trials with its interval, cached on disk per object, gripper and
grasp. The module is in this package because it is the lowest one that may import both grasping and physics.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell._array_store import keep, recall
from armcell.core import SE3, SO3
from armcell.core.confidence_interval import wilson
from armcell.grasping import Grasp, Hand, Noise, approach_depth, hand_of, surface_of
from armcell.model import Gripper, RobotModel
from armcell.scene import CollisionObject
from armcell.sim import GraspTrial, TrialSettings, run_trials

Array = NDArray[np.float64]

GRAZE = 5e-4  # [m] by which a finger may enter the object's surface points without touching the object
PUSHED = (
    0.002  # [m] a touch of depth d lets the approach pass with probability exp(-d / PUSHED) (`bench grasp`)
)
DRAWS = 32  # noisy poses at which the approach is checked; only some of them are simulated
MAX_SLIP, MAX_TURN = 0.008, 0.3  # [m], [rad] maximum motion in the hand for accurate placing
SAME_PLACE, SAME_WAY = 0.012, 0.3  # [m], [rad] closer grasps count as equal
PRIOR_TRIALS, PRIOR_SHARE = 3.0, 0.97  # success rate of grasps that pass the geometric checks (`bench grasp`)
VERSION = 6  # increase when the results of trials change

NOISE = Noise(position=0.001, rotation=0.02)


@dataclass(frozen=True, eq=False)
class GraspProof:
    """Result of the simulated trials that test one grasp: the number of successes, the slip and rotation of
    the object in the hand, and the probability that the hand reaches the grasp.

    The trials begin with the open hand at the grasp, so `successes` does not count stopped approaches.
    """

    grasp: Grasp
    successes: int
    trials: int
    slip: float  # [m] median motion of the object's point between the pads
    turn: float  # [rad] median
    approach: float  # probability that no touch stops the hand before the grasp

    @property
    def probability(self) -> float:
        """Return the probability that a grasp succeeds, as estimated by its proof in simulated trials. It is
        strictly between 0 and 1.

        This is the probability that the hand reaches the grasp, times the probability that it then holds the
        object. The latter is a mean with a prior that counts as `PRIOR_TRIALS` trials.
        """
        return self.approach * (self.successes + PRIOR_SHARE * PRIOR_TRIALS) / (self.trials + PRIOR_TRIALS)

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 95 % Wilson interval for the success rate of a grasp in the simulated trials of its
        proof, times the probability that the hand reaches the grasp.
        """
        low, high = wilson(self.successes, self.trials)
        return self.approach * low, self.approach * high


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

    The object rests on its support: its pose is uncertain along the surface and about the vertical. The open
    hand may touch the displaced object on its approach. A light touch pushes the object aside, a deep one
    stops the arm: the depths at `DRAWS` noisy poses give the probability that the hand reaches the grasp. The
    trials simulate the poses without a touch, or with the lightest touches if there are too few of them.

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
    hand, wanted = hand_of(model, gripper), [grasps[i] for i in missing]
    runs, approach = _noisy(item, hand, wanted, trials, noise, seed)
    results = run_trials(model, gripper, item, runs, settings, threads)
    for n, i in enumerate(missing):
        own = results[n * trials : (n + 1) * trials]
        good = sum(not r.lost and r.slip <= MAX_SLIP and r.turn <= MAX_TURN for r in own)
        moved = np.median([(min(r.slip, 1.0), min(r.turn, np.pi)) for r in own], axis=0)
        stored[i] = kept = {
            "counts": np.array([good, trials]),
            "moved": moved,
            "approach": approach[n : n + 1],
        }
        keep("proofs", keys[i], **kept)
    return [
        GraspProof(grasp, *kept["counts"].tolist(), *kept["moved"].tolist(), *kept["approach"].tolist())
        for grasp, kept in zip(grasps, stored, strict=True)
        if kept is not None
    ]


def _content(grasp: Grasp) -> bytes:
    numbers = [grasp.opening, grasp.width, grasp.force]
    return np.concatenate([grasp.T_object_tcp.matrix.ravel(), numbers]).round(7).tobytes()


def _noisy(
    item: CollisionObject, hand: Hand, grasps: Sequence[Grasp], count: int, noise: Noise, seed: int
) -> tuple[list[GraspTrial], Array]:
    """Return `count` noisy trials of each grasp, and the probabilities (g,) that the hand reaches them.

    Friction and mass are drawn for the trials alone, so that these few cover both distributions evenly.
    """
    if not grasps:
        return [], np.zeros(0)
    rng, up = np.random.default_rng(seed), tuple(item.T_world_object.rotation.matrix[2].tolist())
    _, *displaced = sample_object_variants(item, max(DRAWS, count) + 1, rng, noise)
    _, *others = noise.materials(item, count + 1, rng)
    shifts = [real.T_world_object.inverse() @ item.T_world_object for real in displaced]
    runs, approach = [], np.empty(len(grasps))
    for i, grasp in enumerate(grasps):
        poses = [shift @ grasp.T_object_tcp for shift in shifts]
        depths = np.array([approach_depth(item, hand, grasp, T) for T in poses])
        approach[i] = np.exp(-depths / PUSHED).mean()
        lightest = np.argsort(np.maximum(depths, GRAZE), kind="stable")[:count]
        for k, other in zip(lightest, others, strict=True):
            friction, mass = other.material.friction, other.mass_kg
            runs.append(GraspTrial(poses[k], grasp.opening, grasp.width, grasp.force, up, friction, mass))
    return runs, approach


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
