"""The grippers of `armcell setup`: numbers, picture, and the question when recognition is not sure."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from armcell.cli.console import console

if TYPE_CHECKING:
    from armcell.cell.setup import SetupProposal
    from armcell.model import Gripper, RobotModel
    from armcell.model.setup.gripper_detection import GripperSpec

HINT = "to pick and place, pass --gripper, or describe the gripper in robot.yaml (docs/adding_a_gripper.md)"
QUESTION = (
    "State the gripper, such as drive=JOINT fingers=LINK,LINK closes=upper (--help explains the words). "
    "Press Enter to continue without a gripper."
)
HELP = """The option --gripper states what setup does not recognize, as KEY=VALUE words (all optional):

  drive=JOINT            driven joint that moves the jaws

  fingers=LINK,LINK      links of both jaws (several per side: A,B+C)

  tcp=LINK               tool center: y closes, z points out of the hand

  closes=lower|upper     limit of the driven joint at which it is closed

  end=NAME               end effector, if the robot has several

Setup rejects facts that contradict the meshes, and proves the gripper by closing it on a cube in
physics. On a terminal, setup asks for these words if it does not recognize a gripper.
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

    g, tree, q = gripper, kinematic_tree(model), model.default_positions()
    palm = g.hand_links[0]
    T = tree.link_pose(q, palm).inverse() @ tree.link_pose(q, g.tcp_link)
    x, y, z = 1000 * T.translation
    along = ", ".join(f"{v + 0.0:.2f}" for v in T.rotation.matrix[:, 1].round(2))
    out = ", ".join(f"{v + 0.0:.2f}" for v in T.rotation.matrix[:, 2].round(2))
    (x0, z0), (x1, z1) = 1000 * hand_of(model, g).pad
    limits = model.joint(g.joint_name).limits
    ends = [min(max(g.joint_position(w), limits.lower), limits.upper) for w in (0.0, g.max_width)]
    least = max(1000 * g.width(ends[0]), 0.0)
    moved = f"joint {g.joint_name}: {ends[0]:.3g} to {ends[1]:.3g}"
    return {
        "opening": f"{least:.0f} to {1000 * g.max_width:.0f} mm ({moved})",
        "closing": f"along y of {g.tcp_link}: ({along}) in {palm}; out of the hand: ({out})",
        "center": f"{g.tcp_link} at ({x:.0f}, {y:.0f}, {z:.0f}) mm in {palm}",
        "pads": f"{x1 - x0:.0f} x {z1 - z0:.0f} mm, on {' and '.join(g.finger_links)}",
        "force": f"{g.max_force:.0f} N per finger",
    }


def has_unproven_gripper(proposal: SetupProposal) -> bool:
    """Return whether an end effector on an arm lacks a gripper that has held a cube in the simulation of
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
            from armcell.cell.gripper_picture import gripper_picture

            gripper_picture(proposal.model, gripper).save(file)
        except Exception as error:  # a picture is no reason to fail on a machine without graphics
            console.print(f"no picture of {gripper.name}: {error}", markup=False, soft_wrap=True)
        else:
            console.print(f"picture: {file} (open and closed, with tcp frame, pads and closing direction)",
                          markup=False, soft_wrap=True)  # fmt: skip
