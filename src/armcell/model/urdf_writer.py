"""URDF text of a robot model, for programs that read URDF."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from lxml import etree

from armcell.core import SE3, Format, Shape, shape_kind, shape_name
from armcell.model.robot import Joint, Link, RobotModel


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
