"""Recognition of grippers with jaws or cups: derives robot.yaml's gripper parameters from joints and meshes.

The jaws may slide, move on a coupled linkage (Robotiq, xArm), or be one moving and one fixed jaw. The closing
direction follows from the jaws' motion, the pads from the surfaces that face each other when the gripper is
closed, and the opening from the pads' distance at every position of the driven joint. Links that are named
like suction cups become a suction gripper only if the user states it (`cups.py`).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armcell.core import InputError, UnknownNameError
from armcell.model.composition import with_tip
from armcell.model.robot import EndEffector, Joint, RobotModel
from armcell.model.setup.arm_detection import cup_links
from armcell.model.setup.cups import with_suction_gripper
from armcell.model.setup.hand_geometry import GripperNotRecognizedError, HandGeometry
from armcell.model.setup.jaws import find_jaws
from armcell.model.setup.pads import with_measured_gripper

logger = logging.getLogger(__name__)

KEYS = ("end", "drive", "follower", "range", "fingers", "tcp", "closes", "cups")
SUCTION = "suction"
NO_RANGE = 1e-6  # [rad or m] a joint with a smaller range cannot move
RANGE = "correct the limits in the file, or pass --gripper with drive=JOINT range=LOWER,UPPER [rad or m]"
FORMAT = (
    "drive=JOINT follower=JOINT range=LOWER,UPPER fingers=LINK,LINK tcp=LINK closes=lower|upper; "
    "or suction cups=LINK,LINK tcp=LINK"
)


@dataclass(frozen=True)
class GripperSpec:
    """User's specification for gripper detection in robot setup (`--gripper`). Setup detects every property
    that is empty.

    Attributes:
        end: end effector; empty: the only one without a gripper.
        drive: driven joint; empty: the only driven joint of the end effector.
        follower: driven joint that setup couples to `drive`, because the description does not; empty: none.
        range: limits [rad or m] of `drive`, if those in the URDF are wrong; empty: as described.
        fingers: links of the jaws on both sides; empty: recognized.
        tcp: link of the tool center, y in the closing direction, z out of the hand; empty: recognized.
        closes: limit of the driven joint at which the jaws are closed, "lower" or "upper"; empty: recognized.
        suction: whether the gripper holds by suction cups.
        cups: links of the suction cups; empty: the links that are named like cups.
    """

    end: str = ""
    drive: str = ""
    follower: str = ""
    range: tuple[float, ...] = ()
    fingers: tuple[tuple[str, ...], ...] = ()
    tcp: str = ""
    closes: str = ""
    suction: bool = False
    cups: tuple[str, ...] = ()

    @classmethod
    def parse(cls, text: str) -> GripperSpec:
        """Parse the user's specification for gripper detection, such as "drive=JOINT fingers=LINK,LINK
        closes=upper" or "suction".

        Raises:
            InputError: the text does not have this format.
        """
        values: dict[str, str] = {}
        words = text.split()
        for word in words:
            if word == SUCTION:
                continue
            key, equals, value = word.partition("=")
            if key not in KEYS:
                raise UnknownNameError("key of --gripper", key, KEYS)
            if not equals or not value or key in values:
                raise InputError(f"--gripper {text!r}: {word!r} is not KEY=VALUE, once per key", hint=FORMAT)
            values[key] = value
        fingers = tuple(tuple(side.split("+")) for side in values.pop("fingers", "").split(",") if side)
        if fingers and len(fingers) != 2:
            raise InputError(f"--gripper {text!r}: fingers needs two sides, as fingers=LEFT,RIGHT or A,B+C")
        if values.get("closes", "lower") not in ("lower", "upper"):
            raise InputError(
                f"--gripper {text!r}: closes is 'lower' or 'upper', the limit of the driven joint"
            )
        cups = tuple(filter(None, values.pop("cups", "").split(",")))
        suction = bool(cups) or SUCTION in words
        if "follower" in values and "drive" not in values:
            raise InputError(f"--gripper {text!r}: follower needs drive=JOINT, the joint that it follows")
        limits = _limits(text, values.pop("range")) if "range" in values else ()
        if limits and "drive" not in values:
            raise InputError(f"--gripper {text!r}: range needs drive=JOINT, the joint that has these limits")
        if suction and (
            wrong := sorted({"drive", "follower", "closes"} & set(values)) + ["fingers"] * bool(fingers)
        ):
            raise InputError(f"--gripper {text!r}: a suction gripper has no {', '.join(wrong)}", hint=FORMAT)
        return cls(fingers=fingers, suction=suction, cups=cups, range=limits, **values)


def _limits(text: str, value: str) -> tuple[float, float]:
    """Parse the driven joint's limits in the user's specification for gripper detection, as "LOWER,UPPER"
    [rad or m].
    """
    try:
        lower, upper = (float(word) for word in value.split(","))
    except ValueError:
        lower = upper = np.nan
    if not (np.isfinite([lower, upper]).all() and lower < upper):
        raise InputError(
            f"--gripper {text!r}: range={value} does not have the form LOWER,UPPER with LOWER < UPPER"
        )
    return lower, upper


def find_grippers(model: RobotModel, tips: bool = False, stated: Sequence[GripperSpec] = ()) -> RobotModel:
    """Detect the grippers of a robot, and return the robot with them. An end effector with two jaws and one
    driven joint gets a `Gripper`. If the user specifies suction for an end effector, it gets a
    `SuctionGripper`.

    If no frame of the robot is at the center of the pads or cups, the robot gets a link `<end effector>_tcp`
    there. Log messages state why an end effector has no gripper.

    Args:
        tips: whether the tool center becomes the tip of the arm's group.
        stated: facts about grippers; a gripper that the model already has is recognized again.
    Raises:
        InputError: a stated gripper does not exist, or the meshes contradict it.
    """
    facts = _by_end(model, stated)
    for end in model.end_effectors.values():
        if (end.name in model.grippers and end.name not in facts) or end.parent_group is None:
            continue
        try:
            model = _with_gripper(model, end, facts.get(end.name, GripperSpec()))
            gripper = model.grippers[end.name]
            if tips and model.groups[gripper.arm_group].tip_link != gripper.tcp_link:
                model = with_tip(model, gripper.arm_group, gripper.tcp_link)
        except GripperNotRecognizedError as reason:
            if end.name in facts:
                raise InputError(f"end effector {end.name}: {reason}", hint=reason.hint) from None
            logger.warning("end effector %s: no gripper found: %s", end.name, reason)
    return model


def reasons(model: RobotModel) -> dict[str, str]:
    """Return why gripper detection failed, with a hint, for each end effector that has no gripper, by
    name.
    """
    found = {}
    for end in model.end_effectors.values():
        if end.name not in model.grippers:
            try:
                _with_gripper(model, end, GripperSpec())
            except GripperNotRecognizedError as reason:
                found[end.name] = f"{reason}; {reason.hint}" if reason.hint else str(reason)
    return found


def _by_end(model: RobotModel, stated: Sequence[GripperSpec]) -> dict[str, GripperSpec]:
    """Return the user's specifications for gripper detection as a dictionary with the names of end effectors
    as keys.

    Raises:
        InputError: an end effector does not exist, is stated twice, or is missing although there are several.
    """
    facts: dict[str, GripperSpec] = {}
    for fact in stated:
        name = fact.end or _only_end(model)
        if name not in model.end_effectors:
            raise UnknownNameError("end effector", name, model.end_effectors)
        if name in facts:
            raise InputError(
                f"end effector {name!r} is stated twice", hint="give --gripper once per end effector"
            )
        facts[name] = fact
        for link in (fact.tcp, *fact.cups, *(link for side in fact.fingers for link in side)):
            if link:
                model.link(link)
    return facts


def _only_end(model: RobotModel) -> str:
    if len(model.end_effectors) == 1:
        return next(iter(model.end_effectors))
    if not model.end_effectors:
        raise InputError(
            "the robot has no end effector: no joints branch off behind the arm, and no link is named like a "
            "suction cup",
            hint="--gripper drive=JOINT makes the link behind JOINT a jaw, --gripper cups=LINK,LINK makes "
            "links suction cups",
        )
    names = ", ".join(model.end_effectors)
    raise InputError(
        f"the robot has {len(model.end_effectors)} end effectors", hint=f"add end=NAME with one of {names}"
    )


def _with_gripper(model: RobotModel, end: EndEffector, fact: GripperSpec) -> RobotModel:
    if fact.suction:
        return with_suction_gripper(model, end, fact.cups, fact.tcp)
    driven = model.groups[end.group].joint_names
    if not driven and (cups := cup_links(model, model.groups[end.group].link_names)):
        raise GripperNotRecognizedError(
            f"{', '.join(cups)} may be suction cups by name",
            "pass --gripper suction, or --gripper cups=LINK,LINK with the links of the cups",
        )
    if fact.drive and fact.drive not in driven:
        raise GripperNotRecognizedError(
            f"drive: {fact.drive} is not a driven joint of it; those are {', '.join(driven)}"
        )
    if not fact.drive and (stuck := [n for n in driven if _cannot_move(model.joints[n])]):
        raise GripperNotRecognizedError(
            f"joint {', '.join(stuck)} cannot move: lower and upper limit are equal",
            RANGE + (" follower=JOINT, the joint of the other jaw" if len(driven) > 1 else ""),
        )
    if fact.drive or len(driven) == 1:
        return _with_driven(model, end, fact.drive or driven[0], fact)
    found = [with_it for name in driven if (with_it := _moves_both_jaws(model, end, name, fact))]
    if len(found) == 1:
        return found[0]
    names = ", ".join(driven) or "fixed jaws"
    hint = "pass --gripper with drive=JOINT follower=JOINT to couple two joints, or add " + (
        "<equality><joint joint1=FOLLOWER joint2=DRIVE/></equality> to the MJCF file for each joint that "
        "follows another joint"
        if model.mjcf
        else '<mimic joint="..."/> in the URDF to the joints that follow another joint'
    )
    if found:
        names, hint = ", ".join(m.grippers[end.name].joint_name for m in found), "pass --gripper drive=JOINT"
    raise GripperNotRecognizedError(
        f"{len(driven)} driven joints ({names}), but one must move the jaws and the others mimic it",
        hint if driven else "",
    )


def _moves_both_jaws(model: RobotModel, end: EndEffector, name: str, fact: GripperSpec) -> RobotModel | None:
    """Try to detect a gripper with the single driven joint `name`, which moves both jaws. Return the robot
    with this gripper, or None.
    """
    if sum(j.movable and model.coupling(j.name)[0] == name for j in model.joints.values()) < 2:
        return None
    try:
        return _with_driven(model, end, name, fact)
    except GripperNotRecognizedError:
        return None


def _with_driven(model: RobotModel, end: EndEffector, name: str, fact: GripperSpec) -> RobotModel:
    driver = model.joints[name]
    if not (np.isfinite(driver.limits.lower) and np.isfinite(driver.limits.upper)):
        raise GripperNotRecognizedError(f"joint {name} has no position limits")
    if _cannot_move(driver):
        raise GripperNotRecognizedError(f"joint {name} cannot move: lower and upper limit are equal", RANGE)
    hand = HandGeometry(model, driver)
    for link in (link for side in fact.fingers for link in side):
        _check_finger(hand, link)
    return with_measured_gripper(hand, end, find_jaws(hand, fact.fingers, fact.closes), fact.tcp)


def _cannot_move(joint: Joint) -> bool:
    return joint.limits.upper - joint.limits.lower < NO_RANGE


def _check_finger(hand: HandGeometry, link: str) -> None:
    """Check a user-specified finger for gripper detection: the driven joint must move the finger, or the
    finger must be fixed to the palm.

    Raises:
        GripperNotRecognizedError: the finger is elsewhere, or another driven joint moves it.
    """
    if link not in hand.rigid or link not in hand.points:
        raise GripperNotRecognizedError(f"finger {link} is not a link below the palm {hand.palm}")
    others = {hand.model.coupling(j.name)[0] for j in hand.model.chain(hand.palm, link) if j.movable}
    if others - {hand.driver.name}:
        raise GripperNotRecognizedError(
            f"joint {', '.join(sorted(others - {hand.driver.name}))} moves finger {link} by itself, but one "
            f'joint must move both jaws: add <mimic joint="{hand.driver.name}"/> to it in the URDF'
        )
