"""YAML files of a MoveIt configuration: checks of their names and types, and the joint limits they set.

Error messages contain the file and the key.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.model.robot import RobotModel
from armcell.model.setup.defaults import ACCELERATION, VELOCITY

logger = logging.getLogger(__name__)

Data = dict[str, Any]


def unwrapped(data: Data, *inner: str) -> Data:
    """Return the ROS parameters in one file of a MoveIt configuration, without node names and namespaces.

    ROS 2 files wrap parameters in a node name, `ros__parameters` and possibly a namespace in `inner`.
    """
    while isinstance(data, dict) and len(data) == 1:
        key = next(iter(data))
        if key not in ("/**", "/move_group", "move_group", "ros__parameters", *inner):
            break
        data = data[key]
    return data


def to_number(value: Any) -> Any:
    """Convert a numeric string from a YAML file of MoveIt to a float; leave other values unchanged.

    YAML 1.1 parses a number such as 10e-10 as a string.
    """
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value


def mapping_of(value: Any, file: Path, key: str) -> Data:
    if not isinstance(value, dict):
        raise InputError(f"is {type_of(value)}, a mapping is needed", file=file, element=key)
    return value


def list_of(value: Any, file: Path, key: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"is {type_of(value)}, a list is needed", file=file, element=key)
    return value


def number_of(value: Any, file: Path, key: str) -> float:
    value = to_number(value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"is {type_of(value)} ({value!r}), a number is needed", file=file, element=key)
    if not math.isfinite(value):
        raise InputError(f"is {value}, a finite number is needed", file=file, element=key)
    return float(value)


def name_of(value: Any, file: Path, key: str) -> str:
    if not isinstance(value, str) or not value:
        raise InputError(f"is {type_of(value)}, a name is needed", file=file, element=key)
    return value


def known_group(name: str, file: Path, model: RobotModel) -> bool:
    """Return whether a planning group named in a YAML file of MoveIt is in the SRDF. If not, log a warning.

    Like MoveIt, armcell ignores settings of undefined groups.
    """
    if name not in model.groups:
        known = ", ".join(sorted(model.groups))
        logger.warning("%s: planning group %r is not in the SRDF (it has %s)", file, name, known)
    return name in model.groups


def check_joint_limits(data: Data, file: Path, model: RobotModel) -> None:
    for name, entry in limits_of(data, file).items():
        if name not in model.joints:
            raise UnknownNameError("joint", name, model.joints, file=file, element="joint_limits")
        for key, value in mapping_of(entry, file, f"joint_limits/{name}").items():
            place = f"joint_limits/{name}/{key}"
            if key.startswith("has_") or key == "angle_wraparound":
                if not isinstance(value, bool):
                    raise InputError(
                        f"is {type_of(value)}, true or false is needed", file=file, element=place
                    )
            else:
                number_of(value, file, place)


def limits_of(data: Data, file: Path) -> Data:
    inner = unwrapped(data, "robot_description_planning")
    if "joint_limits" not in mapping_of(inner, file, "robot_description_planning"):
        raise InputError("has no mapping 'joint_limits'", file=file)
    return mapping_of(inner["joint_limits"] or {}, file, "joint_limits")


def with_joint_limits(model: RobotModel, data: Data, file: Path) -> RobotModel:
    """Return the robot with the joint limits from the files of its MoveIt configuration, where these limits
    are tighter.

    A wider velocity, acceleration or jerk limit is ignored with a warning. Joints without any velocity or
    acceleration limit get MoveIt's defaults.
    """
    joints = dict(model.joints)
    for name, entry in limits_of(data, file).items():
        limits = joints[name].limits
        for kind, attribute in (
            ("velocity", "velocity"),
            ("acceleration", "acceleration"),
            ("jerk", "jerk"),
        ):
            value = to_number(entry.get(f"max_{kind}"))
            if value is None or not entry.get(f"has_{kind}_limits", True) or value <= 0:
                continue
            if value > getattr(limits, attribute) * (1 + 1e-6):
                logger.warning(
                    "%s: max_%s %g of %s is above the URDF's %g, which is kept",
                    file, kind, value, name, getattr(limits, attribute),
                )  # fmt: skip
                continue
            limits = replace(limits, **{attribute: float(value)})
        if entry.get("has_position_limits", True):
            low = max(limits.lower, to_number(entry.get("min_position", limits.lower)))
            high = min(limits.upper, to_number(entry.get("max_position", limits.upper)))
            if low > high:
                raise InputError(
                    f"leaves no range ({low:g} to {high:g})", file=file, element=f"joint_limits/{name}"
                )
            limits = replace(limits, lower=low, upper=high)
        joints[name] = replace(joints[name], limits=limits)
    for name, joint in joints.items():  # MoveIt's defaults for joints without a limit
        velocity = VELOCITY if math.isinf(joint.limits.velocity) else None
        acceleration = ACCELERATION if math.isinf(joint.limits.acceleration) else None
        if joint.movable and (velocity or acceleration):
            given = {"velocity": velocity, "acceleration": acceleration}
            limits = replace(joint.limits, **{k: v for k, v in given.items() if v})
            joints[name] = replace(joint, limits=limits)
    return replace(model, joints=joints)


def check_kinematics(data: Data, file: Path, model: RobotModel) -> None:
    inner = mapping_of(unwrapped(data, "robot_description_kinematics"), file, "robot_description_kinematics")
    for group, entry in inner.items():
        if not known_group(group, file, model):
            continue
        entry = mapping_of(entry, file, group)
        name_of(entry.get("kinematics_solver"), file, f"{group}/kinematics_solver")
        for key in ("kinematics_solver_search_resolution", "kinematics_solver_timeout"):
            if key in entry:
                number_of(entry[key], file, f"{group}/{key}")


def check_ompl_planning(data: Data, file: Path, model: RobotModel) -> None:
    inner = mapping_of(unwrapped(data, "ompl"), file, "ompl")
    configs = mapping_of(inner.get("planner_configs") or {}, file, "planner_configs")
    for name, entry in configs.items():
        entry = mapping_of(entry, file, f"planner_configs/{name}")
        name_of(entry.get("type"), file, f"planner_configs/{name}/type")
    for group, entry in inner.items():
        if group == "planner_configs":
            continue
        if not isinstance(entry, dict):
            if group in model.groups:
                mapping_of(entry, file, group)
            continue  # settings of the pipeline: planning_plugin, request_adapters, ...
        if not known_group(group, file, model):
            continue
        listed = list_of(entry.get("planner_configs") or [], file, f"{group}/planner_configs")
        for name in (
            *listed,
            *([entry["default_planner_config"]] if "default_planner_config" in entry else []),
        ):
            if name_of(name, file, f"{group}/planner_configs") not in configs:
                place = f"{group}/planner_configs"
                raise UnknownNameError("planner config", name, configs, file=file, element=place)
        if "longest_valid_segment_fraction" in entry:
            place = f"{group}/longest_valid_segment_fraction"
            number_of(entry["longest_valid_segment_fraction"], file, place)


def check_controllers(data: Data, file: Path, model: RobotModel) -> None:
    inner = mapping_of(unwrapped(data), file, "top level")
    manager = mapping_of(
        inner.get("moveit_simple_controller_manager", inner), file, "moveit_simple_controller_manager"
    )
    if "controller_list" in manager:
        for i, entry in enumerate(list_of(manager["controller_list"], file, "controller_list")):
            entry = mapping_of(entry, file, f"controller_list/{i}")
            # ROS-Industrial's drivers serve the action without a controller's name.
            name = entry.get("action_ns") if entry.get("name") == "" else entry.get("name")
            check_controller(entry, file, name_of(name, file, f"controller_list/{i}/name"), model)
        return
    for name in list_of(manager.get("controller_names") or [], file, "controller_names"):
        name = name_of(name, file, "controller_names")
        if name not in manager:
            known = [k for k, v in manager.items() if isinstance(v, dict)]
            raise UnknownNameError("controller", name, known, file=file, element="controller_names")
        check_controller(mapping_of(manager[name], file, name), file, name, model)


def check_controller(entry: Data, file: Path, name: str, model: RobotModel) -> None:
    name_of(entry.get("type"), file, f"{name}/type")
    for joint in list_of(entry.get("joints") or [], file, f"{name}/joints"):
        if name_of(joint, file, f"{name}/joints") not in model.joints:
            raise UnknownNameError("joint", joint, model.joints, file=file, element=f"{name}/joints")


def check_sensors_3d(data: Data, file: Path, model: RobotModel) -> None:
    inner = mapping_of(unwrapped(data), file, "top level")
    for i, entry in enumerate(list_of(inner.get("sensors") or [], file, "sensors")):
        if isinstance(entry, str):
            if entry not in inner:
                known = [k for k, v in inner.items() if isinstance(v, dict)]
                raise UnknownNameError("sensor", entry, known, file=file, element="sensors")
            entry = inner[entry]
        mapping_of(entry, file, f"sensors/{i}")


def check_pilz_cartesian_limits(data: Data, file: Path, model: RobotModel) -> None:
    inner = mapping_of(unwrapped(data, "robot_description_planning"), file, "top level")
    limits = mapping_of(inner.get("cartesian_limits"), file, "cartesian_limits")
    for key, value in limits.items():
        number_of(value, file, f"cartesian_limits/{key}")


def type_of(value: Any) -> str:
    kinds = {dict: "a mapping", list: "a list", str: "a text", bool: "true or false", type(None): "empty"}
    return next((name for kind, name in kinds.items() if isinstance(value, kind)), "a number")


CHECKS: dict[str, Callable[[Data, Path, RobotModel], None]] = {
    "joint_limits": check_joint_limits,
    "kinematics": check_kinematics,
    "ompl_planning": check_ompl_planning,
    "controllers": check_controllers,
    "sensors_3d": check_sensors_3d,
    "pilz_cartesian_limits": check_pilz_cartesian_limits,
}
"""Check of each file by its key in `moveit_config.FILES`."""
