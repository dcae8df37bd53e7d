"""Attachment of a robot's MJCF parts to the physics model, with their own parameters."""

from __future__ import annotations

from typing import Any

from armcell.core import SE3
from armcell.model import RobotModel
from armcell.model.mjcf.spec import physics_spec
from armcell.model.robot import MjcfPart


def mjcf_links(model: RobotModel) -> dict[str, MjcfPart]:
    """Return the MJCF part that contains each robot link, by link name. Other links have no entry."""
    return {link: part for part in model.mjcf for link in part.links if link in model.links}


def attach_part(spec: Any, parent: Any, model: RobotModel, link: str, T_parent_link: SE3) -> dict[str, Any]:
    """Attach the bodies of an MJCF part to a MuJoCo spec, starting at a given link.
    Return the attached bodies by link.

    The bodies keep their inertias, contact parameters, joint parameters, equalities, tendons and excludes;
    names get the part's prefix.

    Args:
        spec: the MjSpec of the physics model.
        parent: its body that carries the link.
        T_parent_link: pose of the link, with its joint at zero.
    """
    part = mjcf_links(model)[link]
    child = physics_spec(part.text).copy()
    child.option, child.visual, child.stat = spec.option, spec.visual, spec.stat  # the cell's settings apply
    names = {body.name for body in child.bodies}
    own = link.removeprefix(part.prefix)
    pose = {"pos": T_parent_link.translation, "quat": T_parent_link.quat_wxyz}
    if own in names:
        body = child.body(own)
        # The body's own pose relative to its parent is part of T_parent_link.
        body.pos, body.quat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        body.alt.type = 0
        for joint in list(body.joints):
            child.delete(joint)
        parent.add_frame(**pose).attach_body(body, part.prefix, "")
        return {name: spec.body(name) for name in model.subtree(link) if name in part.links}
    root = parent.add_body(name=link, **pose)  # the frame of the MJCF's world
    spec.attach(child, prefix=part.prefix, frame=root.add_frame())
    return {name: root if name == link else spec.body(name) for name in part.links if name in model.links}
