"""MoveIt configuration packages: reader and writer of the SRDF and of config/*.yaml."""

from __future__ import annotations

import logging
import math
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.model.assets import resolve_uri
from armcell.model.command_line_options import assignments
from armcell.model.robot import RobotModel
from armcell.model.setup.defaults import ACCELERATION, VELOCITY
from armcell.model.setup.folder import write_folder, yaml_text
from armcell.model.setup.launch import launch_files
from armcell.model.srdf import Element, parse_srdf, srdf_text, with_srdf_text
from armcell.model.untrusted_files import parse_xml, read_yaml
from armcell.model.urdf import parse_urdf, urdf_text
from armcell.model.urdf_writer import find_meshes, xml_text

logger = logging.getLogger(__name__)

Data = dict[str, Any]

# Key: (possible file names, of which the first that exists is read; whether MoveIt requires the file).
FILES: dict[str, tuple[tuple[str, ...], bool]] = {
    "joint_limits": (("joint_limits.yaml",), False),
    "kinematics": (("kinematics.yaml",), True),
    "ompl_planning": (("ompl_planning.yaml",), False),
    "controllers": (
        (
            "moveit_controllers.yaml",
            "simple_moveit_controllers.yaml",
            "ros_controllers.yaml",
            "controllers.yaml",
        ),
        False,
    ),
    "sensors_3d": (("sensors_3d.yaml",), False),
    "pilz_cartesian_limits": (("pilz_cartesian_limits.yaml", "cartesian_limits.yaml"), False),
}  # fmt: skip
SETUP_FILE = ".setup_assistant"

PACKAGE_XML = """<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.1.0</version>
  <description>MoveIt configuration, written by armcell setup</description>
  <maintainer email="nobody@localhost">nobody</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <exec_depend>moveit_configs_utils</exec_depend>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""
CMAKE_LISTS = """cmake_minimum_required(VERSION 3.22)
project({name})
find_package(ament_cmake REQUIRED)
ament_package()
install(DIRECTORY config launch DESTINATION share/${{PROJECT_NAME}})
install(FILES .setup_assistant DESTINATION share/${{PROJECT_NAME}})
"""


@dataclass(frozen=True, eq=False)
class MoveItConfig:
    """Content of a MoveIt configuration package, and the robot model that it describes.

    Attributes:
        folder: the package's folder.
        model: the robot with groups, end effectors, named states, disabled pairs and limits applied.
        srdf: the SRDF's complete <robot> element.
        urdf_text: the URDF, with xacro expanded and full paths of meshes beside it.
        files: content of the YAML files that exist, by their key in `FILES`.
        names: file names by the same keys, and by "srdf" and "urdf".
    """

    folder: Path
    model: RobotModel
    srdf: Element
    urdf_text: str
    files: Mapping[str, Data] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def load(
        folder: str | Path,
        urdf: str | Path | None = None,
        allow_env: bool | None = None,
        xacro_args: Mapping[str, str] | None = None,
    ) -> MoveItConfig:
        """Read a MoveIt configuration package from its folder.

        Args:
            folder: the package's folder.
            urdf: the URDF or xacro file; by default the file that `.setup_assistant` names, or else the first
                one in config/ or urdf/.
            allow_env: whether xacro files may read environment variables, see `expand_xacro`.
            xacro_args: values for the URDF's xacro arguments; they replace those of `.setup_assistant`.
        Raises:
            InputError: a file is missing, a name does not exist in the robot, or a value has the wrong type;
                the message names the file and key.
        """
        if not isinstance(xacro_args, Mapping | None):
            raise InputError(f"xacro_args is {xacro_args!r}, a mapping is needed", hint="{name: value}")
        reader = _Reader(Path(folder), allow_env, xacro_args)
        return reader.read(None if urdf is None else Path(urdf))

    # --- settings for planners and controllers ---
    @property
    def planner_configs(self) -> dict[str, dict[str, Any]]:
        """Return the OMPL planners in a MoveIt configuration by name, each with its `type` and parameters.

        Numeric strings are converted to numbers.
        """
        found = self._ompl().get("planner_configs") or {}
        return {name: {k: _number(v) for k, v in entry.items()} for name, entry in found.items()}

    @property
    def group_planning(self) -> dict[str, dict[str, Any]]:
        """Return the OMPL settings of each planning group in a MoveIt configuration."""
        return {
            group: {k: _number(v) for k, v in entry.items()}
            for group, entry in self._ompl().items()
            if group in self.model.groups and isinstance(entry, dict)
        }

    @property
    def controllers(self) -> dict[str, dict[str, Any]]:
        """Return the controllers in a MoveIt configuration,
        each with `type`, `action_ns`, `default` and `joints`.
        """
        return _controllers(_unwrapped(self.files.get("controllers", {})))

    @property
    def kinematics(self) -> Data:
        """Return a MoveIt configuration's settings for inverse kinematics (kinematics.yaml), by group."""
        return _unwrapped(self.files.get("kinematics", {}), "robot_description_kinematics")

    @property
    def cartesian_limits(self) -> dict[str, float]:
        """Return the Cartesian limits that a MoveIt configuration sets for Pilz's planners LIN and CIRC.

        The keys are those of pilz_cartesian_limits.yaml.
        """
        data = _unwrapped(self.files.get("pilz_cartesian_limits", {}), "robot_description_planning")
        return {key: float(value) for key, value in data.get("cartesian_limits", {}).items()}

    def _ompl(self) -> Data:
        return _unwrapped(self.files.get("ompl_planning", {}), "ompl")

    # --- writing ---
    def texts(self, package: str) -> dict[str, str]:
        """Return the files of the MoveIt configuration package as text, by their path in the package.

        Args:
            package: name of the ROS package.
        """
        texts = {f"config/{self.names['srdf']}": srdf_text(self.srdf)}
        texts[f"config/{self.names['urdf']}"] = self.urdf_text
        for key, data in self.files.items():
            texts[f"config/{self.names[key]}"] = yaml_text(data)
        texts |= package_files(package, self.names["urdf"], self.names["srdf"])
        texts |= launch_files(package, self.model.name, self.names, self.controllers)
        return texts

    def write(self, folder: str | Path, force: bool = False) -> None:
        """Write the MoveIt configuration package to a folder atomically.

        The folder's name becomes the package name. config/ also contains the URDF, with xacro expanded.

        Raises:
            InputError: see `check_folder`.
        """
        write_folder(Path(folder), self.texts(Path(folder).resolve().name), force)


