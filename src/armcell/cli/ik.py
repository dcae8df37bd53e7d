"""`armcell ik`: list joint solutions for a pose. `armcell fk`: compute the poses of links."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from armcell.cli import goals
from armcell.cli.console import console


def ik(
    cell: str = goals.CELL,
    pose: goals.Triple = typer.Option(
        ..., "--pose", metavar="X Y Z", help="Position in the world frame [m]."
    ),
    rpy_deg: goals.Triple = goals.RPY_DEG,
    group: str | None = goals.GROUP,
    link: str | None = goals.LINK,
    start_deg: str | None = goals.START_DEG,
    seed: int | None = goals.SEED,
    json_file: Path | None = goals.JSON,
) -> int:
    """List the joint solutions of a pose (inverse kinematics). The solution nearest to the start comes first.

    Each rejected solution has its reason.

    Example: armcell ik panda_pick --pose 0.5 0.2 0.3

    Exit status 0 if a solution is collision-free and within limits, 1 if not.
    """
    goals.checked_json(json_file)
    from armcell.cell import load
    from armcell.core import SE3
    from armcell.planning import explain_pose, solve_ik

    loaded = load(cell)
    model, scene = loaded.model, loaded.scene(seed)
    name = group or goals.arm_group(model)
    if start_deg is not None:
        scene = scene.with_state(goals.joint_state(model, name, start_deg, True))
    target = SE3.from_xyz_rpy(pose, np.deg2rad(rpy_deg))
    result = solve_ik(scene, name, target, link, seed=seed or 0)
    found = explain_pose(scene, name, target, link, seed or 0)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("joints [deg]", "verdict"):
        table.add_column(title, overflow="fold")
    if result.positions is not None and result.ok:
        table.add_row(goals.in_degrees(model, found.joint_names, result.positions), "free; this one is taken")
    for branch in (*found.branches, *found.outside):
        table.add_row(goals.in_degrees(model, found.joint_names, branch.positions), branch.reason(model))
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
    goals.save(json_file, data)
    return 0 if result.ok else 1


def fk(
    cell: str = goals.CELL,
    to: str | None = goals.TO,
    joints: str | None = goals.JOINTS,
    joints_deg: str | None = goals.JOINTS_DEG,
    group: str | None = goals.GROUP,
    link: str | None = typer.Option(None, metavar="LINK", help="Only this link; default: all."),
    seed: int | None = goals.SEED,
    json_file: Path | None = goals.JSON,
) -> int:
    """Print link poses [m, deg], computed by forward kinematics for the start state,
    a named state or given joint positions.

    Example: armcell fk panda_pick --joints-deg '0 -45 0 -135 0 90 45' --link panda_hand_tcp
    """
    goals.checked_json(json_file)
    from armcell.cell import load

    loaded = load(cell)
    scene = loaded.scene(seed)
    scene = scene.with_state(
        goals.state_of(loaded.model, group or goals.arm_group(loaded.model), scene, to, joints, joints_deg)
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
    goals.save(json_file, {"joints": scene.state, "links": poses})
    return 0
