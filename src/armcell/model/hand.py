"""A robot's gripper extracted as a separate robot model, without the arm."""

from __future__ import annotations

from dataclasses import replace

from armcell.model.grippers import Gripper
from armcell.model.robot import RobotModel


def hand_alone(model: RobotModel, gripper: Gripper) -> RobotModel:
    """Return a robot model of a hand without its arm.
    It contains the gripper's links and all links below them.

    The root link is the lowest link above all links of the gripper. The new model has no planning groups, end
    effectors or named states; the gripper and its joints are unchanged.
    """
    links = {gripper.tcp_link, *gripper.hand_links, *gripper.contact_links}
    chains = [[j.parent for j in reversed(model.chain(model.root_link, link))] for link in links]
    above = [
        [link, *chain] for link, chain in zip(links, chains, strict=True)
    ]  # ancestors of each link, from the link up to the root
    root = next(link for link in above[0] if all(link in chain for chain in above[1:]))
    kept = model.subtree(root)
    return replace(
        model,
        name=f"{model.name}:{gripper.name}",
        root_link=root,
        links={n: link for n, link in model.links.items() if n in kept},
        joints={n: j for n, j in model.joints.items() if j.parent in kept},
        groups={},
        end_effectors={},
        named_states={},
        grippers={gripper.name: gripper},
        disabled_collisions={p: why for p, why in model.disabled_collisions.items() if p <= set(kept)},
    )
