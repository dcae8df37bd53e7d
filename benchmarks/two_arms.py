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
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import beta

import armcell
from armcell.cell import run_task
from armcell.cell.live import LiveCell
from armcell.collision import ExactChecker
from armcell.collision.inter_arm_checker import InterArmChecker
from armcell.collision.motion_proof import ActiveMotion, first_conflict
from armcell.core import SE3, Box, PlanRequest, PoseGoal
from armcell.execution import execute_coupled
from armcell.planning import plan_synchronized
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks import checked

LEFT, RIGHT = "left_arm", "right_arm"
SPEED = {"velocity_scaling": 0.6, "acceleration_scaling": 0.25}
TASKS = ("dual_ur10_rod", "dual_ur10_sort", "dual_ur10_screw")
TRAYS = ("red_tray", "blue_tray")
COLUMNS = (-0.11, 0.0, 0.11)  # [m] of the slots on a tray, as in dual_ur10_sort's task
ROWS = {LEFT: 0.08, RIGHT: -0.08}


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
    arms = InterArmChecker(scene, (LEFT, RIGHT))
    while sum(how.values()) < count:
        result = plan_synchronized(
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


def gate_proofs(count: int) -> dict[str, list[float]]:
    """The motion gate's proofs [ms] of motions of 2 to 6 s: median and largest, by what was new since the
    last proof."""
    scene, rng = armcell.load("dual_ur10").scene(), np.random.default_rng(1)
    scene = scene.with_object(CollisionObject.single("crate", Box(0.1, 0.1, 0.1), movable=True))
    spent: dict[str, list[float]] = {}

    def prove(what: str, there: PlanningScene, *motions: ActiveMotion) -> None:
        t0 = time.thread_time()
        first_conflict(there, motions[0], motions[1:])
        spent.setdefault(what, []).append(1000 * (time.thread_time() - t0))

    for _ in range(count + 1):
        result = None
        while result is None or result.trajectory is None or result.trajectories is None:
            goals = {LEFT: tip(rng), RIGHT: tip(rng)}
            result = plan_synchronized(scene, goals, template=PlanRequest(LEFT, (), **SPEED))
        left, right = (ActiveMotion(result.trajectories[g]) for g in (LEFT, RIGHT))
        moved = scene.with_object_pose("crate", SE3.from_xyz(0.0, 0.0, rng.uniform(0.2, 0.3)))
        prove("both arms as one, an object moved", moved, ActiveMotion(result.trajectory))
        prove("both arms as one, nothing new", moved, ActiveMotion(result.trajectory))
        prove("beside an arm that moves, nothing new", moved, left, right)
        rests = scene.with_state(left.trajectory.end)
        prove("beside an arm that rests elsewhere", rests, right)
        prove("beside an arm that rests, nothing new", rests, right)
    return {what: [float(np.median(ms[1:])), float(np.max(ms[1:]))] for what, ms in spent.items()}


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

        assert execute_coupled(live.driver, live.ctx.gate.motion(result.trajectory), watch=watch)
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


@dataclass(frozen=True)
class Way:
    """How two streams are sorted."""

    step: str = ""  # "motions": both begin each one together; "objects": they meet after each pick and place
    orders: bool = False  # chosen for both arms at the start, else as the cubes come
    rows: bool = False  # each arm fills the row of a tray that is on its side, else slots as they come


WAYS = {
    "own pace": Way(orders=True, rows=True),
    "own pace, order given": Way(rows=True),
    "in step": Way("motions"),
    "in step, own rows": Way("motions", rows=True),
    "in step, own rows, order chosen": Way("motions", orders=True, rows=True),
    "in step after each pick and place": Way("objects"),
    "one after the other": Way(orders=True, rows=True),
}
OWN, STEP, SEQUENTIAL = "own pace", "in step", "one after the other"


class Sorter:
    """Both arms' programs."""

    def __init__(self, live: LiveCell, seed: int, way: Way):
        self.way, objects = way, live.scene().objects
        self.x = {n: float(o.T_world_object.translation[0]) for n, o in objects.items()}
        cubes = [n for n, o in objects.items() if o.movable]
        cubes = np.random.default_rng(seed).permutation(cubes).tolist()
        streams = {arm: [c for c in cubes if c.startswith(arm.removesuffix("_arm"))] for arm in ROWS}
        self.streams = live.orders(tray_of, **streams) if way.orders else streams
        self.free = {tray: [(x, y) for y in ROWS.values() for x in COLUMNS] for tray in TRAYS}
        self.over: dict[str, str] = {}  # the tray that an arm is on its way to or at
        self.begun = dict.fromkeys(ROWS, 0)

    def slot(self, group: str, cube: str) -> tuple[float, float]:
        free = self.free[tray_of(cube)]
        if not self.way.rows:
            return free.pop(0)
        mine = [slot for slot in free if slot[1] == ROWS[group]]
        slot = min(mine, key=lambda s: abs(self.x[tray_of(cube)] + s[0] - self.x[cube]))
        free.remove(slot)
        return slot

    def program(self, arm) -> None:
        group, step = arm.group, self.way.step
        if step == "motions":
            self._in_step(arm)
        for k, cube in enumerate(self.streams[group]):
            checked(arm.pick(cube))
            if step:
                arm.rendezvous(f"picked {k}")
            self.over[group] = tray_of(cube)
            if step == "motions":
                arm.rendezvous(f"to the trays {k}")
            with arm.reserve(tray_of(cube)):
                checked(arm.place(cube, on=tray_of(cube), at=self.slot(group, cube)))
            if step:
                arm.rendezvous(f"placed {k}")
            self.over.pop(group, None)
            if step == "motions":
                arm.rendezvous(f"from the trays {k}")
        checked(arm.move_to("home"))

    def _in_step(self, arm) -> None:
        """Every motion begins when both arms are ready for theirs, so that both end before the next; but
        over one tray they are one after the other."""
        ctx = arm._ctx
        request_start = ctx.request_start

        def together(motion):
            over = list(self.over.values())
            if len(over) != 1 and len(set(over)) == len(over):
                arm.rendezvous(f"motion {self.begun[arm.group]}")
                self.begun[arm.group] += 1
            return request_start(motion)

        ctx.request_start = together


def tray_of(cube: str) -> str:
    return "red_tray" if "_red_" in cube else "blue_tray"


def makespans(batches: int) -> dict:
    """The same batches sorted at the arms' own pace, in step, and one arm after the other [s]."""
    cell = armcell.load("dual_ur10_sort")
    times: dict[str, list[float]] = {how: [] for how in WAYS}
    waits = yielded = searched = 0.0
    for seed in range(batches):
        for how, spent in times.items():
            with cell.connect("sim", seed=seed) as live:
                sorter = Sorter(live, seed, WAYS[how])
                if how == SEQUENTIAL:
                    for group in ROWS:
                        sorter.program(live[group])
                    spent.append(live.driver.now)
                    continue
                result = checked(live.side_by_side(left_arm=sorter.program, right_arm=sorter.program))
                spent.append(result.makespan)
                if how == OWN:
                    waits += sum(result.waited.values())
                    yielded += sum(result.yielded.values())
                    searched += sum(result.searched.values())
        print(f"  batch {seed}: " + ", ".join(f"{k} {v[-1]:.1f} s" for k, v in times.items()), flush=True)
    mean = {k: float(np.mean(v)) for k, v in times.items()}
    return {
        "batches": batches, "mean_s": mean, "of_sequential": mean[OWN] / mean[SEQUENTIAL],
        "of_synchronous": {how: mean[OWN] / mean[how] for how in mean if how.startswith(STEP)},
        "waited_s": waits, "made_way": yielded, "searched": searched,
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
    found["gate_ms"] = gate_proofs(100)
    for what, (median, largest) in found["gate_ms"].items():
        print(f"proof at a motion's start, {what}: median {median:.2f}, largest {largest:.2f} ms")
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
    print("makespans: " + ", ".join(f"{how} {seconds:.1f} s" for how, seconds in m["mean_s"].items()))
    print(f"  {m['of_sequential']:.3f} of sequential;", end=" ")
    print(", ".join(f"{share:.3f} of {how}" for how, share in m["of_synchronous"].items()))
    print(f"  waited {m['waited_s']:.1f} s, made way {m['made_way']:.0f} times,", end=" ")
    print(f"went round {m['searched']:.0f} times")
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
