"""Joint gains from files: armcell's gain sets, and PID gains from ros_control's controller files.

The reader accepts these forms, at any depth of namespaces:

    CONTROLLER: {type: effort_controllers/JointTrajectoryController, joints: [...], gains: {JOINT: {p, i, d}}}
    CONTROLLER: {type: effort_controllers/JointPositionController, joint: JOINT, pid: {p, i, d}}
    CONTROLLER: {type: effort_controllers/JointGroupPositionController, joints: [JOINT], JOINT: {pid: {p, i}}}
    CONTROLLER: {ros__parameters: {joints: [...], command_interfaces: [effort], gains: {JOINT: {p, i, d}}}}
    gazebo_ros_control: {pid_gains: {JOINT: {p, i, d}}}

The control law and the defaults are those of control_toolbox::Pid. It clamps the integral to `i_clamp`, which
is 0 if the file does not specify it, so an `i` without an `i_clamp` has no effect.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.core.checks import settings_from
from armcell.model import RobotModel
from armcell.model.untrusted_files import read_yaml
from armcell.sim.joint_gains import GainTable, JointGains, arm_joints, check_joint_gains, gains_of
from armcell.sim.settings import PhysicsSettings

GAINS = {f.name for f in fields(JointGains)}
# Parameters of control_toolbox and the controllers that are not gains.
PASSED_OVER = {
    "publish_state", "angle_wraparound", "normalize_error", "antiwindup_strategy", "saturation",
    "u_clamp_min", "u_clamp_max", "save_i_terms", "integral_deadband", "error_deadband",
    "tracking_time_constant",
}  # fmt: skip
DEEPEST = 12  # largest number of names in a parameter's path
EFFORT, GAZEBO, POSITION = 2, 1, 0
"""Ranks of a joint's gain sets in a file; the gains with the highest rank apply.

