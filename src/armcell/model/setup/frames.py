"""Additional frames of a robot, such as the tool center of a gripper."""

from __future__ import annotations

from dataclasses import replace

from armcell.core import SE3
from armcell.model.robot import Joint, Link, RobotModel


def with_frame(model: RobotModel, name: str, parent: str, T_parent_frame: SE3) -> RobotModel:
    """Return the robot with an additional frame, such as a gripper's tcp.
    It is a link without geometry that is fixed to another link.
    """
    joint = Joint(f"{name}_joint", "fixed", parent, name, T_parent_frame)
    return replace(
        model,
        links={**model.links, name: Link(name)},
        joints={**model.joints, joint.name: joint},
        frames={**model.frames, name: joint},
    )


def with_tip(model: RobotModel, group: str, link: str) -> RobotModel:
    """Return the robot with a new tip link for a planning group (chain),
    such as the tcp of a detected gripper.
    """
    old = model.groups[group]
    chain = model.chain(str(old.base_link), link)
    new = replace(old, tip_link=link, link_names=tuple(j.child for j in chain))
    return replace(model, groups={**model.groups, group: new})
