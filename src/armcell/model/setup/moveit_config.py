"""MoveIt configuration packages: reader and writer of the SRDF and of config/*.yaml."""

from __future__ import annotations

import logging
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from armcell.core import InputError
from armcell.model.assets import resolve_uri
from armcell.model.command_line_options import assignments
from armcell.model.robot import RobotModel
from armcell.model.setup.defaults import ACCELERATION
from armcell.model.setup.folder import write_folder, yaml_text
from armcell.model.setup.launch import launch_files
from armcell.model.setup.moveit_files import (
    CHECKS,
    Data,
    check_ompl_planning,
    mapping_of,
    to_number,
    unwrapped,
    with_joint_limits,
)
from armcell.model.srdf import Element, parse_srdf, srdf_text, with_srdf_text
from armcell.model.untrusted_files import parse_xml, read_yaml
from armcell.model.urdf import parse_urdf, urdf_text
from armcell.model.urdf_writer import find_meshes, xml_text

logger = logging.getLogger(__name__)

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
        return {name: {k: to_number(v) for k, v in entry.items()} for name, entry in found.items()}

    @property
    def group_planning(self) -> dict[str, dict[str, Any]]:
        """Return the OMPL settings of each planning group in a MoveIt configuration."""
        return {
            group: {k: to_number(v) for k, v in entry.items()}
            for group, entry in self._ompl().items()
            if group in self.model.groups and isinstance(entry, dict)
        }

    @property
    def controllers(self) -> dict[str, dict[str, Any]]:
        """Return the controllers in a MoveIt configuration,
        each with `type`, `action_ns`, `default` and `joints`.
        """
        return _controllers(unwrapped(self.files.get("controllers", {})))

    @property
    def kinematics(self) -> Data:
        """Return a MoveIt configuration's settings for inverse kinematics (kinematics.yaml), by group."""
        return unwrapped(self.files.get("kinematics", {}), "robot_description_kinematics")

    @property
    def cartesian_limits(self) -> dict[str, float]:
        """Return the Cartesian limits that a MoveIt configuration sets for Pilz's planners LIN and CIRC.

        The keys are those of pilz_cartesian_limits.yaml.
        """
        data = unwrapped(self.files.get("pilz_cartesian_limits", {}), "robot_description_planning")
        return {key: float(value) for key, value in data.get("cartesian_limits", {}).items()}

    def _ompl(self) -> Data:
        return unwrapped(self.files.get("ompl_planning", {}), "ompl")

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
    return any((folder / "config").glob("*.srdf*")) or os.path.isfile(folder / SETUP_FILE)


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
    check_ompl_planning(data, file, model)
    return unwrapped(data, "ompl")


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
        if not os.path.isdir(self.config):
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
            file = next((self.config / c for c in choices if os.path.isfile(self.config / c)), None)
            if file is None:
                if needed:
                    missing = self.config / choices[0]
                    raise InputError("file not found", file=missing, hint="MoveIt's packages have one")
                continue
            files[key] = read_yaml(file, ros=True)
            names[key] = file.name
            CHECKS[key](files[key], file, model)
        if "joint_limits" not in files:
            files["joint_limits"], names["joint_limits"] = {"joint_limits": {}}, "joint_limits.yaml"
            logger.warning(
                "%s: has no joint_limits.yaml: velocities are the URDF's, accelerations MoveIt's default of "
                "%g rad/s^2 or m/s^2",
                self.config, ACCELERATION,
            )  # fmt: skip
        model = with_joint_limits(model, files["joint_limits"], self.config / names["joint_limits"])
        urdf_text = _with_full_paths(urdf_text, urdf_file)
        return MoveItConfig(self.folder, model, parse_srdf(srdf, srdf_file), urdf_text, files, names)

    # --- URDF and SRDF ---
    def setup(self) -> Data:
        file = self.folder / SETUP_FILE
        if not os.path.isfile(file):
            return {}
        data = read_yaml(file, ros=True).get("moveit_setup_assistant_config")
        return mapping_of(data, file, "moveit_setup_assistant_config")

    def urdf(self, setup: Data) -> Path:
        file = self.folder / SETUP_FILE
        entry = setup.get("urdf", setup.get("URDF"))
        if entry is not None:
            entry = mapping_of(entry, file, "urdf")
            package, path = entry.get("package") or "", entry.get("relative_path")
            if isinstance(path, str) and path:
                inside = self.folder / path
                if os.path.isfile(inside):
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
            if os.path.isfile(file):
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


def _with_full_paths(text: str, file: Path) -> str:
    """Return the URDF text of a MoveIt configuration,
    with absolute paths for meshes in the folder of the URDF.
    """
    root = parse_xml(text, file)
    find_meshes(root, file.resolve().parent)
    return xml_text(root)
