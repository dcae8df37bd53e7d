"""Composition of robots: prefixes, mounted grippers, dual-arm cells, extra frames, and the hand alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from armcell.core import SE3, InputError, UnknownNameError
from armcell.model.grippers import Gripper
from armcell.model.robot import EndEffector, Group, Joint, Link, Mimic, MjcfPart, RobotModel


@dataclass(frozen=True, eq=False)
class MountedRobot:
    """One robot to be composed with others, given by its model, name prefix and mounting pose.

    `parent_link` is "world" or a link of an earlier part; `T_parent_root` is the pose of this part's root
    link in the frame of `parent_link`.
    """

    model: RobotModel
    prefix: str = ""
    parent_link: str = "world"
    T_parent_root: SE3 = SE3.identity()


def prefixed(model: RobotModel, prefix: str) -> RobotModel:
    """Return a robot model in which all names of links, joints, groups and grippers start with `prefix`,
    for composing several robots.
    """
    if not prefix:
        return model
    p = lambda name: None if name is None else prefix + name  # noqa: E731
    tuple_p = lambda names: tuple(prefix + n for n in names)  # noqa: E731
    return replace(
        model,
        root_link=prefix + model.root_link,
        links={prefix + n: replace(link, name=prefix + n) for n, link in model.links.items()},
        joints={
            prefix + n: replace(
                j,
                name=prefix + n,
                parent=prefix + j.parent,
                child=prefix + j.child,
                mimic=j.mimic and Mimic(prefix + j.mimic.joint, j.mimic.multiplier, j.mimic.offset),
            )
            for n, j in model.joints.items()
        },
        groups={
            prefix + n: Group(
                prefix + n,
                tuple_p(g.joint_names),
                tuple_p(g.link_names),
                p(g.base_link),
                p(g.tip_link),
                g.ik_solver,
            )
            for n, g in model.groups.items()
        },
        end_effectors={
            prefix + n: EndEffector(prefix + n, prefix + e.group, prefix + e.parent_link, p(e.parent_group))
            for n, e in model.end_effectors.items()
        },
        grippers={prefix + n: g.prefixed(prefix) for n, g in model.grippers.items()},
        named_states={
            prefix + g: {s: {prefix + j: v for j, v in values.items()} for s, values in states.items()}
            for g, states in model.named_states.items()
        },
        disabled_collisions={
            frozenset(prefix + n for n in pair): reason for pair, reason in model.disabled_collisions.items()
        },
        mjcf=tuple(part.prefixed(prefix) for part in model.mjcf),
    )


def compose(name: str, parts: Sequence[MountedRobot]) -> RobotModel:
    """Compose several robots into one model. Each robot is mounted on the world or on an earlier robot.

    Raises:
        InputError: `parts` is empty, or two parts share a link, joint or group name (use prefixes).
        UnknownNameError: a parent link does not exist in the earlier parts.
    """
    if not parts:
        raise InputError(f"robot {name!r} is composed of no parts")
    links: dict[str, Link] = {}
    joints: dict[str, Joint] = {}
    root = ""
    needs_world = len([p for p in parts if p.parent_link == "world"]) > 1 or any(
        p.parent_link == "world" and not p.T_parent_root.isclose(SE3.identity()) for p in parts
    )
    if needs_world:
        links["world"] = Link("world")
        root = "world"
    merged: dict[str, dict] = {k: {} for k in ("groups", "end_effectors", "grippers", "named_states")}
    disabled: dict[frozenset[str], str] = {}
    mjcf: list[MjcfPart] = []
    for part in parts:
        model = prefixed(part.model, part.prefix)
        taken = sorted((set(links) & set(model.links)) | (set(joints) & set(model.joints)))
        if taken:
            raise InputError(
                f"robot {name!r}: two parts have {taken[0]!r} (and {len(taken) - 1} other names)",
                hint="give each part its own prefix",
            )
        if part.parent_link == "world" and not needs_world:
            root = model.root_link
        else:
            if part.parent_link not in links:
                raise UnknownNameError("link", part.parent_link, links)
            mount = f"{part.parent_link}_to_{model.root_link}"
            joints[mount] = Joint(mount, "fixed", part.parent_link, model.root_link, part.T_parent_root)
        links.update(model.links)
        joints.update(model.joints)
        for key, into in merged.items():
            for item, value in getattr(model, key).items():
                if item in into:
                    raise InputError(
                        f"robot {name!r}: two parts have {key.replace('_', ' ')[:-1]} {item!r}",
                        hint="give each part its own prefix",
                    )
                into[item] = value
        disabled.update(model.disabled_collisions)
        mjcf.extend(model.mjcf)
    return RobotModel(
        name=name,
        root_link=root,
        links=links,
        joints=joints,
        disabled_collisions=disabled,
        source=", ".join(p.model.source for p in parts),
        mjcf=tuple(mjcf),
        **merged,
    )


def hand_alone(model: RobotModel, gripper: Gripper) -> RobotModel:
    """Return a robot model that consists of a hand without its arm: the gripper's links and all links below
    them.

    The root link is the lowest link above all links of the gripper. The new model has no planning groups, end
    effectors or named states; the gripper and its joints are unchanged.
    """
    links = {gripper.tcp_link, *gripper.hand_links, *gripper.contact_links}
    chains = [[j.parent for j in reversed(model.chain(model.root_link, link))] for link in links]
    above = [
        [link, *chain] for link, chain in zip(links, chains, strict=True)
    ]  # ancestors of each link, from the link up to the root
    root = next(link for link in above[0] if all(link in chain for chain in above[1:]))
    kept = model.subtree(root)
    return replace(
        model,
        name=f"{model.name}:{gripper.name}",
        root_link=root,
        links={n: link for n, link in model.links.items() if n in kept},
        joints={n: j for n, j in model.joints.items() if j.parent in kept},
        groups={},
        end_effectors={},
        named_states={},
        grippers={gripper.name: gripper},
        disabled_collisions={p: why for p, why in model.disabled_collisions.items() if p <= set(kept)},
    )


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


def with_whole_fingers(model: RobotModel) -> RobotModel:
    """Compose each finger of the robot into one solid link: the collision shapes of links that are fixed to a
    finger, such as exchangeable finger tips, become shapes of the finger's link.

    Grasp planning and physics know a finger by its link. A finger that is fixed to the palm keeps its shapes.
    Physics keeps the bodies of links from an MJCF file, and counts their contacts as the finger's. A pair
    with the finger's link is not checked for collision if one of the joined links touches normally, or if all
    of them never touch.
    """
    links, pairs = dict(model.links), dict(model.disabled_collisions)
    for name, finger in finger_parts(model).items():
        if links[name].collisions:
            at, part = (model.pose_at_zero(model.root_link, n) for n in (finger, name))
            T = at.inverse() @ part
            moved = tuple(replace(c, T_link_shape=T @ c.T_link_shape) for c in links[name].collisions)
            links[finger] = replace(links[finger], collisions=links[finger].collisions + moved)
            links[name] = replace(links[name], collisions=())
            rigid = next(group for group in model.rigid_groups if finger in group)
            _join_pairs(pairs, finger, name, [n for n in links if n not in rigid])
    return replace(model, links=links, disabled_collisions=pairs) if links != model.links else model


def finger_parts(model: RobotModel) -> dict[str, str]:
    """Return the finger to which each link is fixed, in the model's order of links, so that whole fingers can
    be composed. Links that are also fixed to the palm have no entry.
    """
    found = {}
    for gripper in model.grippers.values():
        for finger in dict.fromkeys(gripper.finger_links):
            rigid = next(group for group in model.rigid_groups if finger in group)
            if gripper.tcp_link not in rigid:
                found |= {n: finger for n in model.links if n in rigid and n not in gripper.finger_links}
    return found


def _join_pairs(pairs: dict[frozenset[str], str], finger: str, part: str, others: Iterable[str]) -> None:
    """Combine the disabled collision pairs of a finger's link with those of a part that becomes one solid
    link with the finger.
    """
    for other in others:
        reasons = [pairs.get(frozenset((link, other))) for link in (finger, part)]
        normal = next((reason for reason in reasons if reason not in (None, "Never")), None)
        if normal is not None:
            pairs[frozenset((finger, other))] = normal
        elif None in reasons:
            pairs.pop(frozenset((finger, other)), None)


def with_tip(model: RobotModel, group: str, link: str) -> RobotModel:
    """Return the robot with a new tip link for a planning group (chain),
    such as the tcp of a detected gripper.
    """
    old = model.groups[group]
    chain = model.chain(str(old.base_link), link)
    new = replace(old, tip_link=link, link_names=tuple(j.child for j in chain))
    return replace(model, groups={**model.groups, group: new})
