"""`armcell check-state`: check a robot state for contacts and joint limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.table import Table

from armcell.cli import goal_options
from armcell.cli.console import console, millimeters


def check_state(
    cell: str = goal_options.CELL,
    to: str | None = goal_options.TO,
    joints: str | None = goal_options.JOINTS,
    joints_deg: str | None = goal_options.JOINTS_DEG,
    group: str | None = goal_options.GROUP,
    seed: int | None = goal_options.SEED,
    json_file: Path | None = goal_options.JSON,
) -> int:
    """Check a robot state.
    Show its contacts, its smallest clearance, and how far each joint is from its limits.

    Without --to or --joints, the state is the cell's start.

    Example: armcell check-state panda_pick --joints-deg 'panda_joint2=60'

    Exit status 0 if the state is within limits and free of contact, 1 if not.
    """
    goal_options.check_json_path(json_file)
    from armcell.cell import load
    from armcell.collision import ExactChecker

    loaded = load(cell)
    model, scene = loaded.model, loaded.scene(seed)
    name = group or goal_options.arm_group(model)
    state = scene.state.updated(goal_options.selected_state(model, name, scene, to, joints, joints_deg))
    q = state.positions
    margins = np.minimum(q - model.lower, model.upper - q)
    checker = ExactChecker(scene)
    contacts = checker.contacts(q, padded=False)
    nearest = checker.nearest(q)
    inside = bool(np.all(margins >= 0))
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("joint", "position", "to its nearer limit"):
        table.add_column(title, overflow="fold")
    for joint, value, margin in zip(model.joint_names, q, margins, strict=True):
        slide = model.joint(joint).type == "prismatic"
        at, left = (f"{v * 1000:.1f} mm" if slide else f"{np.rad2deg(v):.1f} deg" for v in (value, margin))
        table.add_row(
            joint, at, left if np.isfinite(margin) else "none", style=None if margin >= 0 else "red"
        )
    console.print(table)
    for contact in contacts:
        console.print(contact.describe(), markup=False)
    if not contacts:
        within = checker.contacts(q)
        console.print(
            "touches nothing"
            + (f"; nearest: {nearest.describe()}" if nearest is not None else "")
            + (f", within the padding of {millimeters(scene.padding)}" if within else ""),
            markup=False,
        )
    goal_options.save(
        json_file,
        {
            "ok": inside and not contacts,
            "within_limits": inside,
            "contacts": contacts,
            "nearest": nearest,
            "joints": state,
            "limit_margins": dict(zip(model.joint_names, margins, strict=True)),
        },
    )
    return 0 if inside and not contacts else 1
