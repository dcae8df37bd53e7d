"""`armcell bench dual`: plan two UR10 arms at a table as one group; each holds an object."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import typer

from armcell.cli import bench_plans
from armcell.cli.console import check_writable
from armcell.core import SE3, Box, InputError

SIDES = {"left_": 0.75, "right_": -0.75}  # y [m] of the two bases
BASE_HEIGHT = 0.8  # [m]
TABLE = (0.8, 0.7, 0.05)  # [m]
TABLE_HEIGHT = 0.9  # [m]
HELD = (0.06, 0.06, 0.16)  # [m] size of the object in each gripper
CLEARANCE = 0.005  # [m] clearance of starts and goals, as in the built-in cells
OPENING = 0.03  # [m] travel of each finger: half the width of the held object


def dual(
    count: int = typer.Option(100, min=1, help="Problems."),
    seed: int = typer.Option(0, min=0, help="Draw of the starts and goals."),
    planner: str = typer.Option("native", metavar="ID", help="A planner: native, ompl/RRTConnect, ..."),
    repeat: int = typer.Option(3, min=1, help="Runs per problem; the fastest counts."),
    seconds: float = typer.Option(10.0, min=0.01, help="Time limit of one run."),
    apart: float = typer.Option(0.02, min=0.0, help="[m] kept between the arms where start and goal allow."),
    paths: Path | None = typer.Option(None, metavar="FILE.json.gz", help="Write the final waypoints."),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the times as JSON."),
) -> int:
    """Benchmark dual-arm motion planning.
    Two UR10 arms form one planning group of 12 joints, and each gripper holds a box.

    Starts and goals are random postures with at least 5 mm clearance.

    Exit status 1 if a problem was not solved.
    """
    for file in (paths, json_file):
        if file is not None:
            check_writable(file)
    bench_plans.planner(planner)
    found = bench_plans.run(_tasks(count, seed, apart), count, planner, repeat, seconds)
    return bench_plans.report_results(found, json_file, paths)


def _tasks(count: int, seed: int, apart: float) -> Iterator[bench_plans.PlanTask]:
    from armcell.collision import ExactChecker

    scene = dual_scene()
    names = tuple(n for side in SIDES for n in scene.model.group(f"{side}arm").joint_names)
    # The joint limits are two turns; one turn reaches every posture. The upper arm stays above its
    # shoulder: postures below it, behind the pedestal, have no collision-free exit.
    upper = np.array([0.0 if "shoulder_lift" in name else np.pi for name in names])
    lower = np.full(len(names), -np.pi)
    judge, rng = ExactChecker(scene, names), np.random.default_rng(seed)

    def free() -> np.ndarray:
        for _ in range(10_000):
            q = rng.uniform(lower, upper)
            if judge.is_free(q) and judge.nearest(q, CLEARANCE) is None:
                return q
        raise InputError("no free posture among 10000 random ones")

    for index in range(count):
        yield bench_plans.PlanTask(
            "uniform",
            index,
            scene,
            names,
            free(),
            free()[None],
            lower,
            upper,
            ("left_arm", "right_arm"),
            apart,
        )


def dual_scene():
    """Return the scene of the dual-arm benchmark: two UR10 arms on pedestals,
    and a table with one box for each gripper.
    """
    from armcell.model import load_robot
    from armcell.model.composition import MountedRobot, compose
    from armcell.scene import CollisionObject, PlanningScene

    robot = load_robot("ur10_gripper")
    model = compose(
        "dual_ur10",
        [MountedRobot(robot, side, "world", SE3.from_xyz(0, y, BASE_HEIGHT)) for side, y in SIDES.items()],
    )
    q = model.default_positions()
    for side in SIDES:
        q[model.columns((f"{side}gripper_left_finger_joint",))[0]] = OPENING
    solid = CollisionObject.single
    pedestal = Box(0.3, 0.3, BASE_HEIGHT - 0.01)
    scene = PlanningScene.of(
        model,
        q,
        [
            solid("floor", Box(4, 4, 0.1), SE3.from_xyz(0, 0, -0.06)),
            solid("table", Box(*TABLE), SE3.from_xyz(0, 0, TABLE_HEIGHT - TABLE[2] / 2)),
            solid("box_1", Box(0.2, 0.2, 0.3), SE3.from_xyz(0.2, 0, TABLE_HEIGHT + 0.151)),
            solid("box_2", Box(0.1, 0.3, 0.2), SE3.from_xyz(-0.25, 0, TABLE_HEIGHT + 0.101)),
            *(
                solid(f"{side}pedestal", pedestal, SE3.from_xyz(0, y, pedestal.z / 2))
                for side, y in SIDES.items()
            ),
        ],
    )
    for side in SIDES:
        gripper, held = model.grippers[f"{side}gripper"], f"{side}held"
        scene = scene.with_object(solid(held, Box(*HELD), scene.frame_pose(gripper.tcp_link)))
        scene = scene.with_attached(held, gripper.tcp_link, gripper.hand_links)
    return scene
