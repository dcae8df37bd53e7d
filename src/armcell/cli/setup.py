"""`armcell setup`: create a planning cell from a URDF, with numbers, pictures and questions of grippers.

It needs neither a GUI nor ROS. It asks about a gripper if the recognition is not sure.
"""

from __future__ import annotations

import logging
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from armcell import _interrupts
from armcell.cli.console import console, errors
from armcell.cli.page import ALLOW_HOST, HOST, PORT, PageAddress, print_page_address

if TYPE_CHECKING:
    from armcell.cell.setup import SetupProposal
    from armcell.collision.self_collision import LinkPair
    from armcell.model import Gripper, RobotModel
    from armcell.model.setup import UrdfPart
    from armcell.model.setup.gripper_detection import GripperSpec

HINT = "to pick and place, pass --gripper, or describe the gripper in robot.yaml (docs/adding_a_gripper.md)"
STEPS = {
    "reading": (0.0, 0.05),
    "groups and poses": (0.05, 0.2),
    "spheres around the links": (0.2, 0.7),
    "pairs of links": (0.7, 0.85),
    "closing the gripper on a cube": (0.85, 0.9),
    "planning and picking a cube": (0.9, 1.0),
}
"""Start and end of each step in the progress bar: typical shares of the CPU time for arms with a gripper."""
QUESTION = (
    "State the gripper, such as drive=JOINT fingers=LINK,LINK closes=upper, or suction (--help explains the "
    "words). "
    "Press Enter to continue without a gripper."
)
HELP = """The option --gripper states what setup does not recognize, as KEY=VALUE words (all optional):

  drive=JOINT            driven joint that moves the jaws

  follower=JOINT         joint that follows the driven joint, if the file does not couple them

  range=LOWER,UPPER      limits of the driven joint [rad or m], if those in the URDF are wrong

  fingers=LINK,LINK      links of both jaws (several per side: A,B+C)

  tcp=LINK               tool center: y closes, z points out of the hand

  closes=lower|upper     limit of the driven joint at which it is closed

  suction                it holds by suction cups, which are named like cups

  cups=LINK,LINK         links of the suction cups

  end=NAME               end effector, if the robot has several

Setup rejects facts that contradict the meshes, and proves the gripper by closing it on a cube in
physics, or by lifting a plate with its cups. On a terminal, setup asks for these words if it does not
recognize a gripper.
"""
EXAMPLES = f"""
Examples:

  armcell setup my_robot.urdf -o my_cell                one robot

  armcell setup my_robot.urdf.xacro -o my_cell --web    look at it in the browser before it is written

  armcell setup ur10.urdf ur10.urdf --prefix left_ --prefix right_ --at 0,0.6,0 --at 0,-0.6,0 -o two_arms

  armcell setup my_robot.urdf -o my_cell --gripper "drive=finger_joint closes=upper"

  armcell setup my_robot_moveit_config -o my_cell       a cell on a MoveIt package, its groups and pairs kept

{HELP}
The folder holds a MoveIt configuration package (config/), cell.yaml, and LAUNCH.md with the commands for
users who go on in ROS 1 or ROS 2. What is found: arms are the longest
rows of joints, grippers what branches off their ends; pairs of links need no check where they are joined,
always touch or never do, by sampled states and proofs on the meshes. Each recognized gripper is shown as
numbers and as a picture, open and closed (gripper.png). Then:

  armcell check my_cell

  armcell run my_cell
"""


def parse_gripper_facts(texts: list[str]) -> list[GripperSpec]:
    """Parse the descriptions of grippers that the user passes to `armcell setup --gripper`."""
    from armcell.model.setup.gripper_detection import GripperSpec

    return [GripperSpec.parse(text) for text in texts]


def show_grippers(proposal: SetupProposal) -> None:
    """Print each end effector of a setup proposal with its gripper's dimensions and force, or with the reason
    why it has no gripper.
    """
    from armcell.model.setup.gripper_detection import reasons

    why = reasons(proposal.model)
    if not proposal.model.end_effectors:
        tips = ", ".join(str(g.tip_link) for g in proposal.model.groups.values() if g.tip_link)
        console.print(f"no gripper: nothing branches off or closes at {tips}; the cell only moves the arm "
                      "(docs/adding_a_gripper.md)", markup=False, soft_wrap=True)  # fmt: skip
    for end in proposal.model.end_effectors.values():
        proof = next((p for p in proposal.proofs if p.gripper.name == end.name), None)
        title = f"end effector {end.name} on {end.parent_link}"
        if proof is None:
            text = f"{title}: no gripper found: {why.get(end.name, 'no arm carries it')}; {HINT}"
            console.print(text, markup=False, soft_wrap=True)
            continue
        verdict = (
            proof.text
            if proof.held
            else f"not proven, so robot.yaml does not contain it: {proof.text}; {HINT}"
        )
        console.print(f"{title}: {verdict}", markup=False, soft_wrap=True)
        for name, text in _numbers(proposal.model, proof.gripper).items():
            console.print(f"  {name:9} {text}", markup=False, soft_wrap=True)


