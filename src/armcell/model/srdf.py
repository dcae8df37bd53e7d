"""SRDF reader and writer: planning groups and their composites, end effectors, states, disabled pairs.

Composite groups (groups of groups) and extra named states come from robot.yaml. SRDF documents are
immutable values that can be read and written without loss.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lxml import etree

from armcell.core import InputError, UnknownNameError
from armcell.model.robot import EndEffector, Group, JointLimits, RobotModel
from armcell.model.untrusted_files import parse_xml, read_text
from armcell.model.urdf_writer import xml_text

logger = logging.getLogger(__name__)
Attributes = tuple[tuple[str, str], ...]


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


def with_composite_groups(model: RobotModel, groups: Any, states: Any, file: Path) -> RobotModel:
    """Return the robot with the composite planning groups and named states that robot.yaml defines, in
    addition to those of the SRDF.

    If all members of a composite group have a named state of the same name, the composite group gets that
    state, too.

    Args:
        groups: member groups by composite group: `{name: [group, ...]}`, or None.
        states: joint positions [rad or m]: `{group: {state: {joint: position}}}`, or None.
        file: the robot.yaml, for error messages.
    Raises:
        InputError: invalid structure, a joint in two member groups, or a position outside the joint's limits.
        UnknownNameError: the robot does not have a group or joint of that name.
    """
    model = _with_states(model, states or {}, file)
    return _with_groups(model, groups or {}, file)


def _with_states(model: RobotModel, states: Any, file: Path) -> RobotModel:
    named = {group: dict(of) for group, of in model.named_states.items()}
    for group, given in _mapping(states, file, "states").items():
        where = f"states/{group}"
        if group not in model.groups:
            raise UnknownNameError("planning group", group, model.groups, file=file, element=where)
        for name, values in _mapping(given, file, where).items():
            values = _mapping(values, file, f"{where}/{name}")
            for joint, value in values.items():
                if joint not in model.groups[group].joint_names:
                    known = model.groups[group].joint_names
                    raise UnknownNameError("joint", joint, known, file=file, element=f"{where}/{name}")
                if isinstance(value, bool) or not isinstance(value, int | float):
                    raise InputError(f"{value!r} is not a number", file=file, element=f"{where}/{name}")
            try:
                model.check_positions(list(values.values()), list(values))
            except InputError as error:
                raise InputError(error.reason, file=file, element=f"{where}/{name}") from None
            named.setdefault(group, {})[name] = {joint: float(v) for joint, v in values.items()}
    return replace(model, named_states=named)


def _with_groups(model: RobotModel, groups: Any, file: Path) -> RobotModel:
    known = dict(model.groups)
    named = {group: dict(of) for group, of in model.named_states.items()}
    for name, members in _mapping(groups, file, "groups").items():
        where = {"file": file, "element": f"groups/{name}"}
        if name in known:
            raise InputError("the robot has a group of that name already", **where)
        if not isinstance(members, list) or not members:
            raise InputError("is not a list of groups", **where)
        for member in members:
            if member not in known:
                raise UnknownNameError("planning group", str(member), known, **where)
        joints = [j for member in members for j in known[member].joint_names]
        links = {link for member in members for link in known[member].link_names}
        if len(set(joints)) != len(joints):
            twice = next(j for j in joints if joints.count(j) > 1)
            raise InputError(f"joint {twice!r} is in two of its groups", **where)
        known[name] = Group(
            name,
            tuple(n for n in model.joint_names if n in joints),
            tuple(n for n in model.links if n in links),
        )
        common = set.intersection(*(set(named.get(member, {})) for member in members))
        named[name] = {s: {j: v for m in members for j, v in named[m][s].items()} for s in sorted(common)}
    return replace(model, groups=known, named_states=named)


def _mapping(value: Any, file: Path, element: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError("is not a mapping", file=file, element=element)
    return value


@dataclass(frozen=True)
class Element:
    """One element of a robot's SRDF: its tag, attributes (in the
    order of the file), child elements and text.
    """

    tag: str
    attributes: Attributes = ()
    inside: tuple[Element, ...] = ()
    text: str = ""

    def get(self, name: str, default: str = "") -> str:
        return dict(self.attributes).get(name, default)

    def all(self, tag: str) -> tuple[Element, ...]:
        return tuple(e for e in self.inside if e.tag == tag)


def element(tag: str, *inside: Element, **attributes: str) -> Element:
    return Element(tag, tuple(attributes.items()), inside)


def parse_srdf(text: str, file: Path) -> Element:
    """Parse SRDF text and return the <robot> element. An SRDF describes a robot's semantics.

    Raises:
        InputError: invalid XML, or the root element is not <robot>.
    """
    root = parse_xml(text, file)
    if root.tag != "robot":
        raise InputError("root element is not <robot>", file=file, hint="is this an SRDF file?")
    return _value(root)


def _value(node: etree._Element) -> Element:
    inside = tuple(_value(child) for child in node if isinstance(child.tag, str))
    pairs = tuple((str(k), str(v)) for k, v in node.attrib.items())
    return Element(str(node.tag), pairs, inside, (node.text or "").strip())


def srdf_text(robot: Element) -> str:
    """Convert the <robot> element of an SRDF to text. An SRDF describes a robot's semantics."""
    return xml_text(_node(robot))


