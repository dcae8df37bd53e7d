"""Parser for goals, joint values and planning groups from the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import typer

from armcell.core import (
    SE3,
    CartesianRequest,
    InputError,
    JointGoal,
    JointState,
    NamedGoal,
    PlanRequest,
    PoseGoal,
)
from armcell.core.results import to_json_types

CELL = typer.Argument(..., help="Built-in cell (see `armcell cells`), folder with cell.yaml, or YAML file.")
TO = typer.Option(None, "--to", metavar="NAME", help="Named state of the group, e.g. home.")
POSE = typer.Option(
    None, "--pose", metavar="X Y Z", help="Position of the tip in the world frame [m]; see --rpy-deg."
)
RPY_DEG = typer.Option(
    (180.0, 0.0, 0.0), metavar="R P Y", help="Orientation of the tip [deg]; the default points down."
)
JOINTS = typer.Option(
    None, "--joints", metavar="VALUES",
    help="Joint positions [rad or m]: all of the group's, or some as name=value; quoted, e.g. '0 -0.8 ...'.",
)  # fmt: skip
JOINTS_DEG = typer.Option(
    None, "--joints-deg", metavar="VALUES", help="The same, with angles in degrees (slides stay in m)."
)
START_DEG = typer.Option(
    None,
    "--start-deg",
    metavar="VALUES",
    help="Begin here [deg], e.g. 'panda_joint1=30'; default: the cell's.",
)
LINE = typer.Option(False, "--line", help="To --pose on a straight line.")
LINK = typer.Option(None, metavar="LINK", help="The link to place; the group's tip by default.")
GROUP = typer.Option(None, help="Planning group; the arm by default.")
SEED = typer.Option(None, min=0, help="Draw of the cell's randomised values, and seed of the planner.")
PLANNER = typer.Option(
    "RRTConnect", metavar="[PIPELINE/]PLANNER", help="e.g. ompl/RRTstar; the pipeline is native by default."
)
TIME = typer.Option(5.0, "--time", metavar="SECONDS", help="Planning time.")
JSON = typer.Option(None, "--json", metavar="FILE", help="Write the numbers as JSON.")
GAINS = typer.Option(
    None, "--gains", metavar="NAME|FILE",
    help="Gains of the arm joints: ros_control's controllers.yaml, a file of armcell's own, or firm, "
    "position, tutorial. [default: the cell's]",
)  # fmt: skip
VIEW = typer.Option(False, "--view", help="Show it in the browser; Enter ends it.")
Triple = tuple[float, float, float]


def arm_group(model: Any) -> str:
    """Return the planning group that carries a gripper, which is the default group for goals of a command.

    Raises:
        InputError: no planning group is a chain.
    """
    groups = [g.arm_group for g in model.grippers.values()] or [
        g.name for g in model.groups.values() if g.tip_link
    ]
    if not groups:
        raise InputError(
            f"robot {model.name!r} has no arm: no planning group is a chain", hint="name one with --group"
        )
    return groups[0]


def joint_state(model: Any, group: str, text: str, degrees: bool) -> JointState:
    """Parse joint positions that a command line gives as a goal:
    numbers for all joints, or name=value for some.

    Raises:
        InputError: a value is not a number, or the number of values is wrong.
        UnknownNameError: a joint does not exist.
    """
    words = text.replace(",", " ").split()
    names = model.group(group).joint_names
    if any("=" in word for word in words):
        pairs = [word.partition("=")[::2] for word in words]
    elif len(words) == len(names):
        pairs = list(zip(names, words, strict=True))
    else:
        raise InputError(
            f"{len(words)} joint positions given, group {group!r} has {len(names)}: {', '.join(names)}",
            hint="give all of them, or some as name=value",
        )
    values = {}
    for name, word in pairs:
        joint = model.joint(name)
        try:
            value = float(word)
        except ValueError:
            raise InputError(f"joint {name!r}: {word!r} is not a number") from None
        values[name] = np.deg2rad(value) if degrees and joint.type != "prismatic" else value
    return JointState.from_mapping(values)


def selected_goal(given: dict[str, Any]) -> str:
    """Return the one goal option that a command line contains. The goal options are mutually exclusive.

    Raises:
        typer.BadParameter: no option or several options were given.
    """
    used = [name for name, value in given.items() if value is not None and value is not False]
    if len(used) != 1:
        raise typer.BadParameter(f"give one of {', '.join(given)}" + (f", not {len(used)}" if used else ""))
    return used[0]


def planning_request(
    model: Any,
    group: str,
    to: str | None,
    pose: Triple | None,
    rpy_deg: Triple,
    joints: str | None,
    joints_deg: str | None,
    line: bool = False,
    start_deg: str | None = None,
    planner: str = "RRTConnect",
    seconds: float = 5.0,
    seed: int | None = None,
    link: str | None = None,
) -> PlanRequest | CartesianRequest:
    """Return the planning request that corresponds to the goal options of a command line.

    Raises:
        typer.BadParameter: the options do not go together.
        InputError: a joint value is invalid.
    """
    chosen = selected_goal({"--to": to, "--pose": pose, "--joints": joints, "--joints-deg": joints_deg})
    start = joint_state(model, group, start_deg, True) if start_deg is not None else None
    target = SE3.from_xyz_rpy(pose, np.deg2rad(rpy_deg)) if pose is not None else SE3.identity()
    if line:
        if chosen != "--pose":
            raise typer.BadParameter("--line goes to a --pose")
        return CartesianRequest(group, (target,), link=link, start=start)
    if chosen == "--pose":
        goal = PoseGoal(target, link)
    elif chosen == "--to":
        goal = NamedGoal(str(to))
    else:
        goal = JointGoal(joint_state(model, group, str(joints or joints_deg), joints_deg is not None))
    pipeline, _, name = planner.rpartition("/")
    return PlanRequest(
        group, (goal,), start=start, planner_id=name, pipeline_id=pipeline or "native",
        planning_time=seconds, seed=seed or 0,
    )  # fmt: skip


def check_json_path(json_file: Path | None) -> None:
    """Check that the JSON output file of a command with goal options can be written,
    before the command starts its work.
    """
    from armcell.cli.console import check_writable

    if json_file is not None:
        check_writable(json_file)


def save(json_file: Path | None, data: Any) -> None:
    from armcell.cli.console import write_json

    if json_file is not None:
        write_json(json_file, to_json_types(data))


def format_joints(model: Any, names: tuple[str, ...], q: np.ndarray) -> str:
    """Format the joint positions (n,) of a goal: degrees for revolute joints,
    millimeters for prismatic joints.
    """
    return " ".join(
        f"{v * 1000:.1f}mm" if model.joint(n).type == "prismatic" else f"{np.rad2deg(v):.1f}"
        for n, v in zip(names, q, strict=True)
    )


def selected_state(
    model: Any, group: str, scene: Any, to: str | None, joints: str | None, joints_deg: str | None
) -> JointState:
    """Return the state that the goal options of a command line specify by a name or by joint positions.
    Without such options, return the state of the scene.
    """
    given = {"--to": to, "--joints": joints, "--joints-deg": joints_deg}
    if not any(value is not None for value in given.values()):
        return scene.state
    if selected_goal(given) == "--to":
        return model.named_state(group, to)
    return joint_state(model, group, str(joints or joints_deg), joints_deg is not None)