def package_files(package: str, urdf: str, srdf: str) -> dict[str, str]:
    """Return package.xml and other files that turn a MoveIt configuration into a ROS 2 package.

    With these files (`.setup_assistant`, package.xml and CMakeLists.txt), MoveItConfigsBuilder finds the
    package's configuration.

    Args:
        package: name of the ROS package.
        urdf, srdf: file names in config/.
    Returns:
        Text by path relative to the package's folder.
    """
    where = {
        "urdf": {"package": package, "relative_path": f"config/{urdf}"},
        "srdf": {"relative_path": f"config/{srdf}"},
    }
    return {
        SETUP_FILE: yaml_text({"moveit_setup_assistant_config": where}),
        "package.xml": PACKAGE_XML.format(name=package),
        "CMakeLists.txt": CMAKE_LISTS.format(name=package),
    }


def is_moveit_config(folder: Path) -> bool:
    """Return whether a folder is a MoveIt configuration, which contains `config/*.srdf*` or
    `.setup_assistant`.
    """
    return any((folder / "config").glob("*.srdf*")) or (folder / SETUP_FILE).is_file()


def _unwrapped(data: Data, *inner: str) -> Data:
    """Return the ROS parameters in a MoveIt configuration's file, without node names and namespaces.

    ROS 2 files wrap parameters in a node name, `ros__parameters` and possibly a namespace in `inner`.
    """
    while isinstance(data, dict) and len(data) == 1:
        key = next(iter(data))
        if key not in ("/**", "/move_group", "move_group", "ros__parameters", *inner):
            break
        data = data[key]
    return data


def _number(value: Any) -> Any:
    """Convert a numeric string of a MoveIt configuration to a float; leave other values unchanged.

    YAML 1.1 parses a number such as 10e-10 as a string.
    """
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value


def _controllers(data: Data) -> dict[str, dict[str, Any]]:
    manager = data.get("moveit_simple_controller_manager", data)
    if isinstance(manager.get("controller_list"), list):
        return {
            entry["name"] or entry["action_ns"]: {k: v for k, v in entry.items() if k != "name"}
            for entry in manager["controller_list"]
        }
    return {name: manager[name] for name in manager.get("controller_names") or []}


def load_ompl_planning(file: Path, model: RobotModel) -> Data:
    """Read the OMPL settings from ompl_planning.yaml of a MoveIt configuration (ROS 1 or 2), for
    `PlanRequest.planner_configs`.

    Raises:
        InputError: a group's planner configuration does not exist or a value has the wrong type; the message
            names the file and key.
    """
    data = read_yaml(file, ros=True)
    _Reader(file.parent.parent).check_ompl_planning(data, file, model)
    return _unwrapped(data, "ompl")


