"""`armcell bench ik`: solve inverse kinematics for random reachable poses."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer
from rich.progress import track
from rich.table import Table

from armcell.cli.console import check_writable, console, errors, write_json
from armcell.core import InputError

if TYPE_CHECKING:
    from armcell.kinematics import IKSolver
    from armcell.model import RobotModel

REPEATS = 3  # calls per pose; the fastest call counts
EXAMPLES = """
Examples:

  armcell bench ik --robot ur10                        analytic: every branch of 1000 poses

  armcell bench ik --robot panda --json panda.json     numeric, a row per pose in the file

  armcell bench ik --robot ur10 --numeric              the numeric solver where the analytic one would do

  armcell bench ik --robot my_arm.urdf --tip tool0     a URDF without planning groups
"""


def ik(
    robot: str = typer.Option(..., metavar="NAME_OR_FILE", help="A library name, a URDF or a robot folder."),
    group: str | None = typer.Option(None, help="The planning group; may be left out if one has a tip."),
    tip: str | None = typer.Option(
        None, metavar="LINK", help="The link to place; without --group, all joints that move it are used."
    ),
    count: int = typer.Option(1000, min=1, help="How many poses."),
    seed: int = typer.Option(0, min=0, help="Of the random poses: the same seed, the same poses."),
    numeric: bool = typer.Option(False, "--numeric", help="Use the numeric solver for any arm."),
    json_file: Path | None = typer.Option(
        None, "--json", metavar="FILE", help="Write a summary and a row per pose."
    ),
) -> int:
    """Benchmark inverse kinematics on random reachable poses: success rate,
    time, number of solutions and error.

    The poses come from random joint positions within limits, so each pose has a solution. Times are CPU time
    of one thread in microseconds, the fastest of three calls: "compiled" finds all branches (analytic) or one
    solution (numeric) in machine code, "call" is the Python call `solve`, which returns the solution nearest
    to the robot's default positions. "Solutions" counts the solutions within limits without whole turns; for
    a redundant arm, it counts the streamed solutions. Errors are those of all solutions, by forward
    kinematics. Exit status 1 if a pose was not solved.
    """
    if json_file is not None:
        check_writable(json_file)
    solver = _solver(robot, group, tip, numeric)
    rows = list(
        track(
            _rows(solver, count, seed), "solving", count, console=errors, disable=not errors.is_terminal,
            transient=True,
        )
    )  # fmt: skip
    summary = _summary(solver, rows)
    _show(summary)
    if json_file is not None:
        write_json(json_file, {"summary": summary, "seed": seed, "rows": rows})
    return 0 if all(row["solved"] for row in rows) else 1


def _solver(robot: str, group: str | None, tip: str | None, numeric: bool) -> IKSolver:
    from armcell.kinematics import NumericIK, ik_solver
    from armcell.model import load_robot

    model = load_robot(robot)
    if group is None and tip is not None:
        model, group = _with_chain(model, tip)
    if group is None:
        chains = sorted(name for name, g in model.groups.items() if g.tip_link is not None)
        if len(chains) != 1:
            raise InputError(
                f"robot {model.name!r} has {len(chains)} planning groups with a tip",
                hint=f"name one of {chains} with --group" if chains else "name the link to place with --tip",
            )
        group = chains[0]
    return NumericIK(model, group, tip) if numeric else ik_solver(model, group, tip)


def _with_chain(model: RobotModel, tip: str) -> tuple[RobotModel, str]:
    """Add a planning group with all joints that move a given link, for the IK benchmark. Return the new robot
    model and the name of the group.
    """
    from armcell.model import Group

    model.link(tip)
    chain = model.chain(model.root_link, tip)
    names = tuple(joint.name for joint in chain if joint.actuated)
    name = f"joints of {tip}"
    links = tuple(joint.child for joint in chain)
    return replace(
        model, groups={**model.groups, name: Group(name, names, links, model.root_link, tip)}
    ), name


def _compiled(solver: IKSolver, reference: np.ndarray) -> Callable[[np.ndarray], Any]:
    """For the IK benchmark, return a function that takes a tip pose T_root_tip (4, 4) and runs only the
    compiled code of an IK solver.
    """
    from armcell.kinematics.ik.analytic import BRANCHES, ur_branches
    from armcell.kinematics.ik.chain import goal_in_base
    from armcell.kinematics.ik.numeric import any_solution, ik_problem

    chain, seeds, geometry = solver.chain_data.chain, solver.chain_data.seeds, solver.chain_data.geometry
    at, goal, found = reference[solver.columns], np.empty(12), np.empty((BRANCHES, len(solver.columns)))
    s = solver.settings

    def analytic(T: np.ndarray) -> None:
        goal_in_base(chain.inverse_base, T, goal)
        ur_branches(geometry, goal, at, found)

    def numeric(T: np.ndarray) -> None:
        goal_in_base(chain.inverse_base, T, goal)
        problem = ik_problem(chain, goal, at, s)
        any_solution(problem, seeds.positions, seeds.poses, s.seeds, found)

    return numeric if geometry is None else analytic


def _rows(solver: IKSolver, count: int, seed: int) -> Iterator[dict[str, Any]]:
    from armcell.kinematics.ik.seeds import sampling_range

    rng, reference = np.random.default_rng(seed), solver.model.default_positions()
    low, high = solver.lower, solver.upper
    endless_low, endless_high = sampling_range(solver.chain_data.chain)
    low, high = np.where(np.isfinite(low), low, endless_low), np.where(np.isfinite(high), high, endless_high)
    compiled = _compiled(solver, reference)
    for index in range(-1, count):  # the first call compiles and does not count
        q = reference.copy()
        q[solver.columns] = rng.uniform(low, high)
        target = solver.tree.link_pose(q, solver.tip_link)
        T = target.matrix
        compiled_us = min(_microseconds(lambda T=T: compiled(T)) for _ in range(REPEATS))
        call_us = min(_microseconds(lambda t=target: solver.solve(t, reference)) for _ in range(REPEATS))
        row = {"index": index, "solved": solver.solve(target, reference).ok}
        found = list(solver.solutions(target, reference))
        worst = [0.0, 0.0]
        for solution in found:
            q[solver.columns] = solution
            worst = np.maximum(worst, solver.tree.link_pose(q, solver.tip_link).distance_to(target)).tolist()
        row |= {"compiled_us": compiled_us, "call_us": call_us, "solutions": len(found)}
        row |= {"position_error_m": worst[0], "rotation_error_rad": worst[1]}
        if index >= 0:
            yield row


def _microseconds(call: Callable[[], Any]) -> float:
    began = time.thread_time_ns()
    call()
    return (time.thread_time_ns() - began) / 1e3


def _summary(solver: IKSolver, rows: list[dict[str, Any]]) -> dict[str, Any]:
    def column(key: str) -> np.ndarray:
        return np.array([row[key] for row in rows], dtype=float)

    summary: dict[str, Any] = {
        "robot": solver.model.name,
        "group": solver.group.name,
        "tip": solver.tip_link,
        "method": solver.method,
        "poses": len(rows),
        "solved_percent": 100 * float(column("solved").mean()),
        "solutions_mean": float(column("solutions").mean()),
        "position_error_max_m": float(column("position_error_m").max()),
        "rotation_error_max_rad": float(column("rotation_error_rad").max()),
    }
    for key in ("compiled_us", "call_us"):
        summary[f"{key}_median"], summary[f"{key}_p95"] = np.percentile(column(key), (50, 95)).tolist()
    return summary


def _show(s: dict[str, Any]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    titles = ("robot", "group", "tip", "method", "poses", "solved", "compiled us", "p95", "call us", "p95",
              "solutions", "largest error")  # fmt: skip
    for k, title in enumerate(titles):
        table.add_column(title, justify="left" if k < 4 else "right")
    times = (s[f"{what}_us_{value}"] for what in ("compiled", "call") for value in ("median", "p95"))
    table.add_row(
        s["robot"], s["group"], s["tip"], s["method"], str(s["poses"]), f"{s['solved_percent']:.1f} %",
        *(f"{us:.1f}" for us in times),
        f"{s['solutions_mean']:.1f}",
        f"{s['position_error_max_m'] * 1000:.1e} mm, {s['rotation_error_max_rad']:.1e} rad",
    )  # fmt: skip
    console.print(table)