def _numbers(model: RobotModel, gripper: Gripper) -> dict[str, str]:
    from armcell.grasping import hand_of
    from armcell.kinematics import kinematic_tree
    from armcell.model import SuctionGripper

    g, tree, q = gripper, kinematic_tree(model), model.default_positions()
    palm = g.hand_links[0]
    T = tree.link_pose(q, palm).inverse() @ tree.link_pose(q, g.tcp_link)
    x, y, z = (1000 * T.translation).round() + 0.0
    out = ", ".join(f"{v + 0.0:.2f}" for v in T.rotation.matrix[:, 2].round(2))
    center = f"{g.tcp_link} at ({x:.0f}, {y:.0f}, {z:.0f}) mm in {palm}"
    if isinstance(g, SuctionGripper):
        places = [
            f"({a:.0f}, {b:.0f}, {c:.0f}) mm" for a, b, c in (1000 * hand_of(model, g).cups).round() + 0.0
        ]
        sizes = [f"{cup.link} at {at} in {g.tcp_link}, radius {1000 * cup.radius:.1f} mm, lip "
                 f"{1000 * cup.stroke:.1f} mm" for cup, at in zip(g.cups, places)]  # fmt: skip
        force = "; ".join(f"{g.force(cup):.0f}" for cup in g.cups)
        return {
            "center": center,
            "axis": f"z of {g.tcp_link}, out of the cups: ({out}) in {palm}",
            "cups": "; ".join(sizes),
            "force": f"{force} N at {g.vacuum:g} kPa below ambient, an assumed value: put the ejector's "
            "vacuum into robot.yaml",
        }
    along = ", ".join(f"{v + 0.0:.2f}" for v in T.rotation.matrix[:, 1].round(2))
    (x0, z0), (x1, z1) = 1000 * hand_of(model, g).pad
    limits = model.joint(g.joint_name).limits
    ends = [min(max(g.joint_position(w), limits.lower), limits.upper) for w in (0.0, g.max_width)]
    least = max(1000 * g.width(ends[0]), 0.0)
    moved = f"joint {g.joint_name}: {ends[0]:.3g} to {ends[1]:.3g}"
    return {
        "opening": f"{least:.0f} to {1000 * g.max_width:.0f} mm ({moved})",
        "closing": f"along y of {g.tcp_link}: ({along}) in {palm}; out of the hand: ({out})",
        "center": center,
        "pads": f"{x1 - x0:.0f} x {z1 - z0:.0f} mm, on {' and '.join(g.finger_links)}",
        "force": f"{g.max_force:.0f} N per finger",
    }


def has_unproven_gripper(proposal: SetupProposal) -> bool:
    """Return whether any arm carries an end effector that failed to hold the test cube in the simulation of
    `armcell setup`.
    """
    ends = proposal.model.end_effectors.values()
    return any(end.parent_group and end.name not in proposal.model.grippers for end in ends)


def is_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def ask(proposal: SetupProposal, again: Callable[[list[GripperSpec]], SetupProposal]) -> SetupProposal:
    """Ask on a terminal for facts about the gripper until setup recognizes it or the answer is empty.

    Args:
        again: proposes the setup again with the stated facts.
    """
    from armcell.core import InputError

    while has_unproven_gripper(proposal) and is_terminal():
        console.print(QUESTION, markup=False, soft_wrap=True)
        if not (text := input("--gripper ").strip()):
            break
        try:
            proposal = again(parse_gripper_facts([text]))
        except InputError as error:
            console.print(str(error), markup=False, soft_wrap=True)
        else:
            show_grippers(proposal)
    return proposal


def write_pictures(proposal: SetupProposal, folder: Path) -> None:
    """Write a picture of each recognized gripper into the folder that `armcell setup` has written."""
    for gripper in (proof.gripper for proof in proposal.proofs):
        file = folder / f"{gripper.name}.png"
        try:
            from armcell.cell.pictures import gripper_picture

            gripper_picture(proposal.model, gripper).save(file)
        except Exception as error:  # a picture is no reason to fail on a machine without graphics
            console.print(f"no picture of {gripper.name}: {error}", markup=False, soft_wrap=True)
        else:
            shown = "tcp frame and the rings of the cups" if gripper.joint_name == "" else (
                "open and closed, with tcp frame, pads and closing direction")  # fmt: skip
            console.print(f"picture: {file} ({shown})", markup=False, soft_wrap=True)