class _Reader:
    """Reader for one MoveIt configuration package. Its error messages contain the file and the key."""

    def __init__(
        self, folder: Path, allow_env: bool | None = None, xacro_args: Mapping[str, str] | None = None
    ):
        self.folder, self.allow_env, self.xacro_args = folder, allow_env, dict(xacro_args or {})
        self.config = folder / "config"

    def read(self, urdf: Path | None) -> MoveItConfig:
        if not os.path.isdir(self.folder):
            raise InputError("no such folder", file=self.folder, hint="give a MoveIt configuration package")
        if not self.config.is_dir():
            raise InputError("has no folder config/", file=self.folder, hint="is this a MoveIt package?")
        setup = self.setup()
        urdf_file = urdf or self.urdf(setup)
        urdf_text = self.text(urdf_file, {**self.own_xacro_args(setup), **self.xacro_args})
        model = parse_urdf(urdf_text, urdf_file)
        srdf_file = self.srdf(setup)
        srdf = self.text(srdf_file)
        model = with_srdf_text(model, srdf, srdf_file)
        names = {
            "srdf": srdf_file.name.removesuffix(".xacro"),
            "urdf": urdf_file.name.removesuffix(".xacro"),
        }
        files: dict[str, Data] = {}
        for key, (choices, needed) in FILES.items():
            file = next((self.config / c for c in choices if (self.config / c).is_file()), None)
            if file is None:
                if needed:
                    missing = self.config / choices[0]
                    raise InputError("file not found", file=missing, hint="MoveIt's packages have one")
                continue
            files[key] = read_yaml(file, ros=True)
            names[key] = file.name
            getattr(self, f"check_{key}")(files[key], file, model)
        if "joint_limits" not in files:
            files["joint_limits"], names["joint_limits"] = {"joint_limits": {}}, "joint_limits.yaml"
            logger.warning(
                "%s: has no joint_limits.yaml: velocities are the URDF's, accelerations MoveIt's default of "
                "%g rad/s^2 or m/s^2",
                self.config, ACCELERATION,
            )  # fmt: skip
        model = self.limited(model, files["joint_limits"], self.config / names["joint_limits"])
        urdf_text = _with_full_paths(urdf_text, urdf_file)
        return MoveItConfig(self.folder, model, parse_srdf(srdf, srdf_file), urdf_text, files, names)

    # --- URDF and SRDF ---
    def setup(self) -> Data:
        file = self.folder / SETUP_FILE
        if not file.is_file():
            return {}
        data = read_yaml(file, ros=True).get("moveit_setup_assistant_config")
        return self.mapping(data, file, "moveit_setup_assistant_config")

    def urdf(self, setup: Data) -> Path:
        file = self.folder / SETUP_FILE
        entry = setup.get("urdf", setup.get("URDF"))
        if entry is not None:
            entry = self.mapping(entry, file, "urdf")
            package, path = entry.get("package") or "", entry.get("relative_path")
            if isinstance(path, str) and path:
                inside = self.folder / path
                if inside.is_file():
                    return inside
                if package:
                    try:
                        return resolve_uri(f"package://{package}/{path}", self.folder)
                    except InputError as error:
                        raise InputError(error.reason, file=file, element="urdf", hint=error.hint) from None
                raise InputError("file not found", file=inside, hint=f"named by {SETUP_FILE}")
        found = [
            f
            for p in ("*.urdf", "*.urdf.xacro")
            for d in ("config", "urdf")
            for f in self.folder.glob(f"{d}/{p}")
        ]
        if not found:
            raise InputError(
                f"no *.urdf or *.urdf.xacro in config/ or urdf/, and no {SETUP_FILE} that names one",
                file=self.folder,
                hint="give the URDF beside the folder",
            )
        return sorted(found)[0]

    def srdf(self, setup: Data) -> Path:
        entry = setup.get("srdf", setup.get("SRDF"))
        found = sorted(self.config.glob("*.srdf")) or sorted(self.config.glob("*.srdf.xacro"))
        if isinstance(entry, dict) and isinstance(entry.get("relative_path"), str):
            file = self.folder / entry["relative_path"]
            if file.is_file():
                return file
            if len(found) != 1:
                raise InputError("file not found", file=file, hint=f"named by {SETUP_FILE}")
            logger.warning("%s: names %s, which does not exist; %s is read", SETUP_FILE, file, found[0])
        if not found:
            raise InputError(
                "no *.srdf in it", file=self.config, hint="make one with armcell setup ROBOT.urdf -o FOLDER"
            )
        return found[0]

    def text(self, file: Path, xacro_args: dict[str, str] | None = None) -> str:
        return urdf_text(file, self.allow_env, self.folder, xacro_args)

    def own_xacro_args(self, setup: Data) -> dict[str, str]:
        """Return the xacro arguments that MoveIt's Setup Assistant stored in a MoveIt configuration.

        The text has the form `a:=1 b:=2`.
        """
        entry = setup.get("urdf", setup.get("URDF"))
        words = entry.get("xacro_args") if isinstance(entry, dict) else None
        if not words:
            return {}
        file = self.folder / SETUP_FILE
        try:
            own = [
                word for word in shlex.split(str(words)) if not word.startswith("--")
            ]  # --inorder: of xacro
            return assignments(own, ":=", "xacro argument")
        except (InputError, ValueError) as error:
            raise InputError(str(error), file=file, element="urdf/xacro_args") from None

    # --- type checks ---
    def mapping(self, value: Any, file: Path, key: str) -> Data:
        if not isinstance(value, dict):
            raise InputError(f"is {_type(value)}, a mapping is needed", file=file, element=key)
        return value

    def sequence(self, value: Any, file: Path, key: str) -> list[Any]:
        if not isinstance(value, list):
            raise InputError(f"is {_type(value)}, a list is needed", file=file, element=key)
        return value

    def number(self, value: Any, file: Path, key: str) -> float:
        value = _number(value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"is {_type(value)} ({value!r}), a number is needed", file=file, element=key)
        if not math.isfinite(value):
            raise InputError(f"is {value}, a finite number is needed", file=file, element=key)
        return float(value)

    def word(self, value: Any, file: Path, key: str) -> str:
        if not isinstance(value, str) or not value:
            raise InputError(f"is {_type(value)}, a name is needed", file=file, element=key)
        return value

    def known_group(self, name: str, file: Path, model: RobotModel) -> bool:
        """Return whether the SRDF of a MoveIt configuration defines a group. If not, log a warning.

        Like MoveIt, armcell ignores settings of undefined groups.
        """
        if name not in model.groups:
            known = ", ".join(sorted(model.groups))
            logger.warning("%s: planning group %r is not in the SRDF (it has %s)", file, name, known)
        return name in model.groups

    # --- each file ---
    def check_joint_limits(self, data: Data, file: Path, model: RobotModel) -> None:
        for name, entry in self.limits(data, file).items():
            if name not in model.joints:
                raise UnknownNameError("joint", name, model.joints, file=file, element="joint_limits")
            for key, value in self.mapping(entry, file, f"joint_limits/{name}").items():
                place = f"joint_limits/{name}/{key}"
                if key.startswith("has_") or key == "angle_wraparound":
                    if not isinstance(value, bool):
                        raise InputError(
                            f"is {_type(value)}, true or false is needed", file=file, element=place
                        )
                else:
                    self.number(value, file, place)

    def limits(self, data: Data, file: Path) -> Data:
        inner = _unwrapped(data, "robot_description_planning")
        if "joint_limits" not in self.mapping(inner, file, "robot_description_planning"):
            raise InputError("has no mapping 'joint_limits'", file=file)
        return self.mapping(inner["joint_limits"] or {}, file, "joint_limits")

    def limited(self, model: RobotModel, data: Data, file: Path) -> RobotModel:
        """Return the robot of a MoveIt configuration. Where joint_limits.yaml has tighter limits, they apply.

        A wider velocity, acceleration or jerk limit is ignored with a warning. Joints without any velocity or
        acceleration limit get MoveIt's defaults.
        """
        joints = dict(model.joints)
        for name, entry in self.limits(data, file).items():
            limits = joints[name].limits
            for kind, attribute in (
                ("velocity", "velocity"),
                ("acceleration", "acceleration"),
                ("jerk", "jerk"),
            ):
                value = _number(entry.get(f"max_{kind}"))
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
                low = max(limits.lower, _number(entry.get("min_position", limits.lower)))
                high = min(limits.upper, _number(entry.get("max_position", limits.upper)))
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

    def check_kinematics(self, data: Data, file: Path, model: RobotModel) -> None:
        inner = self.mapping(
            _unwrapped(data, "robot_description_kinematics"), file, "robot_description_kinematics"
        )
        for group, entry in inner.items():
            if not self.known_group(group, file, model):
                continue
            entry = self.mapping(entry, file, group)
            self.word(entry.get("kinematics_solver"), file, f"{group}/kinematics_solver")
            for key in ("kinematics_solver_search_resolution", "kinematics_solver_timeout"):
                if key in entry:
                    self.number(entry[key], file, f"{group}/{key}")

    def check_ompl_planning(self, data: Data, file: Path, model: RobotModel) -> None:
        inner = self.mapping(_unwrapped(data, "ompl"), file, "ompl")
        configs = self.mapping(inner.get("planner_configs") or {}, file, "planner_configs")
        for name, entry in configs.items():
            entry = self.mapping(entry, file, f"planner_configs/{name}")
            self.word(entry.get("type"), file, f"planner_configs/{name}/type")
        for group, entry in inner.items():
            if group == "planner_configs":
                continue
            if not isinstance(entry, dict):
                if group in model.groups:
                    self.mapping(entry, file, group)
                continue  # settings of the pipeline: planning_plugin, request_adapters, ...
            if not self.known_group(group, file, model):
                continue
            listed = self.sequence(entry.get("planner_configs") or [], file, f"{group}/planner_configs")
            for name in (
                *listed,
                *([entry["default_planner_config"]] if "default_planner_config" in entry else []),
            ):
                if self.word(name, file, f"{group}/planner_configs") not in configs:
                    place = f"{group}/planner_configs"
                    raise UnknownNameError("planner config", name, configs, file=file, element=place)
            if "longest_valid_segment_fraction" in entry:
                place = f"{group}/longest_valid_segment_fraction"
                self.number(entry["longest_valid_segment_fraction"], file, place)

    def check_controllers(self, data: Data, file: Path, model: RobotModel) -> None:
        inner = self.mapping(_unwrapped(data), file, "top level")
        manager = self.mapping(
            inner.get("moveit_simple_controller_manager", inner), file, "moveit_simple_controller_manager"
        )
        if "controller_list" in manager:
            for i, entry in enumerate(self.sequence(manager["controller_list"], file, "controller_list")):
                entry = self.mapping(entry, file, f"controller_list/{i}")
                # ROS-Industrial's drivers serve the action without a controller's name.
                name = entry.get("action_ns") if entry.get("name") == "" else entry.get("name")
                self.controller(entry, file, self.word(name, file, f"controller_list/{i}/name"), model)
            return
        for name in self.sequence(manager.get("controller_names") or [], file, "controller_names"):
            name = self.word(name, file, "controller_names")
            if name not in manager:
                known = [k for k, v in manager.items() if isinstance(v, dict)]
                raise UnknownNameError("controller", name, known, file=file, element="controller_names")
            self.controller(self.mapping(manager[name], file, name), file, name, model)

    def controller(self, entry: Data, file: Path, name: str, model: RobotModel) -> None:
        self.word(entry.get("type"), file, f"{name}/type")
        for joint in self.sequence(entry.get("joints") or [], file, f"{name}/joints"):
            if self.word(joint, file, f"{name}/joints") not in model.joints:
                raise UnknownNameError("joint", joint, model.joints, file=file, element=f"{name}/joints")

    def check_sensors_3d(self, data: Data, file: Path, model: RobotModel) -> None:
        inner = self.mapping(_unwrapped(data), file, "top level")
        for i, entry in enumerate(self.sequence(inner.get("sensors") or [], file, "sensors")):
            if isinstance(entry, str):
                if entry not in inner:
                    known = [k for k, v in inner.items() if isinstance(v, dict)]
                    raise UnknownNameError("sensor", entry, known, file=file, element="sensors")
                entry = inner[entry]
            self.mapping(entry, file, f"sensors/{i}")

    def check_pilz_cartesian_limits(self, data: Data, file: Path, model: RobotModel) -> None:
        inner = self.mapping(_unwrapped(data, "robot_description_planning"), file, "top level")
        limits = self.mapping(inner.get("cartesian_limits"), file, "cartesian_limits")
        for key, value in limits.items():
            self.number(value, file, f"cartesian_limits/{key}")


def _with_full_paths(text: str, file: Path) -> str:
    """Return the URDF text of a MoveIt configuration,
    with absolute paths for meshes in the folder of the URDF.
    """
    root = parse_xml(text, file)
    find_meshes(root, file.resolve().parent)
    return xml_text(root)


def _type(value: Any) -> str:
    kinds = {dict: "a mapping", list: "a list", str: "a text", bool: "true or false", type(None): "empty"}
    return next((name for kind, name in kinds.items() if isinstance(value, kind)), "a number")
