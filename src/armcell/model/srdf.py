"""SRDF reader: adds groups, end effectors, named states and disabled collision pairs."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from pathlib import Path

from lxml import etree

from armcell.core import InputError, UnknownNameError
from armcell.model.robot import EndEffector, Group, JointLimits, RobotModel
from armcell.model.untrusted_files import parse_xml, read_text

logger = logging.getLogger(__name__)


def with_srdf(model: RobotModel, path: Path) -> RobotModel:
    """Add the groups, end effectors, states and collision pairs of an SRDF file to a robot.

    Raises:
        InputError: invalid XML, or a name that the URDF does not define (with file and line).
    """
    return with_srdf_text(model, read_text(Path(path)), Path(path))


def with_srdf_text(model: RobotModel, text: str, path: Path) -> RobotModel:
    """Add the groups, end effectors, states and collision pairs of an SRDF text to a robot.

    Args:
        model: the robot from the URDF.
        text: the SRDF.
        path: file name for error messages.
    Raises:
        InputError: invalid XML, or a name that the URDF does not define (with file and line).
    """
    root = parse_xml(text, path)
    if root.tag != "robot":
        raise InputError("root element is not <robot>", file=path, hint="is this an SRDF file?")
    groups = _groups(model, root, path)
    return replace(
        model,
        groups=groups,
        end_effectors=_end_effectors(model, groups, root, path),
        named_states=_named_states(model, groups, root, path),
        disabled_collisions=_disabled(model, root, path),
    )


def _get(element: etree._Element, name: str, path: Path) -> str:
    value = element.get(name)
    if not value:
        raise InputError(
            f"attribute {name!r} is missing", file=path, line=element.sourceline, element=f"<{element.tag}>"
        )
    return value


def _groups(model: RobotModel, root: etree._Element, path: Path) -> dict[str, Group]:
    elements = {_get(e, "name", path): e for e in root.findall("group")}
    groups: dict[str, Group] = {}

    def build(name: str, trail: tuple[str, ...]) -> Group:
        if name in groups:
            return groups[name]
        element = elements[name]
        where = {"file": path, "line": element.sourceline, "element": f"<group name={name!r}>"}
        if name in trail:
            raise InputError(f"contains itself ({' -> '.join((*trail, name))})", **where)
        joints: set[str] = set()
        links: set[str] = set()
        base = tip = None
        for part in element:
            if part.tag == "joint":
                joint = _get(part, "name", path)
                if joint not in model.joints:
                    raise UnknownNameError("joint", joint, model.joints, **where)
                joints.add(joint)
                links.add(model.joints[joint].child)
            elif part.tag == "link":
                link = _get(part, "name", path)
                if link not in model.links:
                    raise UnknownNameError("link", link, model.links, **where)
                links.add(link)
                if link in model.parent_joint:
                    joints.add(model.parent_joint[link].name)
            elif part.tag == "chain":
                base, tip = _get(part, "base_link", path), _get(part, "tip_link", path)
                for link in (base, tip):
                    if link not in model.links:
                        raise UnknownNameError("link", link, model.links, **where)
                try:
                    chain = model.chain(base, tip)
                except InputError as error:
                    raise InputError(error.reason, **where) from None
                joints.update(j.name for j in chain)
                links.update(j.child for j in chain)
            elif part.tag == "group":
                sub = _get(part, "name", path)
                if sub not in elements:
                    raise UnknownNameError("group", sub, elements, **where)
                inner = build(sub, (*trail, name))
                joints.update(inner.joint_names)
                links.update(inner.link_names)
        actuated = tuple(n for n in model.joint_names if n in joints)
        if not actuated and not links:
            raise InputError("is empty", **where)
        groups[name] = Group(name, actuated, tuple(n for n in model.links if n in links), base, tip)
        return groups[name]

    for name in elements:
        build(name, ())
    return groups


def _end_effectors(
    model: RobotModel, groups: dict[str, Group], root: etree._Element, path: Path
) -> dict[str, EndEffector]:
    found = {}
    for e in root.findall("end_effector"):
        name, group, link = _get(e, "name", path), _get(e, "group", path), _get(e, "parent_link", path)
        where = {"file": path, "line": e.sourceline, "element": f"<end_effector name={name!r}>"}
        for named in (group, e.get("parent_group")):
            if named and named not in groups:
                raise UnknownNameError("group", named, groups, **where)
        if link not in model.links:
            raise UnknownNameError("link", link, model.links, **where)
        found[name] = EndEffector(name, group, link, e.get("parent_group"))
    return found


def _named_states(
    model: RobotModel, groups: dict[str, Group], root: etree._Element, path: Path
) -> dict[str, dict[str, dict[str, float]]]:
    states: dict[str, dict[str, dict[str, float]]] = {}
    for element in root.findall("group_state"):
        name, group = _get(element, "name", path), _get(element, "group", path)
        where = {"file": path, "line": element.sourceline, "element": f"<group_state name={name!r}>"}
        values: dict[str, float] = {}
        for part in element.findall("joint"):
            joint = _get(part, "name", path)
            if joint not in model.joints:
                raise UnknownNameError("joint", joint, model.joints, **where)
            try:
                values[joint] = float(_get(part, "value", path))
            except ValueError:
                raise InputError(f"value of joint {joint!r} is not a number", **where) from None
            if not math.isfinite(values[joint]):
                raise InputError(f"value of joint {joint!r} is not finite", **where)
        if group not in groups:
            raise UnknownNameError("group", group, groups, **where)
        beyond = [j for j, v in values.items() if not _within(model.joints[j].limits, v)]
        if beyond:  # like MoveIt: warn and skip the state
            logger.warning(
                "%s:%s: named state %r puts %s out of limits", path, element.sourceline, name, beyond[0]
            )
            continue
        values = {joint: v for joint, v in values.items() if model.joints[joint].actuated}
        states.setdefault(group, {})[name] = values
    return states


def _within(limits: JointLimits, value: float) -> bool:
    return limits.lower - 1e-3 <= value <= limits.upper + 1e-3


def _disabled(model: RobotModel, root: etree._Element, path: Path) -> dict[frozenset[str], str]:
    pairs: dict[frozenset[str], str] = {}
    unknown: dict[str, int] = {}  # unknown link -> line of its first use
    for element in root.findall("disable_collisions"):
        ends = _get(element, "link1", path), _get(element, "link2", path)
        gone = [link for link in ends if link not in model.links]
        for link in gone:
            unknown.setdefault(link, element.sourceline or 0)
        if not gone:
            pairs[frozenset(ends)] = element.get("reason", "")
    if unknown:  # only a warning, like MoveIt: many SRDFs are written for a larger robot
        names = ", ".join(map(repr, sorted(unknown)))
        first = min(unknown.values())
        logger.warning("%s:%s: disable_collisions names unknown links, passed over: %s", path, first, names)
    return pairs
