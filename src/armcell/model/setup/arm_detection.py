"""Detection of arms and grippers in a robot's joint tree, and planning groups for them."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from armcell.core import InputError
from armcell.model.robot import EndEffector, Group, Joint, RobotModel

JAW = re.compile(r"grip|finger|jaw|claw|knuckle|thumb|pincer", re.IGNORECASE)
TOOL = re.compile(r"tcp|tool|grasp|pinch|ee_link|ee_site|end_effector|attachment|gripper$", re.IGNORECASE)
SUCTION = re.compile(r"suction|vacuum|sucker|bellow|(?<![a-z])cups?(?![a-z])", re.IGNORECASE)
CUP = re.compile(r"sucker|bellow|(?<![a-z])cups?(?![a-z])", re.IGNORECASE)
IDLE = {"arm", "joint"}  # words of joint names that do not tell one arm from another
HAND_AFTER = 3  # minimum number of serial joints before a branch counts as fingers


@dataclass(frozen=True)
class ArmChain:
    """A robot arm that was detected as a chain: base link, tip link, actuated joints, and the palm of its
    gripper.

    `palm` is None if the arm carries no gripper.
    """

    base: str
    tip: str
    joints: tuple[str, ...]
    palm: str | None = None


def find_chains(model: RobotModel, jaws: Collection[str] = (), cups: Collection[str] = ()) -> list[ArmChain]:
    """Return the arm chains of a robot: joints in series that end at a leaf link or at the fingers of a
    gripper.

    Joints before a branch that leads to longer chains belong to a torso, not to an arm. Chains with fewer
    than half as many joints as the longest chain (a head, a wheel) are left out.

    Args:
        jaws: names of joints that move jaws, in addition to the joints with typical names.
        cups: names of links that are suction cups, in addition to the links with typical names.
    """
    found: list[ArmChain] = []
    _follow(model, model.root_link, found, jaws, cups)
    longest = max((len(c.joints) for c in found), default=0)
    return [c for c in found if 2 * len(c.joints) >= longest]


def with_groups(
    model: RobotModel,
    prefixes: Sequence[str] = (),
    jaws: Collection[str] = (),
    cups: Collection[str] = (),
) -> RobotModel:
    """Return the robot with planning groups for the arm chains and grippers that were detected.

    A robot with several arms that share no joint also gets a group of all arms: `both_arms` for two,
    `all_arms` for more.

    Args:
        model: the robot.
        prefixes: name prefixes of the robots that `model` is composed of; group names start with them.
        jaws: names of joints that move jaws, in addition to the joints with typical names.
        cups: names of links that are suction cups, in addition to the links with typical names.
    Raises:
        InputError: the robot has no movable joint.
    """
    chains = find_chains(model, jaws, cups)
    if not chains:
        return replace(model, **_only_a_gripper(model))
    groups: dict[str, Group] = {}
    ends: dict[str, EndEffector] = {}
    for chain, (arm, hand) in zip(chains, _names(chains, prefixes), strict=True):
        joints = model.chain(chain.base, chain.tip)
        groups[arm] = Group(arm, chain.joints, tuple(j.child for j in joints), chain.base, chain.tip)
        if chain.palm is None:
            continue
        links = set(model.subtree(chain.palm)) - set(groups[arm].link_names)
        mount = model.parent_joint[chain.palm]
        if not mount.movable:  # otherwise the palm is the arm's last link and belongs to the arm's group
            links.add(chain.palm)
        groups[hand] = _hand(model, hand, links)
        parent = chain.palm if mount.movable else mount.parent
        ends[hand] = EndEffector(hand, hand, parent, arm)
    joints = [n for chain in chains for n in chain.joints]
    if len(chains) > 1 and len(set(joints)) == len(joints):
        name = "both_arms" if len(chains) == 2 else "all_arms"
        arms = [g for g in groups.values() if g.tip_link]
        driven = {n for g in arms for n in g.joint_names}
        moved = {n for g in arms for n in g.link_names}
        groups[name] = Group(
            name,
            tuple(n for n in model.joint_names if n in driven),
            tuple(n for n in model.links if n in moved),
        )
    return replace(model, groups=groups, end_effectors=ends)


def _hand(model: RobotModel, name: str, links: set[str]) -> Group:
    driven = {j.name for j in model.joints.values() if j.actuated and j.child in links}
    return Group(
        name, tuple(n for n in model.joint_names if n in driven), tuple(n for n in model.links if n in links)
    )


def _only_a_gripper(model: RobotModel) -> dict[str, dict[str, Group]]:
    if not model.joint_names:
        raise InputError(
            f"robot {model.name!r} has no joint that moves",
            hint="give a URDF with revolute or prismatic joints",
        )
    return {"groups": {"gripper": _hand(model, "gripper", set(model.links))}}


# --- the tree ---
def _follow(
    model: RobotModel,
    link: str,
    found: list[ArmChain],
    names_of_jaws: Collection[str],
    cups: Collection[str],
) -> None:
    """Detect the arm chains that start at or below a link and append them to `found`."""

    def is_jaw(joint: Joint) -> bool:
        return joint.name in names_of_jaws or bool(JAW.search(joint.name + joint.child))

    starts = _next_movable(model, link)
    drivers = {model.coupling(j.name)[0] for j in starts}
    # Coupled joints with arms below them turn a torso and its cover.
    coupled = len(drivers) == 1 and max(_depth(model, j) for j in starts) <= HAND_AFTER
    if len(starts) > 1 and (all(map(is_jaw, starts)) or coupled):
        return  # fingers without an arm
    for first in starts:
        row, ends = _row(model, first)
        below = [_depth(model, j) for j in ends]
        if ends and not (len(row) >= HAND_AFTER and _are_fingers(below, len(row))):
            _follow(
                model, row[-1].child, found, names_of_jaws, cups
            )  # `row` is a torso: the arms are further down
            continue
        driven, jaws = row, ends
        if ends and len(row) > 1 and {model.coupling(j.name)[0] for j in ends} == {row[-1].name}:
            jaws, driven = [row[-1]], row[:-1]  # a slider that opens the fingers (Stretch)
        if len(driven) > 1 and not ends and is_jaw(driven[-1]):
            jaws, driven = [driven[-1]], driven[:-1]  # gripper with one moving and one fixed jaw
            while len(driven) > 1 and (JAW.search(driven[-1].name) or driven[-1].name in names_of_jaws):
                jaws, driven = [driven[-1]], driven[:-1]
        names = tuple(j.name for j in driven if j.actuated)
        if not names or all(is_jaw(j) for j in driven):
            continue
        last = driven[-1].child
        if jaws:
            palm = common_link(model, [j.parent for j in jaws])
        else:
            palm = _fixed_hand(model, last) or _suction_hand(model, last, cups)
        tip = _tip(model, driven[-1].child, palm)
        found.append(ArmChain(driven[0].parent, tip, names, palm))


def _are_fingers(depths: list[int], joints: int) -> bool:
    """Return whether the branches at the end of a serial chain of joints are fingers of a hand, not arms, for
    arm detection.

    Fingers have fewer joints than their arm. Three or more long branches may also have as many joints as the
    chain: the fingers of TIAGo's hand have as many as its arm.

    Args:
        depths: number of joints of each branch.
        joints: number of joints in series before the branches.
    """
    longest = max(depths)
    return longest < joints or (longest == joints and sum(2 * depth >= longest for depth in depths) > 2)


def _row(model: RobotModel, first: Joint) -> tuple[list[Joint], list[Joint]]:
    """Return the movable joints in series from a given joint to the next branch, and the first joints after
    the branch, to detect arm chains.

    A branch with a short side chain, such as a head on the turning base of an arm, does not end the row.
    """
    row = [first]
    while ends := _next_movable(model, row[-1].child):
        if len(ends) > 1:
            depths = [_depth(model, joint) for joint in ends]
            longest = max(depths)
            major = [joint for joint, depth in zip(ends, depths, strict=True) if 2 * depth >= longest]
            if len(major) > 1 or longest <= HAND_AFTER:
                break
            ends = major
        row.append(ends[0])
    return row, ends


def _next_movable(model: RobotModel, link: str) -> list[Joint]:
    """Return the first movable joints below a link, to detect arm chains. Fixed joints in between are
    skipped.
    """
    found: list[Joint] = []
    rigid = {link}
    for joint in model.joints.values():
        if joint.parent in rigid:
            if joint.movable:
                found.append(joint)
            else:
                rigid.add(joint.child)
    return found


def _depth(model: RobotModel, joint: Joint) -> int:
    """Return the number of actuated joints in the longest branch that
    starts with a joint, to detect arm chains.
    """
    return int(joint.actuated) + max((_depth(model, j) for j in _next_movable(model, joint.child)), default=0)


def _rigid_below(model: RobotModel, link: str) -> list[str]:
    """Return a link and all links below it that are rigidly fixed to it, to detect the palm and the tip of an
    arm.
    """
    rigid = [link]
    for joint in model.joints.values():
        if not joint.movable and joint.parent in rigid:
            rigid.append(joint.child)
    return rigid


def common_link(model: RobotModel, links: list[str]) -> str:
    """Return the lowest common ancestor of the given links in the joint tree, to detect arms and palms. If
    one of these links is an ancestor of all others, return this link.
    """
    trails = []
    for link in links:
        trail = [link]
        while trail[-1] in model.parent_joint:
            trail.append(model.parent_joint[trail[-1]].parent)
        trails.append(trail[::-1])
    return [level[0] for level in zip(*trails) if len(set(level)) == 1][-1]


def _fixed_hand(model: RobotModel, last: str) -> str | None:
    """Return the palm at the end of a detected arm that carries a gripper with fixed fingers, or None if the
    arm has no such gripper.

    The palm is the first link fixed below `last` with at least two branches that have collision geometry.
    """
    for link in _rigid_below(model, last):
        branches = [
            j.child
            for j in model.joints.values()
            if j.parent == link and any(model.links[n].collisions for n in model.subtree(j.child))
        ]
        if link != last and len(branches) > 1:
            return link
    return None


def cup_links(model: RobotModel, links: Sequence[str]) -> tuple[str, ...]:
    """Detect the suction cups among an arm's links by their names. If no name indicates a cup, return the
    links that are named like a vacuum gripper.

    Of links that carry each other, only the outermost ones are in the result.
    """
    solid = [n for n in links if model.links[n].collisions or model.links[n].visuals]
    named = [n for n in solid if CUP.search(n)] or [n for n in solid if SUCTION.search(n)]
    return tuple(n for n in named if not set(model.subtree(n)[1:]) & set(named))


def _suction_hand(model: RobotModel, last: str, cups: Collection[str]) -> str | None:
    """Return the link of a suction gripper at the end of a detected arm chain. Return None if no link beyond
    the arm is a suction cup, by its name or according to `cups`.

    The link is the first link with geometry that carries all cups, or else `last`.
    """
    rigid = _rigid_below(model, last)[1:]
    found = [n for n in rigid if n in cups] or list(cup_links(model, rigid))
    if not found:
        return None
    carrier = common_link(model, found)
    carriers = [n for n in rigid if carrier in model.subtree(n) and model.links[n].collisions]
    return carriers[0] if carriers else carrier


def _tip(model: RobotModel, last: str, palm: str | None) -> str:
    """Return the tip link of a detected arm: a tool frame, or else the palm, or else the last link."""
    rigid = _rigid_below(model, last)
    frames = [n for n in rigid if n != last and not model.links[n].collisions and TOOL.search(n)]
    if palm is not None:
        below = set(model.subtree(palm))
        return next((n for n in frames if n in below), palm)
    if frames:
        return frames[-1]
    leaves = [n for n in rigid if not any(j.parent == n for j in model.joints.values())]
    return next((n for n in leaves if TOOL.search(n)), leaves[0] if len(leaves) == 1 else last)


# --- names ---
def _names(chains: list[ArmChain], robots: Sequence[str]) -> list[tuple[str, str]]:
    """Return the names of the planning groups (arm, gripper) for each detected arm chain, with unique
    prefixes.

    A single chain needs no prefix.

    The prefix is the common beginning of the chain's joint names. If two prefixes are equal, numbers replace
    them.
    """
    prefixes = [_prefix(c.joints, robots) for c in chains] if len(chains) > 1 else [""]
    if len(set(prefixes)) < len(prefixes) or not all(prefixes[1:]):
        numbers = range(1, len(chains) + 1)
        return [(f"arm_{i}", f"gripper_{i}") for i in numbers]
    return [(f"{p}arm", f"{p}gripper") for p in prefixes]


def _prefix(joints: tuple[str, ...], robots: Sequence[str]) -> str:
    """Return the name prefix of the robot that a detected arm belongs to,
    or else the common prefix of its joint names.
    """
    for robot in sorted(robots, key=len, reverse=True):
        if robot and joints[0].startswith(robot):
            return robot
    words = [name.split("_")[:-1] for name in joints]
    shared = [level[0] for level in zip(*words) if len(set(level)) == 1 and level[0].lower() not in IDLE]
    return "".join(f"{word}_" for word in shared)
