"""Two UR10: planning, proofs and tasks in physics, with the numbers that the cell promises.

    python -m benchmarks.two_arms --runs 20

Times of planning and proofs are CPU times of the thread. Makespans are the simulated clock's; planning takes
none of it. Executed motions, the joint positions of every command tick joined by straight lines, are measured
by coal: robot against itself and against all that stands, proven free all along by conservative advancement;
in the first runs, and where that fails, also looked at every millisecond.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import beta

import armcell
from armcell.cell import run_task
from armcell.cell.live import LiveCell
from armcell.collision import ExactChecker
from armcell.collision.arms import Arms
from armcell.control.coupled import execute_coupled
from armcell.core import SE3, PlanRequest, PoseGoal
from armcell.planning import plan_together
from armcell.tasks import checked

LEFT, RIGHT = "left_arm", "right_arm"
SPEED = {"velocity_scaling": 0.6, "acceleration_scaling": 0.25}
TASKS = ("dual_ur10_rod", "dual_ur10_sort", "dual_ur10_screw")
SLOTS = [(x, y) for y in (0.055, -0.055) for x in (-0.11, 0.0, 0.11)]


def lower_bound(successes: int, runs: int) -> float:
    """Clopper and Pearson's one-sided 95 % bound of a success rate."""
    return 0.0 if successes == 0 else float(beta.ppf(0.05, successes, runs - successes + 1))


def tip(rng: np.random.Generator) -> PoseGoal:
    x, y, z = rng.uniform((-0.5, -0.25, 0.98), (0.5, 0.25, 1.3))
    return PoseGoal(SE3.from_xyz_rpy((x, y, z), (np.pi, 0.0, rng.uniform(-1, 1))))


def pairs(count: int) -> dict:
    """Synchronous pairs to random poses: how found, time of the last proof, arrival in physics."""
    cell = armcell.load("dual_ur10")
    scene, rng = cell.scene(), np.random.default_rng(0)
    how: dict[str, int] = {}
    recheck, arrival = [], []
    arms = Arms(scene, (LEFT, RIGHT))
    while sum(how.values()) < count:
        result = plan_together(
            scene, {LEFT: tip(rng), RIGHT: tip(rng)}, template=PlanRequest(LEFT, (), **SPEED)
        )
        if not result.ok or result.trajectory is None or result.trajectories is None:
            how[result.code.name] = how.get(result.code.name, 0) + 1
            continue
        how[result.how] = how.get(result.how, 0) + 1
        both = [result.trajectories[g] for g in (LEFT, RIGHT)]
        for _ in range(3):
            t0 = time.thread_time()
            arms.certify(both[0], both[1], clearance=0.02, evidence=False)
            spent = time.thread_time() - t0
        recheck.append(spent)
        if len(arrival) < 10:
            arrival.append(_arrival(cell, result))
    return {
        "pairs": how, "recheck_ms": [1000 * float(v) for v in (np.median(recheck), np.max(recheck))],
        "arrival_ms": 1000 * max(arrival),
    }  # fmt: skip


def _arrival(cell, result) -> float:
    """[s] between the two arms' arrivals in physics.

    An arm has arrived when its motion's time is over and it rests within the executor's goal tolerance.
    """
    arrived: dict[str, float] = {}
    settings = cell.settings.execution
    with cell.connect("sim") as live:

        def watch() -> None:
            for group, motion in result.trajectories.items():
                state = live.driver.joint_state().reindexed(motion.joint_names)
                off = np.max(np.abs(state.positions - motion.positions[-1]))
                rests = np.max(np.abs(state.velocities)) <= settings.goal_speed
                over = live.driver.now >= motion.duration - 1e-6
                if over and rests and off <= settings.goal_tolerance:
                    arrived.setdefault(group, live.driver.now)

        assert execute_coupled(live.driver, result.trajectory, watch=watch)
    first, second = arrived.values()
    return abs(first - second)


class Recorder:
    """Joint positions at every command tick."""

    def __init__(self, driver):
        self.rows: list[np.ndarray] = []
        self.times: list[float] = []
        advance = driver.advance

        def seen(duration: float) -> None:
            advance(duration)
            self.times.append(driver.now)
            self.rows.append(driver.joint_state().positions)

        driver.advance = seen

    def _looked_at(self, scene) -> tuple[ExactChecker, np.ndarray]:
        still = {n: o for n, o in scene.objects.items() if not o.movable}
        checker = ExactChecker(replace(scene.with_padding(0.0), objects=still))
        return checker, np.clip(np.array(self.rows), scene.model.lower, scene.model.upper)

    def proven(self, scene) -> bool:
        """Whether coal's distances prove that the robot touched neither itself nor what stands."""
        checker, rows = self._looked_at(scene)
        return checker.certify(rows).free

    def contacts(self, scene) -> int:
        """Milliseconds in which coal sees the robot touch itself or what stands."""
        checker, rows = self._looked_at(scene)
        t = np.arange(self.times[0], self.times[-1], 1e-3)
        q = np.column_stack([np.interp(t, self.times, c) for c in rows.T])
        moved = np.concatenate([[True], np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-6])
        return sum(not checker.is_free(row) for row in q[moved])


