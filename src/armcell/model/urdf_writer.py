"""URDF text: of a robot model, and of several URDF files merged with prefixes and resolvable mesh paths.

Apart from simulator and driver elements of prefixed robots, a merged file contains every element.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from armcell.core import SE3, Format, InputError, Shape, shape_kind, shape_name
from armcell.model.assets import resolve_uri
from armcell.model.robot import Joint, Link, RobotModel
from armcell.model.untrusted_files import parse_xml
from armcell.model.urdf import urdf_text

NOWHERE = Path("/")
"""A search folder without robot descriptions, so that only installed packages are found."""


def urdf_of(model: RobotModel) -> str:
    """Return URDF text for a robot model: its links with visuals and inertia, and its joints with limits.

    Mesh paths refer to files on this machine. Collision geometry is limited to boxes, cylinders and spheres;
    collision meshes are omitted, because armcell does the planning.
    """
    robot = etree.Element("robot", name=model.name)
    for link in model.links.values():
        _link(robot, link)
    for joint in model.joints.values():
        _joint(robot, joint)
    etree.indent(robot)
    return etree.tostring(robot, encoding="unicode")


def _link(robot: Any, link: Link) -> None:
    element = etree.SubElement(robot, "link", name=link.name)
    if link.inertial is not None and link.inertial.mass > 0:
        inertial = etree.SubElement(element, "inertial")
        _origin(inertial, link.inertial.T_link_com)
        etree.SubElement(inertial, "mass", value=_number(link.inertial.mass))
        I = link.inertial.inertia
        values = {
            "ixx": I[0, 0],
            "ixy": I[0, 1],
            "ixz": I[0, 2],
            "iyy": I[1, 1],
            "iyz": I[1, 2],
            "izz": I[2, 2],
        }
        etree.SubElement(inertial, "inertia", {k: _number(v) for k, v in values.items()})
    for visual in link.visuals:
        shown = etree.SubElement(element, "visual")
        _origin(shown, visual.T_link_visual)
        geometry = etree.SubElement(shown, "geometry")
        if visual.shape is not None:
            _shape(geometry, visual.shape)
        elif visual.file is not None:
            uri = visual.file.resolve().as_uri()
            etree.SubElement(geometry, "mesh", filename=uri, scale=_numbers(visual.scale))
        if not len(geometry):
            element.remove(shown)
    for collision in link.collisions:
        if shape_kind(collision.shape, Format.URDF) is not None:
            solid = etree.SubElement(element, "collision")
            _origin(solid, collision.T_link_shape)
            _shape(etree.SubElement(solid, "geometry"), collision.shape)


def _shape(geometry: Any, shape: Shape) -> None:
    if (kind := shape_kind(shape, Format.URDF)) is not None:
        sizes = {key: _numbers(np.atleast_1d(value)) for key, value in kind.named(shape).items()}
        etree.SubElement(geometry, shape_name(shape), **sizes)


def _joint(robot: Any, joint: Joint) -> None:
    element = etree.SubElement(robot, "joint", name=joint.name, type=joint.type)
    _origin(element, joint.T_parent_joint)
    etree.SubElement(element, "parent", link=joint.parent)
    etree.SubElement(element, "child", link=joint.child)
    if not joint.movable:
        return
    etree.SubElement(element, "axis", xyz=_numbers(joint.axis))
    limits = joint.limits
    values = {"velocity": limits.velocity, "effort": limits.effort}
    if joint.type != "continuous":
        values |= {"lower": limits.lower, "upper": limits.upper}
    finite = {k: _number(v if np.isfinite(v) else np.copysign(1e9, v)) for k, v in values.items()}
    etree.SubElement(element, "limit", finite)
    if joint.mimic is not None:
        etree.SubElement(
            element, "mimic", joint=joint.mimic.joint, multiplier=_number(joint.mimic.multiplier),
            offset=_number(joint.mimic.offset),
        )  # fmt: skip


def _origin(element: Any, T: SE3) -> None:
    etree.SubElement(element, "origin", xyz=_numbers(T.translation), rpy=_numbers(T.rotation.rpy))


def _number(value: float) -> str:
    return f"{float(value):.9g}"


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(v) for v in values)


@dataclass(frozen=True)
class UrdfPart:
    """One of several URDF or xacro files to be merged as text, with a name prefix and the pose of its root
    link in the world.
    """

    file: Path
    prefix: str = ""
    xyz: tuple[float, float, float] | None = None  # [m]
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


def merged_urdf(
    parts: Sequence[UrdfPart], name: str | None = None, allow_env: bool | None = None
) -> tuple[str, str]:
    """Merge several URDF or xacro files into one URDF text. Return the name of the robot and the text.

    A fixed joint connects each robot to the link "world". A single robot without a pose stays unmounted.

    Args:
        parts: the files, with prefixes and poses.
        name: name of the merged robot; by default a combination of the robots' names.
        allow_env: whether xacro files may read environment variables, see `expand_xacro`.
    Raises:
        InputError: a file is not readable, or two parts have the same names.
    """
    if len({part.prefix for part in parts}) < len(parts):
        raise InputError(
            f"{len(parts)} robots, but the prefixes {', '.join(repr(p.prefix) for p in parts)} are not all "
            "different",
            hint="give each robot its own: --prefix left_ --prefix right_",
        )
    roots = [_read(part.file, allow_env) for part in parts]
    own = "_and_".join(dict.fromkeys(root.get("name") or part.file.stem for root, part in zip(roots, parts)))
    whole = etree.Element("robot", name=name or (own if len(parts) == 1 else f"dual_{own}"))
    placed = len(parts) > 1 or any(part.xyz is not None for part in parts)
    if placed:
        whole.append(etree.Element("link", name="world"))
    for root, part in zip(roots, parts):
        find_meshes(root, part.file.resolve().parent)
        base = part.prefix + _root_link(root, part.file)
        if part.prefix:
            _prefix(root, part.prefix)
        taken = _names(whole) & _names(root)
        if taken:
            raise InputError(
                f"{part.file.name} brings {sorted(taken)[0]!r}, which is there already",
                file=part.file,
                hint="give each robot its own --prefix",
            )
        whole.extend([deepcopy(child) for child in root])
        if placed:
            whole.append(_mount(base, part))
    return str(whole.get("name")), xml_text(whole)


def with_frames_text(text: str, model: RobotModel) -> str:
    """Write URDF text with all frames that robot setup has added. Each frame is a link with a fixed joint."""
    missing = [j for j in model.frames.values() if f'<link name="{j.child}"' not in text]
    if not missing:
        return text
    root = parse_xml(text, NOWHERE)
    for joint in missing:
        etree.SubElement(root, "link", name=joint.child)
        element = etree.SubElement(root, "joint", name=joint.name, type="fixed")
        etree.SubElement(element, "parent", link=joint.parent)
        etree.SubElement(element, "child", link=joint.child)
        T = joint.T_parent_joint
        xyz, rpy = (" ".join(f"{v:.9g}" for v in values) for values in (T.translation, T.rotation.rpy))
        etree.SubElement(element, "origin", xyz=xyz, rpy=rpy)
    return xml_text(root)


def xml_text(root: etree._Element) -> str:
    """Return the text that is written for a URDF: indented, with one element per line."""
    etree.indent(root, "  ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + etree.tostring(root, encoding="unicode") + "\n"


def _read(file: Path, allow_env: bool | None) -> etree._Element:
    root = parse_xml(urdf_text(file, allow_env), file)
    if root.tag != "robot":
        raise InputError("root element is not <robot>", file=file, hint="is this a URDF file?")
    return root


def _root_link(root: etree._Element, file: Path) -> str:
    children = {c.get("link") for c in root.iterfind("joint/child")}
    roots = [link.get("name") for link in root.iterfind("link") if link.get("name") not in children]
    if len(roots) != 1:
        raise InputError(f"has {len(roots)} root links, exactly one is needed", file=file)
    return str(roots[0])


def _names(root: etree._Element) -> set[str]:
    return {f"{e.tag} {e.get('name')}" for e in root if e.tag in ("link", "joint")}


def _prefix(root: etree._Element, prefix: str) -> None:
    """Prepare a URDF to be written as part of a merged one: put a prefix before every name, and remove
    elements for simulators and drivers.

    The removed elements are `gazebo`, `transmission` and `ros2_control`.
    """
    for tag in ("gazebo", "transmission", "ros2_control"):
        for found in root.findall(tag):
            root.remove(found)
    for tag in ("link", "joint", "material"):
        for found in root.iter(tag):
            if found.get("name"):
                found.set("name", prefix + found.get("name"))
    for path, attribute in (("joint/parent", "link"), ("joint/child", "link"), ("joint/mimic", "joint")):
        for found in root.iterfind(path):
            found.set(attribute, prefix + str(found.get(attribute)))


def find_meshes(root: etree._Element, folder: Path) -> None:
    """Prepare a URDF to be written as part of a merged one: make mesh paths absolute if they are relative to
    the folder of the URDF.

    A merged URDF is stored in another folder, where relative paths would not work. `package://` URIs of
    installed packages stay unchanged.

    Args:
        root: the URDF's <robot> element, which is modified.
        folder: folder of the original URDF.
    """
    for mesh in (*root.iter("mesh"), *root.iter("texture")):
        uri = mesh.get("filename") or ""
        try:
            if uri.startswith("package://"):
                resolve_uri(uri, NOWHERE)
                continue
        except InputError:
            pass
        try:
            mesh.set("filename", resolve_uri(uri, folder).resolve().as_uri())
        except InputError:
            continue  # loading reports it later: a missing visual mesh warns, a missing collision mesh fails


def _mount(base: str, part: UrdfPart) -> etree._Element:
    joint = etree.Element("joint", name=f"world_to_{base}", type="fixed")
    joint.append(etree.Element("parent", link="world"))
    joint.append(etree.Element("child", link=base))
    xyz = " ".join(f"{v:g}" for v in part.xyz or (0.0, 0.0, 0.0))
    rpy = " ".join(f"{radians(v):.9g}" for v in part.rpy_deg)
    joint.append(etree.Element("origin", xyz=xyz, rpy=rpy))
    return joint