def setup(
    robots: list[Path] = typer.Argument(
        ...,
        metavar="ROBOT...",
        help="URDF, xacro or MJCF files (several: one robot each), or a MoveIt package.",
    ),
    output: Path = typer.Option(..., "--output", "-o", metavar="FOLDER", help="Folder to write."),
    prefix: list[str] = typer.Option(
        [], "--prefix", metavar="TEXT", help="Before every name; once per robot."
    ),
    at: list[str] = typer.Option(
        [], "--at", metavar="X,Y,Z", help="Where a robot stands in the world [m]; once per robot."
    ),
    rpy_deg: list[str] = typer.Option(
        [], "--rpy-deg", metavar="R,P,Y", help="How it is turned there [deg]; once per robot."
    ),
    name: str | None = typer.Option(None, help="Name of the robot; the URDF's by default."),
    samples: int = typer.Option(
        100_000, min=100, max=10_000_000, help="States sampled for the pairs of links."
    ),
    seed: int = typer.Option(0, min=0, help="Of the samples."),
    force: bool = typer.Option(False, "--force", help="Write into a folder that is not empty."),
    gripper: list[str] = typer.Option(
        [],
        "--gripper",
        metavar="WORDS",
        help="Facts about a gripper, as 'drive=JOINT closes=upper'; see below.",
    ),
    web: bool = typer.Option(False, "--web", help="Show it in the browser; write when 'Write' is clicked."),
    host: str = HOST,
    port: int = PORT,
    allow_host: list[str] = ALLOW_HOST,
) -> int:
    """Set up a robot: create a cell and a MoveIt package from a URDF, with groups, gripper, poses and the
    list of link pairs that need no collision check.

    Exit status 0 if the folder was written.
    """
    from armcell.cell.setup import propose, propose_from_package, write_cell
    from armcell.model.setup import check_folder, is_moveit_config
    from armcell.model.setup.launch import GUIDE

    check_folder(output, force)
    facts = parse_gripper_facts(gripper)
    if any(os.path.isdir(robot) for robot in robots):
        if len(robots) > 1 or not is_moveit_config(robots[0]) or prefix or at or rpy_deg:
            raise typer.BadParameter("a MoveIt package (a folder with config/*.srdf) is set up by itself")
        if facts:
            raise typer.BadParameter("a MoveIt package keeps its groups: describe its gripper in robot.yaml")
        proposal = propose_from_package(robots[0])
        _show(proposal)
    else:
        parts = _parts(robots, prefix, at, rpy_deg)

        def proposed(facts: list[GripperSpec]) -> SetupProposal:
            with _progress() as tell:
                return propose(parts, samples, seed, name, tell, facts)

        proposal = proposed(facts)
        _show(proposal)
        proposal = ask(proposal, proposed)
    if web:
        proposal_or_none = _in_browser(proposal, PageAddress(host, port, allow_host))
        if proposal_or_none is None:
            console.print("nothing written")
            return 1
        proposal = proposal_or_none
    write_cell(proposal, output, force)
    with _without_model_warnings():
        if proposal.model.grippers:
            _first_cell(output)
        write_pictures(proposal, output)
    console.print(f"written: {output}/ (MoveIt: {output}/config)", markup=False)
    console.print(f"next:    armcell check {output}", markup=False)
    console.print(f"in ROS:  {output}/{GUIDE} (roslaunch {output}/launch/move_group.launch)", markup=False)
    return 0


@contextmanager
def _without_model_warnings() -> Iterator[None]:
    """Silence the warnings of the model loaders while `armcell setup` loads the robot that it has written.
    They would repeat the faults of the source files, which setup has already reported.
    """
    logger = logging.getLogger("armcell.model")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _first_cell(folder: Path) -> None:
    """Replace the cell that `armcell setup` has created with one that
    has a table and a cube within reach of the gripper.
    """
    from armcell.cli.new import write_starter
    from armcell.model.loader import load_robot

    with _progress() as tell:
        tell("planning and picking a cube", 0)
        is_pick = write_starter(load_robot(folder), ".", folder)
    if not is_pick:
        console.print("no place was found where the gripper reaches a cube on a table: the cell only moves")


