"""`armcell plan`: plan one motion and print its numbers, or explain the failure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from armcell.cli import goal_options
from armcell.cli.console import console, millimeters
from armcell.cli.page import ALLOW_HOST, HOST, PORT, PageAddress


def plan(
    cell: str = goal_options.CELL,
    to: str | None = goal_options.TO,
    pose: goal_options.Triple | None = goal_options.POSE,
    rpy_deg: goal_options.Triple = goal_options.RPY_DEG,
    joints: str | None = goal_options.JOINTS,
    joints_deg: str | None = goal_options.JOINTS_DEG,
    line: bool = goal_options.LINE,
    start_deg: str | None = goal_options.START_DEG,
    group: str | None = goal_options.GROUP,
    link: str | None = goal_options.LINK,
    planner: str = goal_options.PLANNER,
    seconds: float = goal_options.TIME,
    seed: int | None = goal_options.SEED,
    json_file: Path | None = goal_options.JSON,
    view: bool = goal_options.VIEW,
    host: str = HOST,
    port: int = PORT,
    allow_host: list[str] = ALLOW_HOST,
) -> int:
    """Plan a motion for a cell's arm and print its key figures, such as duration and length. If planning
    fails, print the reason and remedies.

    Example: armcell plan panda_pick --pose 0.5 0.2 0.3 --planner ompl/RRTConnect

    Exit status 0 if a motion was found, 1 if not, 2 for wrong usage.
    """
    goal_options.check_json_path(json_file)
    goal_options.selected_goal({"--to": to, "--pose": pose, "--joints": joints, "--joints-deg": joints_deg})
    from armcell.cell import load
    from armcell.core import CartesianRequest
    from armcell.planning import plan as plan_free
    from armcell.planning import plan_cartesian

    loaded = load(cell)
    scene = loaded.scene(seed)
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
    if isinstance(request, CartesianRequest):
        result = plan_cartesian(scene, request)
    else:
        result = plan_free(scene, request)
    explanation = None if result.ok else result.explain()
    data = plan_metrics(result)
    if explanation is not None:
        data["explanation"] = explanation.as_dict()
        console.print(explanation.text(), markup=False, soft_wrap=True)
    else:
        console.print(
            f"planned by {result.planner_id} in {result.planning_time * 1000:.1f} ms: "
            f"{data['duration_s']:.2f} s, {data['waypoints']} waypoints, {data['length_rad']:.2f} rad long, "
            f"clearance {millimeters(data['clearance_m'])}"
        )
    goal_options.save(json_file, data)
    if view:
        from armcell.cli.page import show

        at = PageAddress(host, port, allow_host)
        show(scene, result.trajectory if result.ok else None, explanation, at, loaded.name)
    return 0 if result.ok else 1


def plan_metrics(result: Any) -> dict[str, Any]:
    """Return the key figures of a planned motion as data for JSON, for `armcell plan`."""
    trajectory, path = result.trajectory, result.path
    return {
        "ok": result.ok,
        "code": int(result.code),
        "code_name": result.code.name,
        "message": result.message,
        "planner": result.planner_id,
        "planning_time_s": result.planning_time,
        "fraction": result.fraction,
        "duration_s": trajectory.duration if trajectory is not None else None,
        "points": len(trajectory.times) if trajectory is not None else 0,
        "waypoints": len(path.waypoints) if path is not None else 0,
        "length_rad": path.length if path is not None else None,
        "clearance_m": result.min_clearance if trajectory is not None else None,
        "joint_names": list(path.joint_names) if path is not None else [],
        "path": path.waypoints.tolist() if path is not None else [],
    }
