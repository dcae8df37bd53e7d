"""A rod in two hands among random obstacles: how often a way round is found, and how long that takes.

    python -m benchmarks.carry --scenes 100 --recheck 30 --physics 12

Only scenes in which the straight way is blocked and both ends are free count. Times are CPU times of the
thread. The motions are looked at by coal every millisecond, and the hands' relative pose is taken from
forward kinematics there.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import armcell
from armcell.collision import ExactChecker, neighbors
from armcell.core import SE3, SO3, Box, Cylinder, JointState, JointTrajectory, PlanResult
from armcell.kinematics import kinematic_tree
from armcell.planning.multi_arm.carry import plan_carry
from armcell.planning.multi_arm.closed_chain import CarriedObject, ClosedChainIK
from armcell.scene import CollisionObject, PlanningScene

ENDS = {"left_arm": "front_end", "right_arm": "back_end"}
TABLE = 0.9  # [m] its top
ROD = (0.0, 0.08, 0.946)  # [m] on its rests
RESTS = ("front_rest", "back_rest")
SPEED = {"velocity_scaling": 0.3, "acceleration_scaling": 0.15, "max_speed": 0.2}


@dataclass(frozen=True, eq=False)
class Carry:
    """The rod in both hands, where it goes, and what it rests on."""

    kind: str
    scene: PlanningScene  # the rod attached, and allowed to touch the hands and what it rests on
    carried: CarriedObject
    start: SE3
    goal: SE3
    rests_on: tuple[str, ...]

    def plan(self, **given) -> PlanResult:
        return plan_carry(
            self.scene, "both_arms", self.carried, self.start, [self.goal], **SPEED,
            rests_on=self.rests_on, **given,
        )  # fmt: skip


@lru_cache(maxsize=1)
def cell() -> armcell.Cell:
    return armcell.load("dual_ur10_rod")


def held(
    start: SE3, obstacles: list[CollisionObject]
) -> tuple[PlanningScene, CarriedObject, tuple[str, ...]] | None:
    """The rod at a pose in both hands among obstacles, and what it rests on; None where nothing is free."""
    scene = cell().scene().with_object_pose("rod", start)
    for item in obstacles:
        scene = scene.with_object(item)
    model, rod = scene.model, scene.object("rod")
    grippers = {g: model.gripper(arm_group=g) for g in ENDS}
    for gripper in grippers.values():
        fingers = JointState((gripper.joint_name,), np.array([gripper.joint_position(0.03)]))
        scene = scene.with_state(fingers)
    first, second = grippers.values()
    supports = tuple(n for n in neighbors(scene, "rod") if n in RESTS)  # never an obstacle
    for turns in ((0.0, 0.0), (0.0, np.pi), (np.pi, 0.0), (np.pi, np.pi)):
        grasps = {
            g: rod.subframes[end] @ SE3(SO3.exp((0.0, 0.0, turn)), np.zeros(3))
            for (g, end), turn in zip(ENDS.items(), turns, strict=True)
        }
        carried = CarriedObject("rod", grasps, {g: grippers[g].tcp_link for g in ENDS})
        postures = ClosedChainIK(scene, carried).postures(start, scene.positions)
        for q in postures if isinstance(postures, list) else ():
            at = scene.with_state(JointState(model.joint_names, q))
            at = at.with_attached("rod", first.tcp_link, first.hand_links)
            at = at.with_allowed("rod", (*second.hand_links, *supports))
            if ExactChecker(at, model.group("both_arms").joint_names).is_free(
                at.state.reindexed(model.group("both_arms").joint_names).positions
            ):
                return at, carried, supports
    return None


def _wall(rng: np.random.Generator) -> list[CollisionObject]:
    """Along the rod, between where it is and where it goes."""
    height, wide = rng.uniform(0.08, 0.3), rng.uniform(0.3, 1.2)
    pose = SE3.from_xyz_rpy((rng.uniform(-0.1, 0.1), 0.0, TABLE + height / 2), (0, 0, rng.uniform(-0.1, 0.1)))
    return [CollisionObject.single("wall", Box(wide, 0.02, height - 0.002), pose)]


def _posts(rng: np.random.Generator) -> list[CollisionObject]:
    found = []
    for k in range(int(rng.integers(1, 4))):
        height, radius = rng.uniform(0.1, 0.4), rng.uniform(0.01, 0.03)
        at = (rng.uniform(-0.35, 0.35), rng.uniform(-0.02, 0.02), TABLE + height / 2 + 0.001)
        found.append(CollisionObject.single(f"post_{k}", Cylinder(radius, height), SE3.from_xyz(*at)))
    return found


def _bar(rng: np.random.Generator) -> list[CollisionObject]:
    """In the air, where the rod is lifted to: it goes over or under."""
    pose = SE3.from_xyz(rng.uniform(-0.1, 0.1), rng.uniform(-0.02, 0.02), TABLE + rng.uniform(0.15, 0.3))
    return [CollisionObject.single("bar", Box(rng.uniform(0.2, 0.8), 0.04, 0.04), pose)]


def _block(rng: np.random.Generator) -> list[CollisionObject]:
    size = rng.uniform((0.08, 0.03, 0.1), (0.25, 0.06, 0.35))
    pose = SE3.from_xyz(rng.uniform(-0.3, 0.3), rng.uniform(-0.02, 0.02), TABLE + size[2] / 2 + 0.001)
    return [CollisionObject.single("block", Box(*size), pose)]


KINDS = {"wall": _wall, "posts": _posts, "bar": _bar, "block": _block}


def draw(rng: np.random.Generator, kind: str) -> Carry | None:
    """A scene of a kind; None where an end is not free or the straight way is."""
    obstacles = KINDS[kind](rng)
    lift = rng.uniform(0.12, 0.3) if kind == "bar" else rng.choice([0.0, rng.uniform(0.0, 0.2)])
    tilt = rng.uniform(-0.15, 0.15) if lift > 0.12 else 0.0
    side = rng.choice([-1.0, 1.0])
    ends = []
    for sign in (side, -side):
        y = sign * rng.uniform(0.08, 0.2)
        turn = rng.uniform(-0.3, 0.3)
        ends.append(SE3.from_xyz_rpy((rng.uniform(-0.08, 0.08), y, ROD[2] + lift), (0.0, tilt, turn)))
    taken = held(ends[0], obstacles)
    if taken is None:
        return None
    scene, carried, supports = taken
    start, goal = ends
    problem = Carry(kind, scene, carried, start, goal, supports)
    straight = problem.plan(planning_time=0.0)
    blocked = straight.evidence.get("contacts")
    if straight.ok or not blocked:
        return None
    return problem if _at_goal(problem) is not None else None


def _at_goal(problem: Carry) -> np.ndarray | None:
    """Joints that hold the rod at the goal free of contact, as the straight way leads there; or None."""
    hands, q = ClosedChainIK(problem.scene, problem.carried), problem.scene.positions
    for pose in problem.start.interpolated(problem.goal, np.linspace(0, 1, 80)):
        q = hands.solve(pose, q)
        if not isinstance(q, np.ndarray):
            return None
    names = problem.scene.model.group("both_arms").joint_names
    checker = ExactChecker(problem.scene, names)
    return q if checker.is_free(q[problem.scene.model.columns(names)]) else None


@dataclass(frozen=True)
class Seen:
    """The worst of every millisecond of a motion."""

    contacts: int  # milliseconds in which coal sees one
    off_m: float  # of the hands' relative pose from the grasps'
    turn_rad: float
    share: float  # of the limits of speed and acceleration, at most


def look_at(problem: Carry, trajectory: JointTrajectory, step: float = 1e-3) -> Seen:
    """Coal at samples: the arms, the hands and the rod against everything; what it rests on only below."""
    scene, names = problem.scene, trajectory.joint_names
    model, tree = scene.model, kinematic_tree(scene.model)
    columns = model.columns(names)
    strict = scene.with_padding(0.0)
    if problem.rests_on:
        strict = strict.with_allowed("rod", problem.rests_on, allow=False)
    resting, raised = ExactChecker(scene.with_padding(0.0), names), ExactChecker(strict, names)
    first, second = problem.carried.grasps
    wanted = problem.carried.grasps[first].inverse() @ problem.carried.grasps[second]
    full, contacts, off, turn, share = scene.positions.copy(), 0, 0.0, 0.0, 0.0
    limits = [model.limits(names, kind) for kind in ("velocity", "acceleration")]
    limits = [limits[0] * SPEED["velocity_scaling"], limits[1] * SPEED["acceleration_scaling"]]
    for t in np.arange(0.0, trajectory.duration + step, step):
        q, v, a = trajectory.sample(min(t, trajectory.duration))
        full[columns] = q
        hands = {g: tree.link_pose(full, problem.carried.tips[g]) for g in (first, second)}
        meters, radians = wanted.distance_to(hands[first].inverse() @ hands[second])
        off, turn = max(off, meters), max(turn, radians)
        share = max(share, float(np.max(np.abs(v) / limits[0])), float(np.max(np.abs(a) / limits[1])))
        rod = hands[first] @ problem.carried.grasps[first].inverse()
        near = min(rod.distance_to(end)[0] for end in (problem.start, problem.goal)) < 2e-3
        contacts += not (resting if near else raised).is_free(q)
    return Seen(contacts, off, turn, share)


def measured(count: int, recheck: int, seconds: float) -> dict:
    """`count` scenes, a quarter of each kind."""
    found: dict = {"scenes": 0, "solved": 0, "failures": []}
    spent, longer, poses_tried = [], [], []
    kinds: Counter[str] = Counter()
    seen: list[Seen] = []
    seed = 0
    while found["scenes"] < count:
        kind = list(KINDS)[found["scenes"] % len(KINDS)]
        problem = draw(np.random.default_rng(seed), kind)
        seed += 1
        if problem is None:
            continue
        began = time.thread_time()
        result = problem.plan(planning_time=seconds, seed=seed)
        cpu = time.thread_time() - began
        found["scenes"] += 1
        if not result.ok or result.trajectory is None:
            found["failures"].append(f"{seed - 1} {kind}: {result.message}")
            print(f"  {seed - 1} {kind}: {result.message}", flush=True)
            continue
        found["solved"] += 1
        kinds[kind] += 1
        spent.append(cpu)
        meters = problem.start.distance_to(problem.goal)[0]
        longer.append(_length(problem, result.trajectory) / meters)
        poses_tried.append(result.evidence["poses_looked_at"])
        if len(seen) < recheck:
            seen.append(look_at(problem, result.trajectory))
        words = f", {seen[-1]}" if len(seen) == found["solved"] else ""
        print(
            f"  {seed - 1} {kind}: {cpu:.2f} s, {poses_tried[-1]} poses, "
            f"{result.trajectory.duration:.1f} s of "
            f"motion, {longer[-1]:.1f} times the straight way{words}",
            flush=True,
        )
    found |= {
        "by_kind": dict(kinds), "cpu_s": {k: float(np.quantile(spent, s)) for k, s in
                                          (("median", 0.5), ("p95", 0.95), ("most", 1.0))},
        "times_the_straight_way": float(np.median(longer)), "poses_looked_at": float(np.median(poses_tried)),
        "rechecked": len(seen), "contacts": sum(s.contacts for s in seen),
        "off_m": max((s.off_m for s in seen), default=0.0),
        "turn_rad": max((s.turn_rad for s in seen), default=0.0),
        "of_limits": max((s.share for s in seen), default=0.0),
    }  # fmt: skip
    return found


def _length(problem: Carry, trajectory: JointTrajectory) -> float:
    """[m] that the rod's origin travels."""
    scene, tree = problem.scene, kinematic_tree(problem.scene.model)
    first = next(iter(problem.carried.grasps))
    columns, full, at = scene.model.columns(trajectory.joint_names), scene.positions.copy(), []
    for q in trajectory.positions:
        full[columns] = q
        hand = tree.link_pose(full, problem.carried.tips[first])
        at.append((hand @ problem.carried.grasps[first].inverse()).translation)
    return float(np.linalg.norm(np.diff(at, axis=0), axis=1).sum())


