"""Couplings and limits of finger joints that the robot's description lacks.

If one joint follows another, a URDF gets a <mimic> element, and an MJCF file an <equality>.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from lxml import etree

from armcell.core import InputError, UnknownNameError
from armcell.model.robot import Mimic, RobotModel
from armcell.model.setup.hand_geometry import HandGeometry
from armcell.model.untrusted_files import parse_xml
from armcell.model.urdf_writer import NOWHERE, xml_text

STEP = 0.01  # fraction of the driven joint's range over which the jaws' motion is measured
TOWARD = 0.1  # minimum share of a jaw's motion along the line between the jaws
STIFF = {"solref": "0.005 1", "solimp": "0.95 0.99 0.001"}  # as in Menagerie's 2F-85; the default is soft


def with_follower_text(text: str, model: RobotModel, drive: str, follower: str) -> str:
    """Return URDF text in which a joint of a gripper follows the driven joint, so that the jaws move toward
    each other.

    Args:
        text: URDF text of the model.
        drive: name of the driven joint.
        follower: name of the joint that follows it.
    Raises:
        UnknownNameError, InputError: as `multiplier_of`.
    """
    multiplier = multiplier_of(model, drive, follower)
    root = parse_xml(text, NOWHERE)
    etree.SubElement(_joint(root, follower), "mimic", joint=drive, multiplier=f"{multiplier:g}")
    limits, own = model.joints[drive].limits, model.joints[follower].limits
    if own.lower == own.upper:
        _set_limits(root, follower, *sorted(multiplier * q for q in (limits.lower, limits.upper)))
    return xml_text(root)


def with_limits_text(text: str, joint: str, lower: float, upper: float) -> str:
    """Return URDF text in which a joint has the given limits [rad or m], such as a finger's joint whose
    limits in the file are both 0.

    Raises:
        UnknownNameError: the joint does not exist.
    """
    root = parse_xml(text, NOWHERE)
    names = [str(e.get("name")) for e in root.iterfind("joint")]
    if joint not in names:
        raise UnknownNameError("joint", joint, names)
    _set_limits(root, joint, lower, upper)
    return xml_text(root)


def _joint(root: etree._Element, name: str) -> etree._Element:
    return next(e for e in root.iterfind("joint") if e.get("name") == name)


def _set_limits(root: etree._Element, joint: str, lower: float, upper: float) -> None:
    element = _joint(root, joint)
    limit = element.find("limit")
    if limit is None:
        limit = etree.SubElement(element, "limit", effort="0", velocity="0")
    limit.set("lower", f"{lower:g}")
    limit.set("upper", f"{upper:g}")


def with_follower_equality(text: str, model: RobotModel, drive: str, follower: str) -> str:
    """Return MJCF text in which a joint of a gripper follows the driven joint. See `with_follower_text`.

    MuJoCo couples the motions of both joints from their positions in the file (`ref`).
    """
    multiplier = multiplier_of(model, drive, follower)
    root = parse_xml(text, NOWHERE)
    names = {"joint1": follower, "joint2": drive, "polycoef": f"0 {multiplier:g} 0 0 0"}
    etree.SubElement(etree.SubElement(root, "equality"), "joint", {**names, **STIFF})
    return etree.tostring(root, encoding="unicode")


def multiplier_of(model: RobotModel, drive: str, follower: str) -> float:
    """Return the multiplier, 1 or -1, with which a joint of a gripper must follow the driven joint, so
    that the jaws move toward each other.

    The motion of both jaws in the middle of the driven joint's range decides.

    Raises:
        UnknownNameError: a name is not a driven joint.
        InputError: one joint rotates and the other one slides, or the joints do not move two separate jaws
            along the line between the jaws.
    """
    for name in (drive, follower):
        if name not in model.joint_names:
            raise UnknownNameError("driven joint", name, model.joint_names)
    if drive == follower:
        raise InputError(f"follower: joint {follower} cannot follow itself")
    children = [model.joints[name].child for name in (drive, follower)]
    for upper, lower in ((0, 1), (1, 0)):
        if children[lower] in model.subtree(children[upper]):
            names = (drive, follower)
            reason = f"follower: joint {names[upper]} also moves the link that {names[lower]} moves"
            raise InputError(reason, hint="name two joints that move separate jaws")
    kinds = ["slides" if model.joints[name].type == "prismatic" else "rotates" for name in (drive, follower)]
    if kinds[0] != kinds[1]:
        reason = f"{follower} cannot follow {drive}: {drive} {kinds[0]}, and joint {follower} {kinds[1]}"
        hint = "add a <mimic> element (URDF) or an <equality> (MJCF) to the robot's description"
        raise InputError(f"follower: {reason}", hint=hint)
    return _multiplier(model, drive, follower)


def _multiplier(model: RobotModel, drive: str, follower: str) -> float:
    driver = model.joints[drive]
    joint = replace(model.joints[follower], mimic=Mimic(drive))
    hand = HandGeometry(replace(model, joints={**model.joints, follower: joint}), driver)
    middle, span = (
        (driver.limits.lower + driver.limits.upper) / 2, driver.limits.upper - driver.limits.lower
    )  # fmt: skip
    if not np.isfinite(span) or span <= 0:
        text = f"follower: joint {drive} has the range {driver.limits.lower:g} to {driver.limits.upper:g}"
        raise InputError(text, hint="pass range=LOWER,UPPER with the limits of the driven joint")
    jaws = [tuple(model.subtree(model.joints[name].child)) for name in (drive, follower)]
    before, after = ([hand.at(links, middle + sign * STEP * span) for links in jaws] for sign in (-1.0, 1.0))
    if not all(len(points) for points in before):
        text = f"follower: a jaw that {drive} or {follower} moves has no collision shapes"
        raise InputError(text, hint="add collision shapes to the jaws' links in the robot's description")
    line = before[1].mean(0) - before[0].mean(0)
    along = []
    for name, a, b in zip((drive, follower), before, after, strict=True):
        motion = (b - a).mean(0)
        along.append(float(motion @ line))
        if abs(along[-1]) < TOWARD * np.linalg.norm(motion) * np.linalg.norm(line) or not motion.any():
            text = f"follower: joint {name} does not move its jaw along the line between the jaws"
            raise InputError(text, hint="name the two joints that close the gripper")
    return 1.0 if along[0] * along[1] < 0 else -1.0