def _parts(robots: list[Path], prefixes: list[str], at: list[str], rpy_deg: list[str]) -> list[UrdfPart]:
    from armcell.model.setup import UrdfPart

    places = [parse_numbers("--at", text) for text in at]
    turns = [parse_numbers("--rpy-deg", text) for text in rpy_deg]
    for option, values in (("--prefix", prefixes), ("--at", places), ("--rpy-deg", turns)):
        if values and len(values) != len(robots):
            raise typer.BadParameter(f"{len(robots)} robots, but {option} is given {len(values)} times")
    if len(robots) > 1 and not prefixes:
        raise typer.BadParameter(f"{len(robots)} robots need a --prefix each, such as left_ and right_")
    if len(robots) > 1 and not places:  # side by side, 1.5 m apart
        places = [(0.0, 0.75 * (len(robots) - 1) - 1.5 * i, 0.0) for i in range(len(robots))]
    return [
        UrdfPart(
            file,
            prefixes[i] if prefixes else "",
            places[i] if places else ((0.0, 0.0, 0.0) if turns else None),
            turns[i] if turns else (0.0, 0.0, 0.0),
        )
        for i, file in enumerate(robots)
    ]


def parse_numbers(option: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(word) for word in text.replace(",", " ").split())
    except ValueError:
        raise typer.BadParameter(f"{option} {text!r} is not three numbers, as 0,0.6,0") from None
    if not all(math.isfinite(v) for v in (x, y, z)):
        raise typer.BadParameter(f"{option} {text!r} is not finite")
    return x, y, z


@contextmanager
def _progress() -> Iterator[Callable[[str, float], None]]:
    """Show the progress bar of `armcell setup` with the remaining time on standard error, if that is a
    terminal.
    """
    if not sys.stderr.isatty():
        yield lambda step, done: None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def tell(step: str, done: float) -> None:
            first, last = STEPS[step]
            bar.update(task, description=step, completed=first + done * (last - first))

        yield tell


def _show(proposal: SetupProposal) -> None:
    model = proposal.model
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("group", "joints", "from", "to", "states"):
        table.add_column(title, overflow="fold")
    for group in model.groups.values():
        states = ", ".join(model.named_states.get(group.name, {}))
        table.add_row(group.name, str(len(group.joint_names)), group.base_link, group.tip_link, states)
    console.print(f"{model.name}: {len(model.links)} links, {model.dof} driven joints", markup=False)
    console.print(table)
    show_grippers(proposal)
    if proposal.loose_joints:
        console.print(f"in no group: {', '.join(proposal.loose_joints)}", markup=False)
    _show_pairs(proposal)


def _show_pairs(proposal: SetupProposal) -> None:
    if not proposal.pairs:
        return
    total = len(proposal.pairs)
    words = []
    for reason in ("Adjacent", "Always", "Never", "Default"):
        some = [p for p in proposal.pairs if p.reason == reason]
        if some:
            proven = sum(p.proven for p in some)
            words.append(
                f"{len(some)} {reason.lower()}" + (f" ({proven} proven)" if reason == "Never" else "")
            )
    samples = max(p.samples for p in proposal.pairs)
    console.print(f"{total} pairs of links, {samples:,} states: {', '.join(words)}", markup=False)
    checked = sorted((p for p in proposal.pairs if not p.reason), key=lambda p: -p.share)
    console.print(f"{len(checked)} pairs are checked; those in contact most often:", markup=False)
    table = Table(box=None, pad_edge=False, show_header=False)
    for pair in checked[:8]:
        table.add_row(f"  {pair.link_a}", pair.link_b, _share(pair))
    console.print(table)
    for pair in proposal.pairs:
        if pair.reason == "Default":
            console.print(f"  ignored though they touch only in {_share(pair)}: {pair.link_a}, {pair.link_b}")
        elif pair.reason == "Never" and pair.touching:
            console.print(
                f"  ignored since only the collision shapes touch ({_share(pair)}), not the visual meshes: "
                f"{pair.link_a}, {pair.link_b}",
                soft_wrap=True,
            )


def _share(pair: LinkPair) -> str:
    return f"{100 * pair.share:.2f} %"


def _in_browser(proposal: SetupProposal, at: PageAddress) -> SetupProposal | None:
    from armcell.viewer.setup_view import SetupView

    with SetupView(proposal, **at._asdict()) as view:
        print_page_address(view.page)
        console.print("'Write' on the page writes the folder, Ctrl-C ends without")
        while not view.done:
            _interrupts.sleep(0.1)
        return view.answer