def in_physics(runs: int) -> dict:
    """The rod grasped, carried over a random wall to the other side of the table, put down; in physics."""
    text = (cell().file.parent / "cell.yaml").read_text()
    worst: dict[str, float] = {}
    found: dict = {"runs": runs, "successes": 0, "contacts": 0, "failures": []}
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        height, wide = rng.uniform(0.1, 0.25), rng.uniform(0.3, 0.7)
        at = (rng.uniform(-0.05, 0.05), rng.uniform(-0.01, 0.01), TABLE + 0.001 + height / 2)
        wall = f"\n  wall:\n    box: [{wide}, 0.02, {height}]\n    pose: [{at[0]}, {at[1]}, {at[2]}]\n"
        target = SE3.from_xyz_rpy(
            (rng.uniform(-0.04, 0.04), -0.1, ROD[2]), (0.0, 0.0, rng.uniform(-0.15, 0.2))
        )
        with TemporaryDirectory() as folder:
            (Path(folder) / "cell.yaml").write_text(
                text.replace("\n  rod:\n    box", f"{wall}  rod:\n    box")
            )
            shutil.copy(cell().file.parent / "task.py", folder)
            with armcell.load(folder).connect("sim", seed=seed) as live:
                rod = live.carry("rod", **ENDS)
                done = rod.grasp(route=[target]) and rod.move(target, name="over the wall") and rod.release()
                found["contacts"] += len(live.driver.unwanted_contacts())
                seen = rod.record.as_dict()
                seen["placed_off_mm"] = (
                    1000 * live.scene().object("rod").T_world_object.distance_to(target)[0]
                )
        found["successes"] += done.ok
        if not done.ok:
            found["failures"].append(f"{seed}: {done.message}")
        worst |= {key: max(value, worst.get(key, 0.0)) for key, value in seen.items()}
        print(f"  physics {seed}: {'ok' if done.ok else done.message}", flush=True)
    return found | {"largest": worst}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--recheck", type=int, default=30, help="motions that coal looks at")
    parser.add_argument("--seconds", type=float, default=10.0, help="planning time of each")
    parser.add_argument("--physics", type=int, default=12, help="runs in physics, each over a random wall")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found = measured(given.scenes, given.recheck, given.seconds)
    cpu = found["cpu_s"]
    print(
        f"{found['solved']} of {found['scenes']} solved {found['by_kind']}; CPU median {cpu['median']:.2f}, "
        f"p95 {cpu['p95']:.2f}, most {cpu['most']:.2f} s; {found['poses_looked_at']:.0f} poses looked at; "
        f"{found['times_the_straight_way']:.1f} times as far as straight"
    )
    print(
        f"{found['rechecked']} looked at each millisecond: {found['contacts']} ms of contact, hands "
        f"{1e6 * found['off_m']:.2g} um and {np.rad2deg(found['turn_rad']):.2g} degrees off, "
        f"{found['of_limits']:.3f} of the limits"
    )
    found["physics"] = p = in_physics(given.physics)
    print(
        f"in physics {p['successes']} of {p['runs']}, {p['contacts']} contacts; largest "
        + ", ".join(f"{k} {v:.3g}" for k, v in p["largest"].items())
    )
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
