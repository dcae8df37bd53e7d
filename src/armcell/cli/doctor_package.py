"""Checks of `armcell doctor` for a MoveIt configuration package: its files and controllers."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from armcell.cli.doctor import NO, OK, Finding
from armcell.core import InputError, UnknownNameError
from armcell.model import MoveItConfig

DRIVER_FILES = (
    "ros2_controllers.yaml",
    "ros_controllers.yaml",
)  # files of the controller manager


def check_package(folder: Path) -> Iterator[Finding]:
    """Check a MoveIt package for `armcell doctor`: its files,
    and that each joint has one controller with a valid name.
    """
    try:
        config = MoveItConfig.load(folder)
    except InputError as error:
        yield Finding(NO, "MoveIt package", str(error))
        return
    files = ", ".join(config.names[key] for key in config.files)
    yield Finding(OK, "MoveIt package", f"{folder}: {config.names['srdf']}, {files}")
    yield from check_joint_controllers(config)
    yield from check_controller_names(config)


def check_joint_controllers(config: MoveItConfig) -> Iterator[Finding]:
    """Check, for `armcell doctor`, that a MoveIt package has exactly
    one controller for every joint of its groups.

    MoveIt refuses to execute a motion if a joint has no controller. If a joint has several default
    controllers, the choice is arbitrary.
    """
    of_joint: dict[str, list[str]] = {}
    for name, entry in config.controllers.items():
        joints = entry.get("joints") or []
        yield Finding(OK, f"controller {name}", f"{entry.get('type')} of {', '.join(joints) or 'no joints'}")
        if entry.get("default"):
            for joint in joints:
                of_joint.setdefault(joint, []).append(name)
    every = {joint for entry in config.controllers.values() for joint in entry.get("joints") or []}
    for group in config.model.groups.values():
        missing = [joint for joint in group.joint_names if joint not in every]
        if group.tip_link is not None and missing:
            hint = "MoveIt would plan and then refuse to execute; add them to a controller's joints"
            yield Finding(NO, f"group {group.name}", f"no controller moves {', '.join(missing)}: {hint}")
    for joint, names in of_joint.items():
        if len(names) > 1:
            hint = "which one executes is chance; take `default: true` from all but one"
            yield Finding(NO, f"joint {joint}", f"is in {' and '.join(names)}: {hint}")


def check_controller_names(config: MoveItConfig) -> Iterator[Finding]:
    """Check, for `armcell doctor`, that the controllers of a MoveIt
    package also occur in the controller manager's file.
    """
    for file in (config.folder / "config" / name for name in DRIVER_FILES):
        if os.path.isfile(file) and file.name != config.names.get("controllers"):
            yield from _compared(config, file)


def _compared(config: MoveItConfig, file: Path) -> Iterator[Finding]:
    try:
        started = _joints_of(yaml.safe_load(file.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        yield Finding(NO, file.name, f"cannot be read: {str(error).splitlines()[0]}")
        return
    wrong = False
    for name, entry in config.controllers.items():
        if name not in started:
            why = UnknownNameError("controller", name, started)
            yield Finding(NO, file.name, f"{_named(config)} names a controller that it does not start: {why}")
            wrong = True
        elif started[name] and set(started[name]) != set(entry.get("joints") or []):
            only = ", ".join(sorted(set(started[name]) ^ set(entry.get("joints") or [])))
            yield Finding(
                NO, file.name, f"{name} has other joints than in {_named(config)}: {only} in one only"
            )
            wrong = True
    if not wrong:
        yield Finding(OK, file.name, f"has the controllers that {_named(config)} names")


def _named(config: MoveItConfig) -> str:
    return config.names.get("controllers", "no file")


def _joints_of(data: Any) -> dict[str, list[str]]:
    """Return, for `armcell doctor`, the joints of each controller in the controller manager's file of a
    MoveIt package (ROS 2 or ROS 1).

    ROS 2 nests the joints as `name: {ros__parameters: {joints: []}}`; ROS 1 omits the key `ros__parameters`.
    """
    found: dict[str, list[str]] = {}
    for name, entry in data.items() if isinstance(data, dict) else ():
        if not isinstance(entry, dict):
            continue
        inner = entry.get("ros__parameters", entry)
        if name == "controller_manager":
            for other, settings in inner.items() if isinstance(inner, dict) else ():
                if isinstance(settings, dict) and "type" in settings:
                    found.setdefault(other, [])
        elif isinstance(inner, dict):
            joints = inner.get("joints") or ([inner["joint"]] if isinstance(inner.get("joint"), str) else [])
            found[name] = [str(joint) for joint in joints] if isinstance(joints, list) else []
    return found
