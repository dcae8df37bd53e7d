"""Joint gains from files: armcell's gain sets and ros_control controller files."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.core.checks import settings_from
from armcell.model import RobotModel
from armcell.model.untrusted_files import read_yaml
from armcell.sim.joint_gains import GainTable, check_joint_gains
from armcell.sim.ros_control import controller_gains, is_controllers
from armcell.sim.settings import PhysicsSettings

logger = logging.getLogger(__name__)

SETS = Path(__file__).parent / "gains"
KEYS = (
    "arm_control", "arm_kp", "arm_ki", "arm_kv", "slide_kp", "slide_kv", "full_gain_effort", "joint_gains",
    "gravity_compensation",
)  # fmt: skip
"""Physics settings that a gain file may contain."""


def gains_names() -> list[str]:
    """Return the names of the sets of joint gains that come with armcell."""
    return sorted(p.stem for p in SETS.glob("*.yaml"))


def gain_values(gains: str | Path, model: RobotModel, folder: Path = Path()) -> dict[str, Any]:
    """Read a joint gain set or a gain file.
    Return its physics settings in the format of a cell's `physics` block.

    A ros_control controller file yields `arm_control: torque` and `joint_gains`: like a ros_control
    controller, the simulation computes the efforts once per step from the tracking error. Entries without an
    effect are logged.

    Args:
        gains: name of a gain set (see `gains_names`), or path of a file with some of `KEYS` or of
            ros_control's `controllers.yaml`.
        folder: directory that relative paths refer to.
    Raises:
        InputError: the file does not exist, or a key or value is not a gain; the message names the file, the
            controller and the joint.
    """
    name = str(gains)
    if "/" not in name and "." not in name:
        if name not in gains_names():
            raise UnknownNameError("set of gains", name, gains_names())
        file = SETS / f"{name}.yaml"
    else:
        file = folder / name
    data = read_yaml(file)
    if is_controllers(data):
        table, notes = controller_gains(data, file, model)
        for note in notes:
            logger.warning("%s: %s", file, note)
        return {"arm_control": "torque", "joint_gains": table.plain()}
    for key in data:
        if key not in KEYS:
            raise UnknownNameError("gain", key, KEYS, file=file)
    try:
        read = settings_from(PhysicsSettings, data, "gains")
        check_joint_gains(read, model, file=file, element="joint_gains")
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.reason, file=file, element=error.element, hint=error.hint) from None
    return data


def with_gains(
    settings: PhysicsSettings, gains: str | Path, model: RobotModel, folder: Path = Path()
) -> PhysicsSettings:
    """Return physics settings with the arm control and the joint gains of a gain set or gain file.

    See `gain_values`. The result does not keep any `joint_gains` of `settings`.
    """
    mine = {f.name: getattr(settings, f.name) for f in fields(settings)}
    values = gain_values(gains, model, folder)
    return settings_from(PhysicsSettings, {**mine, "joint_gains": GainTable(), **values}, "gains")


def with_gains_file(physics: Mapping[str, Any], model: RobotModel, folder: Path) -> dict[str, Any]:
    """Read the gain file that the key `gains` in a cell's `physics` block names,
    and merge its joint gains into the block.

    Other keys of the block override the file, and `joint_gains` are merged joint by joint.

    Raises:
        InputError: `gains` is not a string, or its file is invalid (see `gain_values`).
    """
    values = dict(physics)
    gains = values.pop("gains", None)
    if gains is None:
        return values
    if not isinstance(gains, str):
        raise InputError(
            f"gains is {gains!r}, a name or a file is needed",
            hint=f"one of {', '.join(gains_names())}, or a file such as controllers.yaml",
        )
    base = gain_values(gains, model, folder)
    if isinstance(own := values.get("joint_gains"), Mapping):
        values["joint_gains"] = {**base.get("joint_gains", {}), **own}
    return {**base, **values}
