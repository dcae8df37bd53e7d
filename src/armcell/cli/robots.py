"""`armcell robots`: list and show the robots that armcell knows by name."""

from __future__ import annotations

import math

import typer
from rich.table import Table

from armcell.cli.console import console

EXAMPLES = """
Examples:

  armcell robots                                  all robots, and what is missing for which

  armcell robots panda                            joints, limits, groups, gripper and states

  armcell robots fr3 --package franka_description=~/franka_description
"""


def robots(
    name: str | None = typer.Argument(None, metavar="[NAME_OR_FILE]", help="A robot to show, or its file."),
) -> None:
    """List the robots that armcell knows by name, or show one of them."""
    if name is None:
        _list()
    else:
        _show(name)


def _list() -> None:
    from armcell.model.loader import known_robot, robot_names

    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("robot", "ready", "source"):
        table.add_column(title, overflow="fold")
    found = [known_robot(name) for name in robot_names()]
    for robot in found:
        table.add_row(robot.name, "no" if robot.package else "yes", robot.source)
    console.print(table)
    for package in sorted({robot.package for robot in found if robot.package}):
        console.print(
            next(f"for {package}: {r.hint}" for r in found if r.package == package),
            markup=False,
            soft_wrap=True,
        )


def _show(name: str) -> None:
    from armcell.model.loader import load_robot

    model = load_robot(name)
    console.print(f"{model.name}: {model.source}", markup=False, soft_wrap=True)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("joint", "type", "lower", "upper", "velocity", "acceleration", "effort"):
        table.add_column(title)
    for joint in model.joints.values():
        limits = joint.limits
        if joint.mimic is not None:
            rule = f"follows {joint.mimic.joint}"
            table.add_row(joint.name, rule)
        elif joint.movable:
            values = (limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.effort)
            table.add_row(joint.name, joint.type, *(f"{v:.4g}" if math.isfinite(v) else "-" for v in values))
    console.print(table)
    console.print("positions in rad or m, velocities per second, efforts in Nm or N", markup=False)
    for group in model.groups.values():
        states = ", ".join(model.named_states.get(group.name, {})) or "none"
        ends = f", {group.base_link} to {group.tip_link}" if group.tip_link else ""
        console.print(
            f"group {group.name}: {len(group.joint_names)} joints{ends}; states: {states}", markup=False
        )
    for gripper in model.grippers.values():
        console.print(f"gripper {gripper.name}: {gripper.summary}, tcp {gripper.tcp_link}", markup=False)