def _node(value: Element) -> etree._Element:
    node = etree.Element(value.tag)
    for name, text in value.attributes:
        node.set(name, text)
    node.text = value.text or None
    node.extend([_node(inside) for inside in value.inside])
    return node


def srdf_of(model: RobotModel) -> Element:
    """Return the semantics of a robot model as an SRDF: groups, end effectors, named states and disabled
    collision pairs.

    - A group with a base and a tip link becomes a chain.
    - A group such as "both_arms" becomes a list of subgroups if the subgroups have the same joints.
    - Every mimic joint becomes a passive joint.
    - A robot whose root link is not "world" gets a fixed virtual joint to the frame "world".
    """
    parts: list[Element] = []
    for group in model.groups.values():
        parts.append(element("group", *_members(model, group.name), name=group.name))
    for group, states in model.named_states.items():
        for name, values in states.items():
            joints = (element("joint", name=j, value=f"{v:.9g}") for j, v in values.items())
            parts.append(element("group_state", *joints, name=name, group=group))
    for end in model.end_effectors.values():
        extra = {"parent_group": end.parent_group} if end.parent_group else {}
        parts.append(
            element("end_effector", name=end.name, parent_link=end.parent_link, group=end.group, **extra)
        )
    if model.root_link != "world":
        parts.append(
            element(
                "virtual_joint", name="virtual_joint", type="fixed", parent_frame="world",
                child_link=model.root_link,
            )
        )  # fmt: skip
    parts += [element("passive_joint", name=j.name) for j in model.joints.values() if j.mimic]
    order = {name: i for i, name in enumerate(model.links)}
    pairs = {
        tuple(sorted(pair, key=order.__getitem__)): why for pair, why in model.disabled_collisions.items()
    }
    for a, b in sorted(pairs, key=lambda p: (order[p[0]], order[p[1]])):
        parts.append(element("disable_collisions", link1=a, link2=b, reason=pairs[a, b]))
    return element("robot", *parts, name=model.name)


def _members(model: RobotModel, name: str) -> list[Element]:
    group = model.groups[name]
    if group.base_link and group.tip_link:
        return [element("chain", base_link=group.base_link, tip_link=group.tip_link)]
    smaller = [
        g
        for g in model.groups.values()
        if g.name != name and g.joint_names and set(g.joint_names) < set(group.joint_names)
    ]
    if len(smaller) > 1 and {j for g in smaller for j in g.joint_names} == set(group.joint_names):
        return [element("group", name=g.name) for g in smaller]
    links = [element("link", name=link) for link in group.link_names]
    # In SRDF a link includes its parent joint. Only joints without their child link need an element.
    brought = {model.parent_joint[n].name for n in group.link_names if n in model.parent_joint}
    return links + [element("joint", name=j) for j in group.joint_names if j not in brought]
