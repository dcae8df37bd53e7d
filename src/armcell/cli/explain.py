"""`armcell explain`: can the arm get there, can it hold that, and if not, why."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.table import Table

from armcell.cli.console import check_writable, console, write_json


def explain(
    cell: str = typer.Argument(..., help="Built-in cell, folder with cell.yaml, or YAML file."),
    pose: tuple[float, float, float] | None = typer.Option(
        None, metavar="X Y Z", help="Position of the tip in the world frame [m]."
    ),
    rpy_deg: tuple[float, float, float] = typer.Option(
        (180.0, 0.0, 0.0), metavar="R P Y", help="Orientation of the tip [deg]; the default points down."
    ),
    pick: str | None = typer.Option(None, metavar="OBJECT", help="Explain which grasps of an object work."),
    group: str | None = typer.Option(None, help="Planning group; the arm by default."),
    seed: int | None = typer.Option(None, min=0, help="Draw of the cell's randomised values."),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the evidence as JSON."),
) -> int:
    """Say whether a pose or a grasp is possible, and the reason for every one that is not.

    Exit status 0 if it is possible, 1 if not.
    """
    if (pose is None) == (pick is None):
        raise typer.BadParameter("give either --pose X Y Z or --pick OBJECT")
    from armcell.cell import load

    if json_file is not None:
        check_writable(json_file)
    loaded = load(cell)
    scene = loaded.scene(seed)
    if pick is not None:
        possible, data = _explain_pick(loaded, scene, pick)
    else:
        possible, data = _explain_pose(scene, group or _arm_group(loaded.model), pose or (0, 0, 0), rpy_deg)
    if json_file is not None:
        write_json(json_file, data)
    return 0 if possible else 1


def _arm_group(model) -> str:
    from armcell.core import InputError

    groups = [g.arm_group for g in model.grippers.values()] or [
        g.name for g in model.groups.values() if g.tip_link
    ]
    if not groups:
        raise InputError(
            f"robot {model.name!r} has no arm: no planning group is a chain", cure="name one with --group"
        )
    return groups[0]


def _explain_pose(scene, group: str, xyz, rpy_deg) -> tuple[bool, dict[str, Any]]:
    from armcell.core import SE3
    from armcell.planning import explain_pose

    result = explain_pose(scene, group, SE3.from_xyz_rpy(xyz, np.deg2rad(rpy_deg)))
    console.print(result.summary, markup=False)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("joints [deg]", "what touches"):
        table.add_column(title, overflow="fold")
    for branch in result.branches:
        joints = " ".join(f"{v:.0f}" for v in np.rad2deg(branch.positions))
        table.add_row(joints, "; ".join(c.describe() for c in branch.contacts[:3]) or "free")
    if result.branches:
        console.print(table)
    return result.reachable, {
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
        "position_error_m": result.position_error,
        "rotation_error_rad": result.rotation_error,
        "joints_at_limit": result.joints_at_limit,
    }


def _explain_pick(loaded, scene, item: str) -> tuple[bool, dict[str, Any]]:
    from armcell.core import InputError
    from armcell.grasping import grasp_candidates
    from armcell.tasks import Draft, Planning
    from armcell.tasks.stages import ChooseGrasp

    if not scene.object(item).movable:
        raise InputError(f"object {item!r} is fixed", cure="give it 'movable: true'")
    gripper = loaded.model.gripper(arm_group=_arm_group(loaded.model))
    grasps, rejected = grasp_candidates(scene.object(item), gripper)
    planning = Planning(loaded.settings)
    stage = ChooseGrasp(item, gripper, loaded.settings.near, loaded.settings.approach_distance)
    works = {draft.data["candidate"] for draft in stage.drafts(Draft(scene), planning)}
    reasons = {r.name: r.reason for r in rejected}
    for _, candidate, reason in planning.rejections.details:
        reasons.setdefault(candidate, reason)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("grasp", "verdict"):
        table.add_column(title, overflow="fold")
    for grasp in grasps:
        table.add_row(
            grasp.name, "works" if grasp.name in works else reasons.get(grasp.name, "not looked at")
        )
    for rejection in rejected:
        table.add_row(rejection.name, rejection.reason)
    console.print(table)
    console.print(f"{len(works)} of {len(grasps) + len(rejected)} grasps of {item} have a free approach")
    return bool(works), {
        "works": sorted(works),
        "rejected": {k: v for k, v in reasons.items() if k not in works},
    }
