"""Predicted success probabilities of grasps, against simulated picks with objects of another source.

    python -m benchmarks.grasp_probability --factors 1 2 4 8 --count 6

The probability P of a grasp was fitted to armcell's object library and to meshes of `random_urdfs`. This
benchmark predicts picks of the objects in `grasp_objects.py`, which come from other packages. The true pose,
friction and mass of the object differ from the believed ones by noise, which P also assumes. The noise grows
by the given factors until at least 20 % of the picks fail, because a few failures cannot show whether P is
calibrated.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from typing import Any

from armcell.cell.grasp_benchmark import HOLD, OBJECT, Bench, TrialOptions
from armcell.cell.grasp_predictions import Prediction, predictions, scores
from armcell.core import ArmcellError
from armcell.grasping import Noise, grasp_candidates, hand_of
from armcell.tasks.grasp_proof import NOISE
from benchmarks.grasp_objects import HALVES, Listed, graspable, listed, load

FAILED = 0.2  # share of failed picks at which the noise is large enough
FARTHEST = 0.08  # largest difference of predicted and observed success in a bin with many trials
MANY = 40  # trials


@cache
def _bench(robot: str) -> Bench:
    return Bench(TrialOptions(robot))


def predicted(robot: str, entry: Listed, factor: float, count: int) -> list[Prediction]:
    """Return the predictions and the results of picks of one object; empty if it is not graspable."""
    bench = _bench(robot)
    hand = hand_of(bench.model, bench.gripper)
    try:
        placed = next(bench.at_rest(replace(load(entry), name=OBJECT)), None)
    except ArmcellError:
        return []
    if placed is None or graspable(placed, bench.model, bench.gripper, hand.pad):
        return []
    grasps, _ = grasp_candidates(placed, hand)
    noise = Noise(
        factor * NOISE.position, factor * NOISE.rotation, factor * NOISE.friction, factor * NOISE.mass
    )
    settings, seed = replace(bench.settings, prove_grasps=0), (0, zlib.crc32(entry.name.encode()))
    scene = bench.table.with_object(placed)
    return predictions(scene, placed, bench.gripper, grasps, settings, count, HOLD, seed, noise)


def report(factor: float, found: dict[str, Any]) -> Iterator[str]:
    """Yield the lines with the scores of the picks with one noise factor."""
    failures = found["predictions"] - found["successes_of_predictions"]
    share = 100 * failures / max(found["predictions"], 1)
    yield f"noise x {factor:g}: {found['predictions']} predictions, {failures} failures ({share:.0f} %)"
    for name, text in (("proof", "P"), ("epsilon", "epsilon"), ("base_rate", "mean rate")):
        yield f"  Brier score of {text}: {found[f'brier_{name}']:.4f}"
    low, high = found["brier_proof_interval"]
    yield f"  95 % interval of P's Brier score: {low:.4f} to {high:.4f}"
    low, high = found["brier_lead_interval"]
    yield f"  P's lead over epsilon: {found['brier_lead']:.4f} ({low:.4f} to {high:.4f})"
    yield f"  area under the curve: {found['auc_proof']} (P), {found['auc_epsilon']} (epsilon)"
    yield "| P | trials | predicted | observed |\n|---|---|---|---|"
    for row in found["reliability"]:
        rates = f"{100 * row['predicted']:.1f} % | {100 * row['happened']:.1f} %"
        yield f"| {row['from']:.2f} to {row['to']:.2f} | {row['n']} | {rates} |"
    apart = sum(row["n"] * abs(row["predicted"] - row["happened"]) for row in found["reliability"])
    yield f"expected calibration error: {100 * apart / max(found['predictions'], 1):.1f} points"


def is_calibrated(found: dict[str, Any]) -> bool:
    """Return whether the observed success is near the predicted one in each bin with many trials."""
    many = [row for row in found["reliability"] if row["n"] >= MANY]
    return all(abs(row["predicted"] - row["happened"]) <= FARTHEST for row in many)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--factors", type=float, nargs="+", default=(1.0, 2.0, 4.0, 8.0))
    parser.add_argument("--count", type=int, default=6, help="picks per object")
    parser.add_argument("--half", choices=HALVES, help="default: both")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every Nth object")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args(argv)
    chosen = [e for e in listed() if given.half in (None, e.half)][:: given.every]
    for entry in {e.source: e for e in chosen}.values():
        load(entry)  # one download, before the workers start
    good = True
    with ProcessPoolExecutor(given.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for factor in given.factors:
            jobs = [pool.submit(predicted, given.robot, e, factor, given.count) for e in chosen]
            rows = [(e.name, p) for e, job in zip(chosen, jobs, strict=True) for p in job.result()]
            columns = [(name, p.probability, p.epsilon, p.success) for name, p in rows]
            found = scores(*zip(*columns, strict=True))
            print(*report(factor, found), sep="\n", flush=True)
            good &= is_calibrated(found)
            if sum(p.success for _, p in rows) <= (1 - FAILED) * len(rows):
                return 0 if good else 1
    print(f"fewer than {100 * FAILED:.0f} % of the picks failed: give larger factors")
    return 1


if __name__ == "__main__":
    sys.exit(main())
