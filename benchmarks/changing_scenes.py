"""Measure plans in scenes that change: many objects, one of which is added, moved or removed, and clouds.

    python -m benchmarks.changing_scenes [--passes 9]

Every figure is CPU time of the calling thread, the minimum of the passes. A plan is the whole Python call
`plan()` of a Panda to a joint goal, with objects around the arm that never block the way.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.cloud_arrays import cloud_of
from armcell.core import SE3, Box, JointGoal, JointState, PlanRequest, PointCloud
from armcell.model import load_robot
from armcell.planning import plan
from armcell.ros.codec import Codec
from armcell.ros.moveit_convert import diff_from_message, scene_message
from armcell.ros.schema import schema as built_in_schema
from armcell.scene import WORLD, AddObject, CollisionObject, PlanningScene, ReplacePoints, SceneDiff

COUNTS = (1000, 5000)
POINTS = 200_000
SHARES = (0.01, 0.1, 1.0)  # of the points that an update replaces
GROUP = "arm"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--passes", type=int, default=9)
    passes = parser.parse_args().passes
    scene = PlanningScene.of(load_robot("panda"))
    request = a_request(scene)
    assert plan(scene, request).ok
    print("| objects | first plan | same scene | one added | one moved | one removed | diff of all applied |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for count in COUNTS:
        print("| " + " | ".join([str(count), *changes(scene, request, count, passes)]) + " |")
    for count in COUNTS:
        print(f"\n{count} objects in one diff over the wire: {wire(scene, count, passes)}")
    print(f"\ncloud of {POINTS} points: {cloud(scene, passes)}\n")
    print("| points replaced | checker ready | first plan | per query |")
    print("| --- | --- | --- | --- |")
    for share in SHARES:
        print("| " + " | ".join([f"{share:.0%}", *cloud_update(scene, share, passes)]) + " |")


def a_request(scene: PlanningScene) -> PlanRequest:
    names = scene.model.group(GROUP).joint_names
    goal = scene.positions[scene.model.columns(names)] + 0.3
    return PlanRequest(GROUP, (JointGoal(JointState(names, goal)),))


def changes(scene: PlanningScene, request: PlanRequest, count: int, passes: int) -> list[str]:
    """CPU times of plans in scenes with `count` objects: the first, again, and after single changes."""
    every = around(scene, count + passes, np.random.default_rng(count))
    diff = SceneDiff(tuple(AddObject(item) for item in every[:count]))
    full = scene.apply(diff)
    times: dict[str, list[float]] = {}

    def measure(what: str, now: PlanningScene) -> None:
        took, result = cpu(lambda: plan(now, request))
        assert result.ok, result.message
        times.setdefault(what, []).append(took)

    for k in range(passes):
        fresh = replace(scene, objects={item.name: other_size(item, k) for item in every[:count]})
        measure("first", fresh)
        plan(full, request)
        measure("same", full)
        measure("added", full.with_object(every[count + k]))
        plan(full, request)
        name = f"box{(k * 7919) % count}"
        pose = full.objects[name].T_world_object @ SE3.from_xyz(1e-3 * (k + 1), 0, 0)
        measure("moved", full.with_object_pose(name, pose))
        plan(full, request)
        measure("removed", full.without_object(name))
        times.setdefault("diff", []).append(cpu(lambda: scene.apply(diff))[0])
    return [milliseconds(min(t)) for t in times.values()]


def wire(scene: PlanningScene, count: int, passes: int) -> str:
    """CPU times of one ROS 1 message with all objects: decoded, applied to the scene, sent back."""
    schema = built_in_schema()
    codec = Codec("ros1", schema)
    header = schema.new("std_msgs/Header", frame_id=WORLD)
    message = scene_message(
        schema, header, scene.with_objects(around(scene, count, np.random.default_rng(7)))
    )
    message.is_diff = True
    message.allowed_collision_matrix = schema.new("moveit_msgs/AllowedCollisionMatrix")
    data = bytes(codec.encode(message))
    decoded, applied, whole = [], [], []
    for _ in range(passes):
        took, received = cpu(lambda: codec.decode("moveit_msgs/PlanningScene", data))
        decoded.append(took)
        took, now = cpu(lambda received=received: scene.apply(diff_from_message(received, scene)))
        applied.append(took)
        assert len(now.objects) == count
        whole.append(cpu(lambda now=now: scene_message(schema, header, now))[0])
    return (
        f"decoded in {milliseconds(min(decoded))}, applied in {milliseconds(min(applied))}; "
        f"the whole scene as a message {milliseconds(min(whole))}"
    )  # fmt: skip


def other_size(item: CollisionObject, k: int) -> CollisionObject:
    """The same object, minimally longer, so that nothing about it is cached."""
    [(shape, T)] = item.shapes
    assert isinstance(shape, Box)
    return replace(item, shapes=((Box(shape.x * (1 + 1e-9 * (k + 1)), shape.y, shape.z), T),))


def cloud(scene: PlanningScene, passes: int) -> str:
    """CPU times until a cloud is ready, of a check beside it, and of the first plan with it."""
    ready, first, query = [], [], []
    rng = np.random.default_rng(1)
    request = a_request(scene)
    for _ in range(passes):
        points = PointCloud(surface(rng), 0.004)
        ready.append(cpu(lambda points=points: cloud_of(points))[0])
        now = scene.with_object(CollisionObject.single("cloud", points))
        first.append(cpu(lambda now=now: plan(now, request))[0])
        query.append(per_query(now))
    return (
        f"ready after {milliseconds(min(ready))}, first plan {milliseconds(min(first))}, "
        f"{np.median(query) * 1e6:.1f} us per query"
    )  # fmt: skip


def cloud_update(scene: PlanningScene, share: float, passes: int) -> list[str]:
    """CPU times after a share of a cloud's points in a box has been replaced: until the checker is ready, the
    first plan, and of a check.
    """
    ready, first, query = [], [], []
    rng = np.random.default_rng(2)
    request = a_request(scene)
    points = surface(rng)
    before = scene.with_object(CollisionObject.single("cloud", PointCloud(points.copy(), 0.004)))
    checker_of(before)
    from_middle = np.abs(points - [0.75, 0, -0.05]).max(axis=1)
    reach = np.quantile(from_middle, share) + 1e-9
    low, high = np.array([0.75, 0, -0.05]) - reach, np.array([0.75, 0, -0.05]) + reach
    for _ in range(passes):
        new = points[from_middle < reach]
        new = new + rng.normal(0, 1e-3, new.shape)
        change = ReplacePoints("cloud", new, low, high)

        def update(change: ReplacePoints = change) -> PlanningScene:
            now = before.apply(SceneDiff.of(change))
            checker_of(now)
            return now

        took, now = cpu(update)
        ready.append(took)
        first.append(cpu(lambda now=now: plan(now, request))[0])
        query.append(per_query(now))
    return [milliseconds(min(ready)), milliseconds(min(first)), f"{np.median(query) * 1e6:.1f} us"]


def checker_of(scene: PlanningScene) -> KernelChecker:
    return KernelChecker(scene, scene.model.group(GROUP).joint_names)


def per_query(scene: PlanningScene) -> float:
    """CPU time [s] of a check beside a cloud, the mean of 1000 configurations that are always the same."""
    checker, rng = checker_of(scene), np.random.default_rng(5)
    samples = [scene.positions[checker.columns] + 0.3 * rng.uniform(-1, 1, 7) for _ in range(1000)]
    return cpu(lambda: [checker.is_free(q) for q in samples])[0] / len(samples)


def surface(rng: np.random.Generator) -> np.ndarray:
    """Points (POINTS, 3) on a table, a wall and some boxes on the table, with 1 mm of noise."""
    count = POINTS // 4
    table = np.column_stack([rng.uniform(0.25, 1.2, count), rng.uniform(-1, 1, count), np.full(count, -0.05)])
    wall = np.column_stack([np.full(count, 1.2), rng.uniform(-1, 1, count), rng.uniform(-0.05, 1.2, count)])
    corner = rng.uniform([0.5, -0.8, -0.05], [1.0, 0.8, -0.05], (20, 3))
    boxes = rng.uniform(-1, 1, (POINTS - 2 * count, 3))
    boxes[np.arange(len(boxes)), rng.integers(0, 3, len(boxes))] = 1.0
    boxes = corner[rng.integers(0, 20, len(boxes))] + 0.05 * boxes
    return np.vstack([table, wall, boxes]) + rng.normal(0, 1e-3, (POINTS, 3))


def around(scene: PlanningScene, count: int, rng: np.random.Generator) -> list[CollisionObject]:
    """Boxes of 1 to 5 cm, none of them within reach of the arm."""
    found: list[CollisionObject] = []
    while len(found) < count:
        p = rng.uniform(-2, 2, 3)
        if np.linalg.norm(p - [0, 0, 0.333]) > 1.2:
            shape = Box(*rng.uniform(0.01, 0.05, 3))
            found.append(CollisionObject.single(f"box{len(found)}", shape, SE3.from_xyz(*p)))
    return found


def cpu(call: Callable) -> tuple[float, object]:
    """CPU time of this thread [s] for a call, and its result."""
    began = time.thread_time()
    result = call()
    return time.thread_time() - began, result


def milliseconds(seconds: float) -> str:
    return f"{seconds * 1e3:.2f} ms"


if __name__ == "__main__":
    main()
