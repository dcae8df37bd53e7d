"""Robot setup without a GUI: detect arms and grippers, read and write MoveIt configurations."""

from armcell.model.setup import defaults
from armcell.model.setup.arm_detection import ArmChain, find_chains, with_groups
from armcell.model.setup.folder import check_folder, write_folder, yaml_text
from armcell.model.setup.launch import launch_files
from armcell.model.setup.moveit_config import (
    MoveItConfig,
    is_moveit_config,
    load_ompl_planning,
    package_files,
)
from armcell.model.srdf import parse_srdf, srdf_of, srdf_text
from armcell.model.urdf_writer import UrdfPart, merged_urdf, with_frames_text

__all__ = [
    "ArmChain",
    "MoveItConfig",
    "UrdfPart",
    "check_folder",
    "defaults",
    "find_chains",
    "is_moveit_config",
    "launch_files",
    "load_ompl_planning",
    "merged_urdf",
    "package_files",
    "parse_srdf",
    "srdf_of",
    "srdf_text",
    "with_frames_text",
    "with_groups",
    "write_folder",
    "yaml_text",
]
