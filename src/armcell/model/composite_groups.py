"""Composite planning groups (groups of groups) and extra named states from robot.yaml."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.model.robot import Group, RobotModel


def with_composite_groups(model: RobotModel, groups: Any, states: Any, file: Path) -> RobotModel:
    """Return the robot with the composite planning groups and the named states that robot.yaml defines.

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
