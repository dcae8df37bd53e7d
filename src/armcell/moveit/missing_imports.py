"""Names that tutorials use but MoveIt's Python API lacks; armcell accepts them with a hint."""

from __future__ import annotations

import builtins
import keyword

from armcell.ros.schema import Schema

MESSAGES = {"moveit_msgs/PathConstraints": "moveit_msgs/Constraints"}
"""Message type that never existed -> type that tutorials mean."""

METHODS = {"get_last_planning_result": "keep what plan() returns: ok, trajectory, time, code = arm.plan()"}
"""Method that MoveGroupCommander lacks -> code that works with MoveIt."""

CLASSES = {
    "PlanningSceneMonitor": "move_group runs the monitor; its octomap is configured in sensors_3d.yaml"
}
"""Class that moveit_commander lacks -> solution that works with MoveIt."""

MODULES = {
    "np": "import numpy as np",
    "MoveGroupCommander": "from moveit_commander import MoveGroupCommander",
    "PlanningSceneInterface": "from moveit_commander import PlanningSceneInterface",
    "RobotCommander": "from moveit_commander import RobotCommander",
    "PlanningSceneMonitor": "from moveit_commander import PlanningSceneMonitor",
    "quaternion_from_euler": "from tf.transformations import quaternion_from_euler",
    "SimpleActionClient": "from actionlib import SimpleActionClient",
    **{name: f"import {name}" for name in (
        "actionlib", "copy", "math", "moveit_commander", "numpy", "os", "rospy", "sys", "tf", "tf2_ros",
        "threading", "time",
    )},
}  # fmt: skip
PREFERRED = ("geometry_msgs", "moveit_msgs", "sensor_msgs", "trajectory_msgs", "std_msgs", "control_msgs")


def missing_import(name: str, schema: Schema) -> str:
    """Return the import statement that a script copied from a tutorial needs for a name.
    The text is empty for an unknown name.
    """
    if keyword.iskeyword(name) or hasattr(builtins, name):
        return ""
    if name in MODULES:
        return MODULES[name]
    for kind, known in (("srv", schema.services), ("msg", (*schema.messages, *MESSAGES))):
        found = [full.split("/")[0] for full in known if full.split("/")[1] == name]
        if found:
            package = min(found, key=lambda p: PREFERRED.index(p) if p in PREFERRED else len(PREFERRED))
            return f"from {package}.{kind} import {name}"
    return ""