def task(name: str, runs: int, recheck: int) -> dict:
    """A task's runs in physics, each of another draw."""
    cell = armcell.load(name)
    out: dict = {"runs": runs, "successes": 0, "physics_contacts": 0, "coal_contacts": 0, "proven": 0,
                 "rechecked": 0}  # fmt: skip
    worst: dict[str, float] = {}
    makespans, failures = [], []
    spent: list[float] = []
    for seed in range(runs):
        began = time.process_time()
        with cell.connect("sim", seed=seed) as live:
            recorder = Recorder(live.driver)
            result = run_task(cell, live, seed, "sim")
        spent.append(time.process_time() - began)
        out["successes"] += bool(result["success"])
        if not result["success"]:
            failures.append(f"{seed}: {result['message']}")
        out["physics_contacts"] += len(result["unwanted_contacts"])
        makespans.append(result["task_time_s"])
        for key, value in result["measures"].items():
            if isinstance(value, int | float):
                worst[key] = max(worst.get(key, -np.inf), value)
        proven = recorder.proven(cell.scene(seed))
        out["proven"] += proven
        if seed < recheck or not proven:
            out["coal_contacts"] += recorder.contacts(cell.scene(seed))
            out["rechecked"] += 1
        print(f"  {name} {seed}: {'ok' if result['success'] else result['message']}", flush=True)
    out["cpu_s"] = float(np.median(spent))
    out["lower_bound"] = lower_bound(out["successes"], runs)
    out |= {"largest": worst, "task_time_s": float(np.mean(makespans)), "failures": failures}
    return out


def _sorter(live: LiveCell, seed: int, synchronous: bool, chosen: bool) -> tuple[Callable, Callable]:
    """Both arms' programs. With `chosen` they take the cubes in an order that keeps them apart."""
    taken: dict[str, int] = {"red_tray": 0, "blue_tray": 0}
    order = np.random.default_rng(seed).permutation
    cubes = order([n for n, o in live.scene().objects.items() if o.movable]).tolist()

    def tray_of(cube: str) -> str:
        return "red_tray" if "_red_" in cube else "blue_tray"

    def program(side: str) -> Callable:
        def sort(arm) -> None:
            left, k = [c for c in cubes if c.startswith(side)], 0
            while left:
                cube = arm.choose(left, zone=tray_of) if chosen else left[0]
                left.remove(cube)
                tray = tray_of(cube)
                checked(arm.pick(cube))
                if synchronous:
                    arm.meet(f"picked {k}")
                with arm.reserve(tray):
                    slot = SLOTS[taken[tray]]
                    taken[tray] += 1
                    checked(arm.place(cube, on=tray, at=slot))
                if synchronous:
                    arm.meet(f"placed {k}")
                k += 1
            checked(arm.move_to("home"))

        return sort

    return program("left"), program("right")


WAYS = {"asynchronous": (False, True), "asynchronous, order given": (False, False),
        "synchronous": (True, False), "synchronous, order chosen": (True, True),
        "sequential": (False, False)}  # fmt: skip
"""Whether the arms meet, and whether they choose what comes next."""


def makespans(batches: int) -> dict:
    """The same batches sorted at the arms' own pace, in step, and one arm after the other [s]."""
    cell = armcell.load("dual_ur10_sort")
    times: dict[str, list[float]] = {how: [] for how in WAYS}
    waits = made_way = searched = 0.0
    for seed in range(batches):
        for how, spent in times.items():
            with cell.connect("sim", seed=seed) as live:
                left, right = _sorter(live, seed, *WAYS[how])
                if how == "sequential":
                    left(live[LEFT])
                    right(live[RIGHT])
                    spent.append(live.driver.now)
                    continue
                result = checked(live.side_by_side(left_arm=left, right_arm=right))
                spent.append(result.makespan)
                if how == "asynchronous":
                    waits += sum(result.waited.values())
                    made_way += sum(result.made_way.values())
                    searched += sum(result.searched.values())
        print(f"  batch {seed}: " + ", ".join(f"{k} {v[-1]:.1f} s" for k, v in times.items()), flush=True)
    mean = {k: float(np.mean(v)) for k, v in times.items()}
    return {
        "batches": batches, "mean_s": mean, "of_sequential": mean["asynchronous"] / mean["sequential"],
        "of_synchronous": mean["asynchronous"] / mean["synchronous"], "waited_s": waits,
        "at_best_of_synchronous": 0.5 * mean["sequential"] / mean["synchronous"],  # no waits, no detours
        "made_way": made_way, "searched": searched,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100, help="of each task")
    parser.add_argument("--recheck", type=int, default=5, help="runs of each task looked at every ms")
    parser.add_argument("--batches", type=int, default=20)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found: dict = {}
    found["pairs"] = p = pairs(100)
    print(
        f"pairs: {p['pairs']}; re-check median {p['recheck_ms'][0]:.2f}, largest {p['recheck_ms'][1]:.2f} ms"
    )
    print(f"arrivals in physics differ by at most {p['arrival_ms']:.1f} ms")
    for name in TASKS:
        found[name] = t = task(name, given.runs, given.recheck)
        print(f"{name}: {t['successes']} of {t['runs']} (at least {100 * t['lower_bound']:.1f} % at 95 %),")
        print(
            f"  {t['cpu_s']:.1f} s of processor time a run; "
            f"{t['physics_contacts']} contacts in physics, {t['proven']} runs proven free by coal, "
            f"{t['coal_contacts']} ms of contact",
            end="",
        )
        print(
            f" in the {t['rechecked']} looked at every ms; largest "
            + ", ".join(f"{k} {v:.3g}" for k, v in t["largest"].items())
        )
    found["makespans"] = m = makespans(given.batches)
    print(f"makespans: {m['mean_s']}; {m['of_sequential']:.2f} of sequential,", end=" ")
    print(
        f"{m['of_synchronous']:.2f} of synchronous (arms that never wait: {m['at_best_of_synchronous']:.2f});"
    )
    print(f"waited {m['waited_s']:.1f} s, made way {m['made_way']:.0f} times")
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
