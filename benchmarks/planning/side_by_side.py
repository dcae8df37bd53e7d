"""All planners on the same problems, one problem after the other, in one process."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rich.progress import track

from armcell.cli.bench_plans import path_length
from benchmarks.planning.peers import FAST, NATIVE, Peer, Result, UnsupportedRobot
from benchmarks.planning.pinocchio_world import PinocchioWorld
from benchmarks.planning.problems import Problem, Robot
from benchmarks.planning.recheck import first_contact

Row = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """Of one run over one robot's problems."""

    seconds: float = 5.0  # [s] wall time a planner gets for one run
    repeat: int = 3  # runs per problem, the fastest counts; the same rule for every planner ...
    enough: float = 0.1  # [s] ... and none once they took this long together: noise matters no more
    sample: int = 5  # planners other than armcell's are re-checked on every n-th problem of the order
    budget: float = 200.0  # [s] CPU time after which only the fast planners go on ...
    end: float = 400.0  # [s] ... and after which no new problem is begun


def compare(
    robot: Robot, problems: list[Problem], peers: Iterable[tuple[Peer, int]], settings: Settings
) -> list[Row]:
    """Rows of every planner and problem.

    Args:
        peers: with each, on every how many-th problem of the order it runs.
    """
    world = PinocchioWorld(robot)
    ready: list[tuple[Peer, int]] = []
    logger = logging.getLogger("armcell.model")
    before = logger.level
    logger.setLevel(logging.ERROR)  # the visual meshes that are missing would be said for every planner
    for peer, every in peers:
        try:
            peer.load(robot)
            ready.append((peer, every))
        except UnsupportedRobot as reason:
            print(f"Leaving out {peer.name}: {reason}", file=sys.stderr)
    logger.setLevel(before)
    rows: list[Row] = []
    began = time.process_time()
    for i, problem in enumerate(track(problems, f"{robot.name:8}", transient=True)):
        spent = time.process_time() - began
        if spent > settings.end:
            break
        world.set_problem(problem)
        touching = world.contact(problem.start) or world.contact(problem.goal)
        for peer, every in ready:
            if i % every or (spent > settings.budget and peer.name not in FAST):
                continue
            row = {"robot": robot.name, "planner": peer.name, "family": problem.family,
                   "index": problem.index, "solved": False}  # fmt: skip
            rows.append(row)
            if touching:
                row["touching"] = touching
                continue
            peer.set_problem(problem)
            result = _fastest(peer, settings)
            row |= {"plan_us": result.plan_us, "simplify_us": result.simplify_us,
                    "certify_us": result.certify_us}  # fmt: skip
            if result.waypoints is None:
                continue
            row |= {"solved": True, "length_raw": path_length(result.raw),
                    "length": path_length(result.waypoints)}  # fmt: skip
            if peer.name == NATIVE or i % settings.sample == 0:
                row["contact"] = first_contact(world, result.waypoints)
    return rows


def _fastest(peer: Peer, settings: Settings) -> Result:
    best, spent = None, 0.0
    for _ in range(settings.repeat):
        result = peer.plan(0, settings.seconds)
        spent += result.total_us * 1e-6
        if best is None or result.total_us < best.total_us:
            best = result
        if result.waypoints is None or spent > settings.enough:
            break
    assert best is not None
    return best
