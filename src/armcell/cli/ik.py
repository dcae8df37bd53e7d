"""`armcell ik`: list joint solutions for a pose. `armcell fk`: compute the poses of links."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from armcell.cli import goal_options
from armcell.cli.console import console


def ik(
    cell: str = goal_options.CELL,
    pose: goal_options.Triple = typer.Option(
        ..., "--pose", metavar="X Y Z", help="Position in the world frame [m]."
    ),
    rpy_deg: goal_options.Triple = goal_options.RPY_DEG,
    group: str | None = goal_options.GROUP,
    link: str | None = goal_options.LINK,
    start_deg: str | None = goal_options.START_DEG,
    seed: int | None = goal_options.SEED,
    json_file: Path | None = goal_options.JSON,
) -> int:
    """List the joint solutions of a pose (inverse kinematics). The solution nearest to the start comes first.

    Each rejected solution has its reason.

    Example: armcell ik panda_pick --pose 0.5 0.2 0.3

    Exit status 0 if a solution is collision-free and within limits, 1 if not.
    """
    goal_options.check_json_path(json_file)
    from armcell.cell import load
    from armcell.core import SE3
    from armcell.planning import explain_pose, solve_ik

    loaded = load(cell)
    model, scene = loaded.model, loaded.scene(seed)
    name = group or goal_options.arm_group(model)
    if start_deg is not None:
        scene = scene.with_state(goal_options.joint_state(model, name, start_deg, True))
    target = SE3.from_xyz_rpy(pose, np.deg2rad(rpy_deg))
    result = solve_ik(scene, name, target, link, seed=seed or 0)
    found = explain_pose(scene, name, target, link, seed or 0)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("joints [deg]", "verdict"):
        table.add_column(title, overflow="fold")
    if result.positions is not None and result.ok:
        table.add_row(
            goal_options.format_joints(model, found.joint_names, result.positions), "free; this one is taken"
        )
    for branch in (*found.branches, *found.outside):
        table.add_row(
            goal_options.format_joints(model, found.joint_names, branch.positions), branch.reason(model)
        )
    console.print(table)
    data = {
        "ok": result.ok,
        "code_name": result.code.name,
        "joint_names": found.joint_names,
        "positions": result.positions if result.ok else None,
        "position_error_m": result.position_error,
        "rotation_error_rad": result.rotation_error,
        "solutions": [
            {"positions": b.positions, "reason": b.reason(model), "free": b.free}
            for b in (*found.branches, *found.outside)
        ],
    }
    if not result.ok:
        explanation = result.explain()
        data["explanation"] = explanation.as_dict()
        console.print(f"{result.code.name}: {explanation.summary}", markup=False, soft_wrap=True)
    goal_options.save(json_file, data)
    return 0 if result.ok else 1


def fk(
    cell: str = goal_options.CELL,
    to: str | None = goal_options.TO,
    joints: str | None = goal_options.JOINTS,
    joints_deg: str | None = goal_options.JOINTS_DEG,
    group: str | None = goal_options.GROUP,
    link: str | None = typer.Option(None, metavar="LINK", help="Only this link; default: all."),
    seed: int | None = goal_options.SEED,
    json_file: Path | None = goal_options.JSON,
) -> int:
    """Print link poses [m, deg], computed by forward kinematics for the start state,
    a named state or given joint positions.

    Example: armcell fk panda_pick --joints-deg '0 -45 0 -135 0 90 45' --link panda_hand_tcp
    """
    goal_options.check_json_path(json_file)
    from armcell.cell import load

    loaded = load(cell)
    scene = loaded.scene(seed)
    scene = scene.with_state(
        goal_options.selected_state(
            loaded.model, group or goal_options.arm_group(loaded.model), scene, to, joints, joints_deg
        )
    )
    links = [link] if link is not None else list(loaded.model.links)
    poses = {name: scene.frame_pose(name) for name in links}
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("link", "x y z (m)", "roll pitch yaw (deg)"):
        table.add_column(title, overflow="fold")
    for name, T in poses.items():
        xyz, rpy = (" ".join(f"{v:.{d}f}" for v in values) for values, d in (
            (T.translation, 4), (np.rad2deg(T.rotation.rpy), 2)))  # fmt: skip
        table.add_row(name, xyz, rpy)
    console.print(table)
    goal_options.save(json_file, {"joints": scene.state, "links": poses})
    return 0