`EFFORT`: a controller that commands efforts. `GAZEBO`: the Gazebo plugin. `POSITION`: a controller that
commands positions, whose gains ros_control ignores.
"""
logger = logging.getLogger(__name__)
SETS = Path(__file__).parent / "gains"
KEYS = (
    "arm_control", "arm_kp", "arm_ki", "arm_kv", "slide_kp", "slide_kv", "full_gain_effort", "joint_gains",
    "gravity_compensation",
)  # fmt: skip
"""Physics settings that a gain file may contain."""


@dataclass(frozen=True)
class _Entry:
    """Gains of one joint from a controller file of ros_control,
    with their path in the file and their priority.
    """

    place: str
    gains: JointGains
    rank: int


@dataclass
class _Reader:
    file: Path
    model: RobotModel
    entries: dict[str, _Entry] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    types: dict[str, str] = field(default_factory=dict)

    def note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def find_types(self, node: Mapping, name: str = "") -> None:
        """Collect the types of the controllers in a gain file, from the parameters of ros2_control's
        controller manager.
        """
        if isinstance(node.get("type"), str):
            self.types.setdefault(name, node["type"])
        for key, value in node.items():
            if isinstance(value, Mapping):
                self.find_types(value, str(key))

    def walk(self, node: Mapping, path: tuple[str, ...] = ()) -> None:
        inner = node.get("ros__parameters")
        if isinstance(inner, Mapping):
            node = {**{k: v for k, v in node.items() if k != "ros__parameters"}, **inner}
        name = next((part for part in reversed(path) if part not in ("/**", "")), "")
        read = False
        if isinstance(table := node.get("pid_gains"), Mapping):
            self.table("/".join((*path, "pid_gains")), table, {}, GAZEBO)
            read = True
        if (table := node.get("gains")) is not None and ("joints" in node or "dof_names" in node):
            self.trajectory_controller("/".join(path), self.types.get(name, ""), node, table)
            read = True
        for joint, entry in self.joint_entries(node).items():
            rank = self.rank("/".join(path), self.types.get(name, ""), node)
            if rank is not None:
                self.add("/".join((*path, "pid")), joint, entry, rank)
            read = True
        for key, value in node.items():
            if isinstance(value, Mapping) and not (read and key in ("gains", "pid", "pid_gains")):
                self.walk(value, (*path, str(key)))

    def joint_entries(self, node: Mapping) -> dict[str, Any]:
        """Return the gains under the key `pid` of a controller in a ros_control file, by joint."""
        if isinstance(node.get("joint"), str) and "pid" in node:
            return {node["joint"]: node["pid"]}
        names = node.get("joints")
        if not isinstance(names, list):
            return {}
        own = {str(n): node.get(str(n)) for n in names}
        return {n: entry["pid"] for n, entry in own.items() if isinstance(entry, Mapping) and "pid" in entry}

    def rank(self, place: str, kind: str, node: Mapping) -> int | None:
        """Return the priority of the gains of one controller in a ros_control file, or None for a velocity
        controller. For each joint, the gains with the highest priority apply.
        """
        interfaces = node.get("command_interfaces") or node.get("command_interface") or []
        interfaces = [interfaces] if isinstance(interfaces, str) else interfaces
        package = kind.partition("/")[0]
        if (
            package == "velocity_controllers"
            or kind.endswith("VelocityController")
            or interfaces == ["velocity"]
        ):
            self.note(
                f"{place} ({kind or 'command_interfaces: [velocity]'}) is left out: its gains are not those "
                "of an effort from a position error"
            )
            return None
        named_position = package in ("position_controllers", "pos_vel_controllers", "pos_vel_acc_controllers")
        if named_position or (interfaces and "effort" not in interfaces):
            self.note(
                f"{place} commands positions, so ros_control does not use its gains; armcell uses them "
                "as those of an effort"
            )
            return POSITION
        return EFFORT

    def trajectory_controller(self, place: str, kind: str, node: Mapping, table: Any) -> None:
        names = node.get("joints") or node.get("dof_names") or []
        if not isinstance(table, Mapping):
            raise InputError("'gains' is not a mapping of joints to gains", file=self.file, element=place)
        if not isinstance(names, list):
            raise InputError("'joints' is not a list of names", file=self.file, element=place)
        rank = self.rank(place, kind, node)
        if rank is None:
            return
        listed = [str(n) for n in names]
        for joint in table:
            if listed and str(joint) not in listed:
                raise UnknownNameError("joint", joint, listed, file=self.file, element=f"{place}/gains")
        for joint in listed:
            if joint not in table:
                self.note(f"{place}: joint {joint!r} has no gains there, it keeps the cell's")
        forward = node.get("velocity_ff")
        self.table(f"{place}/gains", table, forward if isinstance(forward, Mapping) else {}, rank)

    def table(self, place: str, table: Mapping, forward: Mapping, rank: int) -> None:
        for joint, entry in table.items():
            more = {"ff_velocity_scale": forward[joint]} if joint in forward else {}
            self.add(place, str(joint), {**entry, **more} if isinstance(entry, Mapping) else entry, rank)

    def add(self, place: str, joint: str, entry: Any, rank: int) -> None:
        known = arm_joints(self.model)
        if joint not in known and joint in self.model.joints:
            self.note(f"{place}: joint {joint!r} is not an arm joint (physics drives grippers by gripper_kp)")
            return
        if joint not in known:
            raise UnknownNameError("joint", joint, known, file=self.file, element=place)
        new = _Entry(f"{place}/{joint}", self.gains(place, joint, entry), rank)
        old = self.entries.setdefault(joint, new)
        if old.rank == rank and old.gains != new.gains:
            raise InputError(
                f"joint {joint!r} has other gains here than in {old.place}", file=self.file,
                element=new.place, hint="keep those of the controller that you start",
            )  # fmt: skip
        if rank > old.rank:
            self.entries[joint] = new

    def gains(self, place: str, joint: str, entry: Any) -> JointGains:
        try:
            if not isinstance(entry, Mapping):
                raise InputError(
                    f"{joint} is {entry!r}, a mapping such as {{p: 80, i: 0.5, d: 1.5}} is needed"
                )
            kept = {k: _number(v) for k, v in entry.items() if k not in PASSED_OVER}
            windup = kept.pop("antiwindup", False)
            for key in ("i_clamp_min", "i_clamp_max", "i_clamp"):  # control_toolbox uses absolute values
                if isinstance(kept.get(key), int | float):
                    kept[key] = abs(kept[key])
            kept.setdefault("i_clamp", 0.0)
            made = gains_of({**kept, "antiwindup": windup}, joint)
        except UnknownNameError as error:
            element = f"{place}/{joint}"
            raise UnknownNameError("gain", error.name, GAINS, file=self.file, element=element) from None
        except InputError as error:
            raise InputError(error.reason, file=self.file, element=place, hint=error.hint) from None
        if made.i > 0 and max(made.i_clamp, made.i_clamp_min, made.i_clamp_max) == 0:
            self.note(
                f"{place}/{joint}: i = {made.i:g} does nothing without i_clamp: ros_control clamps the "
                "integral to 0 (add e.g. i_clamp: 10)"
            )
        return made


def is_controllers(data: Mapping) -> bool:
    """Return whether a parsed YAML file looks like a controller file of ros_control.

    Every top-level value of such a file is a mapping.
    """
    return bool(data) and all(isinstance(v, Mapping) for v in data.values()) and "joint_gains" not in data


def controller_gains(data: Mapping, file: Path, model: RobotModel) -> tuple[GainTable, list[str]]:
    """Return the PID gains by joint from a parsed controller file of ros_control.

    Args:
        data: the parsed file.
        file: path of the file, for messages.
        model: the robot; the file may specify gains of its arm joints only.
    Returns:
        The gains by joint, and notes on file content that is ignored or that has a different effect in
        armcell.
    Raises:
        InputError: the file has no gains, `p` is missing, a value is not a number >= 0, or a joint has two
            different sets of gains; the message names the file, the controller and the joint.
        UnknownNameError: a joint or gain does not exist; the message names the same details.
    """
    data, reader = _nested(data), _Reader(file, model)
    reader.find_types(data)
    reader.walk(data)
    if not reader.entries:
        notes = f": {'; '.join(reader.notes)}" if reader.notes else ""
        raise InputError(
            f"has no PID gains of an arm joint{notes}", file=file,
            hint="give 'gains: {JOINT: {p: 80, i: 0.5, d: 1.5}}' beside a controller's 'joints'",
        )  # fmt: skip
    missing = [joint for joint in arm_joints(model) if joint not in reader.entries]
    if missing:
        reader.note(f"no gains for {', '.join(missing)}: these joints keep the cell's")
    return GainTable({joint: entry.gains for joint, entry in reader.entries.items()}), reader.notes


def _nested(data: Any) -> Any:
    """Expand keys that are paths, such as /gazebo_ros_control/pid_gains/JOINT, in a ros_control controller
    file.
    """
    if not isinstance(data, Mapping):
        return data
    made: dict[Any, Any] = {}
    for key, value in data.items():
        parts = [p for p in key.split("/", DEEPEST) if p] if isinstance(key, str) and key != "/**" else [key]
        at = made
        for part in parts[:-1]:
            inner = at.get(part)
            at[part] = at = dict(inner) if isinstance(inner, Mapping) else {}
        last, value = parts[-1] if parts else key, _nested(value)
        both = isinstance(at.get(last), Mapping) and isinstance(value, Mapping)
        at[last] = {**at[last], **value} if both else value
    return made


def _number(value: Any) -> Any:
    """Convert a gain in a ros_control file from text to a number if possible.
    YAML 1.1 reads numbers such as 10e-10 as text.
    """
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


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
        check_joint_gains(read.joint_gains, model, file=file, element="joint_gains")
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.reason, file=file, element=error.element, hint=error.hint) from None
    return data


def with_gains(
    settings: PhysicsSettings, gains: str | Path, model: RobotModel, folder: Path = Path()
) -> PhysicsSettings:
    """Return a copy of the physics settings, changed by a named gain set or a gain file: the arm control
    mode, the joint gains and related settings.

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
