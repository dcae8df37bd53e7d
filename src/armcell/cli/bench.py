"""`armcell bench`: the planner on public problems."""

from __future__ import annotations

import gzip
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.progress import track
from rich.table import Table

from armcell.cli import bench_ik, bench_timing
from armcell.cli.console import check_writable, console, errors, write_json
from armcell.core import SE3, Box, Cylinder, InputError

app = typer.Typer(help="Measure armcell on public problems.", no_args_is_help=True, rich_markup_mode=None)


app.command("timing")(bench_timing.timing)


@app.callback()
def _group() -> None:
    """Measure armcell on public problems."""


app.command("ik", epilog=bench_ik.EXAMPLES)(bench_ik.ik)


@app.command("mbm")
def mbm(
    problems: Path = typer.Option(..., metavar="FILE", help="MotionBenchMaker problems (.json or .json.gz)."),
    robot: str = typer.Option(..., help="The robot they are for: a folder, a URDF or a library name."),
    repeat: int = typer.Option(3, min=1, help="Runs per problem; the fastest counts."),
    limit: int = typer.Option(0, min=0, help="Only the first problems of each family; 0: all."),
    seconds: float = typer.Option(10.0, min=0.01, help="Time limit of one run."),
    paths: Path | None = typer.Option(None, metavar="FILE.json.gz", help="Write the final waypoints."),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the times as JSON."),
) -> int:
    """Plan MotionBenchMaker's problems with the native planner: search, shorten, prove, time.

    Times are CPU time of one thread in microseconds. Exit status 1 if a problem was not solved.
    """
    for file in (paths, json_file):
        if file is not None:
            check_writable(file)
    rows, found = [], {}
    for row, waypoints in _solved(_read(problems), robot, repeat, limit, seconds):
        rows.append(row)
        if waypoints is not None:
            found.setdefault(row["family"], {})[row["index"]] = waypoints.tolist()
    _show(rows)
    if json_file is not None:
        write_json(json_file, rows)
    if paths is not None:
        with gzip.open(paths, "wt", encoding="utf-8") as out:
            json.dump(found, out)
    return 0 if all(row["solved"] for row in rows) else 1


def _read(file: Path) -> dict[str, Any]:
    try:
        raw = file.read_bytes()
        data = json.loads(gzip.decompress(raw) if file.suffix == ".gz" else raw)
        return {key: data[key] for key in ("joints", "fixed_joints", "families")}
    except (OSError, ValueError, KeyError, TypeError, EOFError) as error:
        raise InputError(f"cannot be read as problems: {type(error).__name__}: {error}", file=file) from None


def _solved(
    data: dict[str, Any], robot: str, repeat: int, limit: int, seconds: float
) -> Iterator[tuple[dict[str, Any], np.ndarray | None]]:
    from armcell.collision.kernel.checker import KernelChecker
    from armcell.model import load_robot
    from armcell.planning import warm_up
    from armcell.planning.native.planner import NativePlanner

    path = Path(robot)
    if path.is_dir() and not (path / "robot.yaml").exists():
        urdfs = sorted(path.glob("*.urdf"))
        if len(urdfs) != 1:
            raise InputError(f"has {len(urdfs)} URDF files and no robot.yaml", file=path)
        robot = str(urdfs[0])
    model, names = load_robot(robot), tuple(data["joints"])
    columns = model.columns(names)
    lower = np.where(np.isfinite(model.lower[columns]), model.lower[columns], -np.pi)
    upper = np.where(np.isfinite(model.upper[columns]), model.upper[columns], np.pi)
    warm_up()
    planner = None
    every = [(f, p) for f, some in data["families"].items() for p in (some[:limit] if limit else some)]
    for family, problem in track(
        every, "planning", console=errors, disable=not errors.is_terminal, transient=True
    ):
        checker = KernelChecker(_scene(model, data["fixed_joints"], problem), names)
        if planner is None:
            planner = NativePlanner(checker)
        planner.checker = checker
        start, goals = np.array(problem["start"], float), np.array(problem["goals"], float)
        best = None
        for _ in range(repeat):
            stop = np.zeros(1, np.int64)
            timer = threading.Timer(seconds, stop.__setitem__, (0, 1))
            timer.start()
            answer = planner.plan(start, goals, lower, upper, stop=stop)
            timer.cancel()
            total = answer.plan_s + answer.simplify_s + answer.certify_s
            if best is None or total < best[0]:
                best = (total, answer)
            if answer.waypoints is None:
                break
        assert best is not None
        yield _row(family, problem["index"], best[1], checker), best[1].waypoints


def _scene(model, fixed: dict[str, float], problem: dict[str, Any]):
    from armcell.scene import CollisionObject, PlanningScene

    q = model.neutral()
    for name, value in fixed.items():
        if name in model.joint_names:
            q[model.columns((name,))[0]] = value
    scene = PlanningScene(model, q)
    for i, o in enumerate(problem["obstacles"]):
        shape = Box(*o["size"]) if o["type"] == "box" else Cylinder(o["radius"], o["length"])
        pose = SE3.from_quat_xyzw(o["position"], o["quat_xyzw"])
        scene = scene.with_object(CollisionObject.single(f"{i}_{o['name']}", shape, pose))
    return scene


def _row(family: str, index: int, answer, checker) -> dict[str, Any]:
    from armcell.timing import BlendedPath, parameterize

    row: dict[str, Any] = {
        "family": family,
        "index": index,
        "solved": answer.waypoints is not None,
        "plan_us": answer.plan_s * 1e6,
        "simplify_us": answer.simplify_s * 1e6,
        "certify_us": answer.certify_s * 1e6,
        "timing_us": None,
        "length_raw": None,
        "length": None,
    }
    if answer.waypoints is None:
        return row
    names, dof = checker.joint_names, len(checker.joint_names)
    began = time.thread_time()
    parameterize(BlendedPath(answer.waypoints, 0.05), names, np.full(dof, 2.0), np.full(dof, 5.0))
    row["timing_us"] = (time.thread_time() - began) * 1e6
    for key, waypoints in (("length_raw", answer.raw), ("length", answer.waypoints)):
        row[key] = float(np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum())
    return row


def _show(rows: list[dict[str, Any]]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("family", "solved", "plan us", "p95", "+ simplify + prove us", "p95", "length", "raw"):
        table.add_column(title, justify="left" if title == "family" else "right")
    families = dict.fromkeys(row["family"] for row in rows)
    for family in [*families, "all"]:
        some = [r for r in rows if family in ("all", r["family"])]
        good = [r for r in some if r["solved"]]
        if not good:
            table.add_row(family, f"0/{len(some)}")
            continue
        plan = np.array([r["plan_us"] for r in good])
        total = plan + np.array([r["simplify_us"] + r["certify_us"] for r in good])
        table.add_row(
            family,
            f"{len(good)}/{len(some)}",
            *(
                f"{v:.0f}"
                for v in (
                    np.median(plan),
                    np.percentile(plan, 95),
                    np.median(total),
                    np.percentile(total, 95),
                )
            ),
            *(f"{np.mean([r[k] for r in good]):.2f}" for k in ("length", "length_raw")),
        )
    console.print(table)
