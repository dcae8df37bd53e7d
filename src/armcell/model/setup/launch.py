"""ROS launch files and a short guide for a generated MoveIt configuration package."""

from __future__ import annotations

import html
from collections.abc import Mapping
from functools import partial
from typing import Any

from armcell.model.setup.folder import yaml_text

escape = partial(html.escape, quote=False)  # xml.sax.saxutils imports urllib, http and ssl
GUIDE = "LAUNCH.md"

ROS2 = '''"""ROS 2: ros2 launch {package} move_group.launch.py"""

from launch import LaunchDescription
from moveit_configs_utils import MoveItConfigsBuilder
from moveit_configs_utils.launches import generate_move_group_launch, generate_rsp_launch


def generate_launch_description():
    config = MoveItConfigsBuilder("{robot}", package_name="{package}").to_moveit_configs()
    parts = (generate_rsp_launch(config), generate_move_group_launch(config))
    return LaunchDescription([entity for part in parts for entity in part.entities])
'''

ROS1 = """<launch>
  <!-- ROS 1: roslaunch launch/move_group.launch -->
  <arg name="config" default="$(dirname)/../config"/>
  <param name="robot_description" textfile="$(arg config)/{urdf}"/>
  <param name="robot_description_semantic" textfile="$(arg config)/{srdf}"/>
{files}  <node name="robot_state_publisher" pkg="robot_state_publisher" type="robot_state_publisher"/>
  <node name="move_group" pkg="moveit_ros_move_group" type="move_group" output="screen">
    <param name="default_planning_pipeline" value="ompl"/>
    <param name="planning_pipelines/ompl/planning_plugin" value="ompl_interface/OMPLPlanner"/>
    <param name="planning_pipelines/ompl/request_adapters" value="{adapters}"/>
{pipelines}    <rosparam>
{controllers}    </rosparam>
  </node>
</launch>
"""
NO_CONTROLLER = "- none: the robot has no arm\n"
ADAPTERS = " ".join(
    f"default_planner_request_adapters/{name}"
    for name in (
        "AddTimeParameterization", "ResolveConstraintFrames", "FixWorkspaceBounds", "FixStartStateBounds",
        "FixStartStateCollision", "FixStartStatePathConstraints",
    )
)  # fmt: skip
LOADED = {"joint_limits": "robot_description_planning", "kinematics": "robot_description_kinematics"}
"""ROS 1 parameter namespace of each configuration file, by key of `moveit_config.FILES`."""

TEXT = """# Go on in ROS

This folder is a MoveIt configuration package: `config/` has the URDF, SRDF, limits, kinematics, planners and
controllers of `{robot}`.

ROS 2 (the package is found after a build):

    mkdir -p ~/ws/src && ln -s "$(pwd)" ~/ws/src/{package}
    cd ~/ws && colcon build --packages-select {package} && . install/setup.sh
    ros2 launch {package} move_group.launch.py

ROS 1 Noetic (no build needed):

    roslaunch launch/move_group.launch

MoveIt executes on these controllers, which your driver or simulator must offer:

{controllers}
Without MoveIt, armcell offers the same interfaces of move_group and the controllers, with no ROS installed:

    armcell serve . --ros2
    armcell serve . --ros1
"""


def launch_files(
    package: str, robot: str, names: Mapping[str, str], controllers: Mapping[str, Mapping[str, Any]]
) -> dict[str, str]:
    """Return launch files for ROS 1 and ROS 2 for a MoveIt configuration package, and a guide to them.

    The result maps paths in the package to texts.

    Args:
        package: name of the ROS package.
        robot: name of the robot.
        names: file names in config/, by "urdf", "srdf" and the keys of `moveit_config.FILES`.
        controllers: controllers by name, each with `type`, `action_ns`, `default` and `joints`.
    """
    loads = "".join(
        f'  <rosparam ns="{space}" command="load" file="$(arg config)/{escape(names[key])}"/>\n'
        for key, space in LOADED.items()
        if key in names
    )
    pipelines = ""
    if "ompl_planning" in names:
        file = f"$(arg config)/{escape(names['ompl_planning'])}"
        pipelines = f'    <rosparam ns="planning_pipelines/ompl" command="load" file="{file}"/>\n'
    manager = {
        "moveit_controller_manager": "moveit_simple_controller_manager/MoveItSimpleControllerManager",
        "controller_list": [{"name": name, **entry} for name, entry in controllers.items()],
    }
    listed = "".join(
        f"- `{name}/{entry.get('action_ns', '')}` ({entry.get('type')}): "
        f"{', '.join(entry.get('joints') or [])}\n"
        for name, entry in controllers.items()
    )
    return {
        "launch/move_group.launch": ROS1.format(
            urdf=escape(names["urdf"]), srdf=escape(names["srdf"]), files=loads, adapters=ADAPTERS,
            pipelines=pipelines, controllers=escape(yaml_text(manager)),
        ),
        "launch/move_group.launch.py": ROS2.format(package=package, robot=robot),
        GUIDE: TEXT.format(package=package, robot=robot, controllers=listed or NO_CONTROLLER),
    }  # fmt: skip
