"""SRDF documents as immutable values that can be read and written without loss."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lxml import etree

from armcell.core import InputError
from armcell.model.robot import RobotModel
from armcell.model.setup.urdf_text import xml_text
from armcell.model.untrusted_files import parse_xml

Attributes = tuple[tuple[str, str], ...]


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
            joints = (element("joint", name=j, value=f"{v:.6g}") for j, v in values.items())
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
