"""`armcell explain`: say whether a motion, pose or grasp is possible, and if not, why."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.table import Table

from armcell.cli import goal_options
from armcell.cli.console import console
from armcell.cli.page import ALLOW_HOST, HOST, PORT, PageAddress
from armcell.core import Explanation


def explain(
    cell: str = goal_options.CELL,
    to: str | None = goal_options.TO,
    pose: goal_options.Triple | None = goal_options.POSE,
    rpy_deg: goal_options.Triple = goal_options.RPY_DEG,
    joints: str | None = goal_options.JOINTS,
    joints_deg: str | None = goal_options.JOINTS_DEG,
    line: bool = goal_options.LINE,
    pick: str | None = typer.Option(None, metavar="OBJECT", help="Explain which grasps of an object work."),
    start_deg: str | None = goal_options.START_DEG,
    group: str | None = goal_options.GROUP,
    link: str | None = goal_options.LINK,
    planner: str = goal_options.PLANNER,
    seconds: float = goal_options.TIME,
    seed: int | None = goal_options.SEED,
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the evidence as JSON."),
    view: bool = typer.Option(
        False, "--view", help="Show what touches in red and the nearest goal that works as a ghost."
    ),
    host: str = HOST,
    port: int = PORT,
    allow_host: list[str] = ALLOW_HOST,
) -> int:
    """Explain whether a motion, pose or grasp is possible. If not, explain why, and what would help.

    Example: armcell explain panda_pick --pose 0.55 0.06 0.2

    Exit status 0 if it is possible, 1 if not, 2 for wrong usage.
    """
    goal_options.selected_goal(
        {"--to": to, "--pose": pose, "--joints": joints, "--joints-deg": joints_deg, "--pick": pick}
    )
    goal_options.check_json_path(json_file)
    from armcell.cell import load

    loaded = load(cell)
    scene = loaded.scene(seed)
    if pick is not None:
        possible, data = _explain_pick(loaded, scene, pick)
        goal_options.save(json_file, data)
        return 0 if possible else 1
    request = goal_options.planning_request(
        loaded.model,
        group or goal_options.arm_group(loaded.model),
        to,
        pose,
        rpy_deg,
        joints,
        joints_deg,
        line,
        start_deg,
        planner,
        seconds,
        seed,
        link,
    )
    data = _joint_solutions(scene, request, link) if pose is not None else {}
    explanation = _explanation(scene, request)
    _print(explanation, bool(data))
    goal_options.save(
        json_file, {**data, "possible": explanation.code.ok, "explanation": explanation.as_dict()}
    )
    if view:
        from armcell.cli.page import show

        show(scene, None, explanation, PageAddress(host, port, allow_host), loaded.name)
    return 0 if explanation.code.ok else 1


def _explanation(scene: Any, request: Any) -> Explanation:
    from armcell.planning import explain as explain_request

    return explain_request(scene, request)


def _print(explanation: Explanation, solutions_told: bool) -> None:
    if explanation.code.ok:
        console.print("a motion was found")
        return
    lines = explanation.text().splitlines()
    if solutions_told:  # the table already lists all joint solutions
        lines = [line for line in lines if not line.startswith("  joint solution")]
    console.print("\n".join(lines), markup=False, soft_wrap=True)


def _joint_solutions(scene: Any, request: Any, link: str | None) -> dict[str, Any]:
    """Print all joint solutions for the pose that `armcell explain` explains, and return them as data."""
    from dataclasses import replace

    from armcell.core import CartesianRequest
    from armcell.planning import explain_pose

    straight = isinstance(request, CartesianRequest)
    target = request.waypoints[-1] if straight else request.goals[0].T_world_link
    if request.start is not None:
        scene = replace(scene, positions=scene.state.updated(request.start).positions)
    result = explain_pose(scene, request.group, target, link)
    console.print(result.summary, markup=False)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("joints [deg]", "what is wrong"):
        table.add_column(title, overflow="fold")
    for branch in (*result.branches, *result.outside):
        joints = " ".join(f"{v:.0f}" for v in np.rad2deg(branch.positions))
        table.add_row(joints, branch.reason(scene.model))
    if result.branches or result.outside:
        console.print(table)
    return {
        "reachable": result.reachable,
        "summary": result.summary,
        "joint_names": list(result.joint_names),
        "branches": [
            {
                "positions": b.positions.tolist(),
                "contacts": [
                    {"body_a": c.body_a, "body_b": c.body_b, "distance_m": c.distance} for c in b.contacts
                ],
            }
            for b in result.branches
        ],
        "outside_limits": [
            {"positions": b.positions.tolist(), "beyond": dict(b.beyond)} for b in result.outside
        ],
        "position_error_m": result.position_error,
        "rotation_error_rad": result.rotation_error,
        "joints_at_limit": result.joints_at_limit,
    }


def _explain_pick(loaded, scene, item: str) -> tuple[bool, dict[str, Any]]:
    from armcell.core import InputError
    from armcell.grasping import grasp_candidates, hand_of
    from armcell.tasks import PartialSolution, SearchState
    from armcell.tasks.stages import ChooseGrasp

    if not scene.object(item).movable:
        raise InputError(f"object {item!r} is fixed", hint="give it 'movable: true'")
    gripper = loaded.model.gripper(arm_group=goal_options.arm_group(loaded.model))
    hand = hand_of(scene.model, gripper)
    grasps, rejected = grasp_candidates(scene.object(item), hand, pose_error=loaded.settings.pose_error)
    planning = SearchState(loaded.settings)
    stage = ChooseGrasp(item, gripper, loaded.settings.near, loaded.settings.approach_distance)
    works = {solution.data["candidate"] for solution in stage.propose(PartialSolution(scene), planning)}
    reasons = {r.name: r.reason for r in rejected}
    for _, candidate, reason in planning.rejections.details:
        reasons.setdefault(candidate, reason)
    named = {grasp.name for grasp in grasps} | {rejection.name for rejection in rejected}
    turned = sorted((works | reasons.keys()) - named - {""})  # copies of grasps, for an arm with few joints
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("grasp", "verdict"):
        table.add_column(title, overflow="fold")
    default = "turned to the arm" if turned else "not looked at"
    for name in (*(grasp.name for grasp in grasps), *turned):
        table.add_row(name, "works" if name in works else reasons.get(name, default))
    for rejection in rejected:
        table.add_row(rejection.name, rejection.reason)
    console.print(table)
    console.print(f"{len(works)} of {len(named) + len(turned)} grasps of {item} have a free approach")
    return bool(works), {
        "works": sorted(works),
        "rejected": {k: v for k, v in reasons.items() if k not in works},
    }
