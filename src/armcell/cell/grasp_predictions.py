"""Validation of the predicted grasp success P: simulated picks, and scores (Brier, log loss, AUC).

In the picks with random grasps, the true pose, friction and mass of the object differ from the believed
ones by the noise that the prediction assumes. The proof's probability P is scored directly, also for
reliability. The grasp quality epsilon is not a probability, so a logistic curve maps it to one. This
curve and the base rate (share of successes) are fitted to all other objects, because the trials of one
object are correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.cell.live import LiveCell
from armcell.cell.perceived_objects import DetectedPoses, PerceivingDriver
from armcell.core import SE3, Outcome
from armcell.drivers import DriverOptions, drivers
from armcell.grasping import Grasp, Noise, grasp_quality
from armcell.model import Gripper
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import PhysicsSettings, SimWorld
from armcell.tasks import (
    Stage,
    TaskContext,
    TaskSettings,
    distinct_grasps,
    hold,
    pick_stages,
    prove_grasps,
    sample_object_variants,
)
from armcell.tasks.grasp_proof import MAX_SLIP, MAX_TURN, NOISE
from armcell.tasks.stages import Close, RunSteps
from armcell.tasks.steps import DONE, perform_all
from armcell.tasks.task import plan_stages

POOL = 40  # distinct grasps to draw from
IN_VAIN = 3  # draws per wanted trial: some grasps are unreachable
Array = NDArray[np.float64]
EDGES = (0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0)  # edges of the bins of P in the reliability table
LEAST = 1e-3  # the log loss clips probabilities to [LEAST, 1 - LEAST]
RIDGE = 0.05  # ridge penalty: keeps the fit finite if epsilon separates successes from failures
RESAMPLED = 2000  # bootstrap resamples of the objects for the interval of the lead


@dataclass(frozen=True)
class HoldResult:
    """Result of a simulated pick that tests a grasp prediction:
    whether the gripper held the object, and how firmly.
    """

    to_the_end: bool
    slip_m: float | None = None  # of the object's point between the pads, since the hand closed
    turn_rad: float | None = None
    reason: str = ""

    @property
    def firmly(self) -> bool:
        """Return whether the hand held the object firmly in the pick that tests a grasp prediction: until the
        end, and with slip and rotation within the limits.
        """
        if not self.to_the_end or self.slip_m is None or self.turn_rad is None:
            return False
        return self.slip_m <= MAX_SLIP and self.turn_rad <= MAX_TURN


@dataclass(frozen=True)
class Prediction:
    """The predicted success of one grasp and the observed result."""

    grasp: str
    probability: float  # predicted by trials of the hand alone
    epsilon: float
    success: bool  # `HoldResult.firmly`
    held: HoldResult


def predictions(
    scene: PlanningScene, item: CollisionObject, gripper: Gripper, grasps: Sequence[Grasp],
    settings: TaskSettings, count: int, duration: float, seed: Sequence[int], noise: Noise = NOISE,
) -> list[Prediction]:  # fmt: skip
    """Pick up to `count` times with random grasps and compare the predicted success with the results.
    Skip unreachable grasps.

    Args:
        scene: the believed planning scene, with the object.
        duration: time [s] for which the object is held after the lift.
        seed: seeds the grasp draw and the object's true properties; independent of the proofs' seed.
        noise: of the object's true properties, and the noise that the predictions assume.
    """
    rng, pool = np.random.default_rng(seed), distinct_grasps(grasps, POOL)
    drawn = [pool[i] for i in rng.permutation(len(pool))[: IN_VAIN * count]]
    _, *truths = sample_object_variants(item, len(drawn) + 1, rng, noise)  # the first is as believed
    found: list[Prediction] = []
    for grasp, truth in zip(drawn, truths, strict=True):
        if len(found) == count:
            break
        held = simulate_pick(scene, truth, gripper, grasp, settings, duration)
        if held is None:
            continue
        (proof,) = prove_grasps(scene.model, gripper, item, [grasp], settings.proof_trials, noise)
        epsilon = grasp_quality(item, grasp).epsilon
        found.append(Prediction(grasp.name, proof.probability, epsilon, held.firmly, held))
    return found


def simulate_pick(
    scene: PlanningScene, truth: CollisionObject, gripper: Gripper, grasp: Grasp, settings: TaskSettings,
    duration: float,
) -> HoldResult | None:  # fmt: skip
    """Test a grasp prediction in simulation: pick, lift and hold an object whose true properties the
    prediction does not know.

    Like a real robot that relies on a camera, the simulated robot knows only the planning scene.

    Args:
        truth: the object with its true properties.
        duration: time [s] for which the object is held after the lift.
    Returns:
        The result; None if the planner finds no motion to the grasp.
    """
    name = truth.name
    believed = scene.object(name)
    seen = DetectedPoses({name: believed})
    options = DriverOptions(physics=PhysicsSettings())
    robot = drivers["sim"](scene.with_object(truth), options)
    driver: Any = PerceivingDriver(robot, scene.model, seen)
    with LiveCell("grasp prediction", scene, driver, settings, (), 0, seen=seen) as live:
        seen.poses[name] = believed.T_world_object
        live.ctx.change_scene(seen.put_into)
        hand = _Hand(driver.world, gripper, name)
        solution, _ = plan_stages(live.ctx, _stages(live.ctx, name, gripper, grasp, hand), f"pick {name}")
        if solution is None:
            return None
        outcome = perform_all(live.ctx, solution.steps)
        if outcome.ok:
            outcome = hold(live.ctx, duration)
        return hand.held(outcome)


def _stages(ctx: TaskContext, item: str, gripper: Gripper, grasp: Grasp, hand: _Hand) -> list[Stage]:
    """Return the stages of a pick with one given grasp. The pick tests whether the predicted grasp success is
    right.

    One step records the pose of the object in the hand.
    """
    stages = pick_stages(ctx.scene(), item, gripper, ctx.settings, among=(grasp.name,))
    closed = next(i for i, stage in enumerate(stages) if isinstance(stage, Close))
    return [*stages[: closed + 1], RunSteps("closed", (hand,)), *stages[closed + 1 :]]


class _Hand:
    """Task stage that measures the true pose of an object in the hand, to test a grasp prediction."""

    def __init__(self, world: SimWorld, gripper: Gripper, item: str):
        self._world, self._gripper, self._item = world, gripper, item
        self._closed: SE3 | None = None  # T_tcp_object

    def perform(self, ctx: TaskContext) -> Outcome:
        """Record the pose of an object relative to the gripper right after the grasp. The test of a grasp
        prediction later measures how far the object has slipped from this pose.
        """
        self._closed = self._now()
        return DONE

    def _now(self) -> SE3:
        return self._world.link_pose(self._gripper.tcp_link).inverse() @ self._world.object_pose(self._item)

    def held(self, outcome: Outcome) -> HoldResult:
        """Return the result of a pick that tests a grasp prediction: whether the hand held the object during
        the lift and the hold, and how far the object slipped and turned.
        """
        if self._closed is None:
            return HoldResult(False, reason=outcome.message)
        moved = self._now() @ self._closed.inverse()  # in the TCP frame
        slip, turn = moved.distance_to(SE3.identity())
        between = self._world.gripper_state(self._gripper.name).held == self._item
        reason = outcome.message or ("" if between else "nothing is between the fingers")
        return HoldResult(outcome.ok and between, slip, turn, reason)


def scores(
    objects: Sequence[str], probability: Sequence[float], epsilon: Sequence[float], success: Sequence[bool]
) -> dict[str, Any]:
    """Score three predictors of grasp success on the results of trials: the probability P of the grasp proof,
    the grasp quality epsilon, and the base rate.

    `brier_lead` is the Brier score of epsilon minus that of P. `brier_proof_interval` and
    `brier_lead_interval` are 95 % bootstrap intervals over objects. An area under the curve is None without
    successes or without failures.

    Args:
        objects, probability, epsilon, success: one value per trial.
    """
    names, p, happened = np.array(objects), np.array(probability, float), np.array(success, float)
    means = leave_one_out_mean(names, happened)
    curve = leave_one_out_curve(names, np.array(epsilon, float), happened)
    found: dict[str, Any] = {"predictions": len(p), "successes_of_predictions": int(happened.sum())}
    for name, q in (("proof", p), ("epsilon", curve), ("base_rate", means)):
        found[f"brier_{name}"] = float(np.mean((q - happened) ** 2))
        clipped = np.clip(q, LEAST, 1 - LEAST)
        found[f"log_loss_{name}"] = float(
            -np.mean(happened * np.log(clipped) + (1 - happened) * np.log(1 - clipped))
        )
    found["auc_proof"] = area_under_curve(p, happened)
    found["auc_epsilon"] = area_under_curve(np.array(epsilon, float), happened)
    found["brier_proof_interval"] = _interval(names, (p - happened) ** 2)
    lead = (curve - happened) ** 2 - (p - happened) ** 2
    found["brier_lead"] = float(lead.mean())
    found["brier_lead_interval"] = _interval(names, lead)
    found["reliability"] = reliability(p, happened)
    return found


def reliability(p: Array, happened: Array) -> list[dict[str, float]]:
    """Group the predicted probabilities of grasp success into bins. Return the limits, count, mean prediction
    and observed success rate of each nonempty bin.
    """
    rows = []
    bins = np.clip(np.searchsorted(EDGES, p, side="right") - 1, 0, len(EDGES) - 2)
    for k in np.unique(bins):
        inside = bins == k
        rows.append(
            {
                "from": EDGES[k], "to": EDGES[k + 1], "n": int(inside.sum()),
                "predicted": float(p[inside].mean()), "happened": float(happened[inside].mean()),
            }
        )  # fmt: skip
    return rows


def area_under_curve(score: Array, happened: Array) -> float | None:
    """Return the AUC of grasp predictions: the probability that a successful grasp has a higher score than a
    failed one.

    Ties count half. The result is None without successes or without failures.
    """
    good, bad = score[happened > 0.5], score[happened <= 0.5]
    if not len(good) or not len(bad):
        return None
    less = np.searchsorted(np.sort(bad), good, side="left")
    upto = np.searchsorted(np.sort(bad), good, side="right")
    return float((less + upto).mean() / (2 * len(bad)))


def leave_one_out_mean(objects: NDArray[np.str_], happened: Array) -> Array:
    """Predict the probability of grasp success in each trial by the base rate: the success rate in the trials
    of all other objects, or 0.5 without other objects.
    """
    found = np.full(len(happened), 0.5)
    for name in np.unique(objects):
        own = objects == name
        if not own.all():
            found[own] = happened[~own].mean()
    return found


def leave_one_out_curve(objects: NDArray[np.str_], epsilon: Array, happened: Array) -> Array:
    """Predict the probability of grasp success in each trial from the grasp quality epsilon. The logistic
    curve for a trial is fitted to the trials of all other objects.
    """
    from scipy.optimize import minimize

    x = (epsilon - epsilon.mean()) / max(float(epsilon.std()), 1e-12)

    def loss(w: Array, keep: NDArray[np.bool_]) -> float:
        z = w[0] + w[1] * x[keep]
        return float(np.sum(np.logaddexp(0.0, z) - happened[keep] * z) + RIDGE * w @ w)

    found = np.empty(len(x))
    for name in np.unique(objects):
        own = objects == name
        w = minimize(loss, np.zeros(2), args=(~own,)).x
        found[own] = 1 / (1 + np.exp(-(w[0] + w[1] * x[own])))
    return found


def _interval(objects: NDArray[np.str_], loss: Array) -> tuple[float, float]:
    """Return the 95 % bootstrap interval for the mean loss of a grasp predictor, or for the mean difference
    between the losses of two. The bootstrap resamples objects, not trials.

    Each resampled object keeps all its trials.
    """
    names, index = np.unique(objects, return_inverse=True)
    total, count = np.bincount(index, loss), np.bincount(index)
    drawn = np.random.default_rng(0).integers(len(names), size=(RESAMPLED, len(names)))
    means = total[drawn].sum(1) / count[drawn].sum(1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)
