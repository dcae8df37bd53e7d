"""`armcell bench mbm`: plan the problems of MotionBenchMaker."""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import typer

from armcell.cli import bench_plans
from armcell.cli.console import check_writable
from armcell.core import SE3, InputError, shapes


def mbm(
    problems: Path = typer.Option(..., metavar="FILE", help="MotionBenchMaker problems (.json or .json.gz)."),
    robot: str = typer.Option(
        ..., help="The robot they are for: a folder, a URDF, one in robots/ beside FILE or a library name."
    ),
    planner: str = typer.Option("native", metavar="ID", help="A planner: native, ompl/RRTConnect, ..."),
    repeat: int = typer.Option(3, min=1, help="Runs per problem; the fastest counts."),
    limit: int = typer.Option(0, min=0, help="Only the first problems of each family; 0: all."),
    seconds: float = typer.Option(10.0, min=0.01, help="Time limit of one run."),
    paths: Path | None = typer.Option(None, metavar="FILE.json.gz", help="Write the final waypoints."),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the times as JSON."),
) -> int:
    """Benchmark planning on MotionBenchMaker problems: the time to search for a path,
    to shorten it and to prove it collision-free.

    Times are CPU time of one thread in microseconds. The native planner proves
    every edge while it shortens the path: its certify_us is 0, and its simplify_us includes the proof. A
    problem whose start or goal is in contact (exact checker) is skipped and counted separately. Exit
    status 1 if one of the other problems was not solved.
    """
    for file in (paths, json_file):
        if file is not None:
            check_writable(file)
    bench_plans.planner(planner)  # report an unknown planner before reading the file
    data = read_problems(problems)
    from armcell.model import load_robot

    model = load_robot(find_robot(robot, problems))
    total = sum(len(some[: limit or None]) for some in data["families"].values())
    found = bench_plans.run(_tasks(data, problems, model, limit), total, planner, repeat, seconds)
    return bench_plans.report_results(found, json_file, paths)


def read_problems(file: Path) -> dict[str, Any]:
    """Return the problems in a MotionBenchMaker file, reduced to the keys that `armcell bench mbm` uses.

    Raises:
        InputError: the file cannot be read as problems.
    """
    try:
        raw = file.read_bytes()
        data = json.loads(gzip.decompress(raw) if file.suffix == ".gz" else raw)
        return {key: data[key] for key in ("joints", "fixed_joints", "families")}
    except (OSError, ValueError, KeyError, TypeError, EOFError) as error:
        raise InputError(f"cannot be read as problems: {type(error).__name__}: {error}", file=file) from None


def find_robot(robot: str, problems: Path) -> str | Path:
    """Return the URDF file, folder or library name of the robot in MotionBenchMaker problems,
    as input for `load_robot`.

    The folder `robots/` beside the problems has priority, because it contains the robots of the problems.

    Raises:
        InputError: a folder has no robot.yaml, and either no URDF, or several URDFs of which none has the
            folder's name.
    """
    beside = problems.parent / "robots" / robot
    path = Path(robot)
    if not os.path.exists(path) and os.path.isdir(beside):
        path = beside
    if not os.path.isdir(path) or os.path.exists(path / "robot.yaml"):
        return path if os.path.exists(path) else robot
    urdfs = sorted(path.glob("*.urdf"))
    named = [urdf for urdf in urdfs if urdf.stem == path.resolve().name]
    if len(urdfs) == 1 or named:
        return (named or urdfs)[0]
    raise InputError(
        f"has {len(urdfs)} URDF files and no robot.yaml", file=path, hint="name the URDF file itself"
    )


def _tasks(data: dict[str, Any], file: Path, model, limit: int) -> Iterator[bench_plans.PlanTask]:
    from armcell.planning import sampling_bounds

    names = tuple(data["joints"])
    for family, some in data["families"].items():
        for i, problem in enumerate(some[: limit or None]):
            try:
                index, scene = problem["index"], scene_of(model, data["fixed_joints"], problem)
                start = np.array(problem["start"], float).reshape(len(names))
                goals = np.array(problem["goals"], float).reshape(-1, len(names))
            except (KeyError, TypeError, ValueError) as error:
                where = f"families/{family}[{i}]"
                raise InputError(f"{type(error).__name__}: {error}", file=file, element=where) from None
            lower, upper = sampling_bounds(model, names, start, list(goals))
            yield bench_plans.PlanTask(family, index, scene, names, start, goals, lower, upper)


def scene_of(model, fixed: dict[str, float], problem: dict[str, Any]):
    """Return the scene of a MotionBenchMaker problem with the robot, its fixed joints and the obstacles."""
    from armcell.scene import CollisionObject, PlanningScene

    q = model.neutral()
    for name, value in fixed.items():
        if name in model.joint_names:
            q[model.columns((name,))[0]] = value
    scene = PlanningScene(model, q)  # not `of`: the fingers of MBM's Panda are beyond their limits
    for i, o in enumerate(problem["obstacles"]):
        shape = shapes[o["type"]].from_named(o.__getitem__, lambda key, _, o=o: o[key])
        pose = SE3.from_quat_xyzw(o["position"], o["quat_xyzw"])
        scene = scene.with_object(CollisionObject.single(f"{i}_{o['name']}", shape, pose))
    return scene
