"""Hints for authors of scripts: names that MoveIt's Python API lacks, and causes of failed grasps.

Tutorials use these names; armcell accepts them with a hint. The two common causes of failed grasps are a
wrong tool direction and a wrong link.
"""

from __future__ import annotations

import builtins
import keyword

import numpy as np

from armcell.core import SE3, SO3
from armcell.model import Gripper, RobotModel
from armcell.planning import solve_ik
from armcell.ros.schema import Schema
from armcell.scene import PlanningScene

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
UPWARD = np.cos(np.deg2rad(60.0))  # least cosine between the z axes of tool and world for "points up"
AHEAD = 0.25  # [m] distance along the tool within which an object counts as the intended one
ASIDE = 0.03  # [m] largest distance of the intended object from the tool's axis
SAME = 0.04  # [m] difference of object and flange distances that indicates poses of the flange
TURNED = SO3.from_rpy((np.pi, 0.0, 0.0))
DOWN = "quaternion_from_euler(math.pi, 0, yaw) points it down"


def missing_import(name: str, schema: Schema) -> str:
    """Return a hint for a script copied from a tutorial: the import statement that it needs for a name. The
    text is empty for an unknown name.
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


def unreached_pose(scene: PlanningScene, group: str, link: str, target: SE3) -> str:
    """Return a hint that explains why planning to a pose failed, if the tool's direction or the target link
    is the cause.

    The function verifies each cause: IK must succeed for the pose turned over, or for the flange.

    Args:
        link: the link that was to reach the pose.
        target: pose of the link in the world frame.
    Returns:
        A text for the user, or an empty string if the cause is another one.
    """
    if (
        _points_up(target)
        and solve_ik(scene, group, SE3(target.rotation @ TURNED, target.translation), link).ok
    ):
        return f"your tool points up: the z axis of {link} at the target points away from the floor; {DOWN}"
    flange = _flange(scene.model, group)
    if flange and flange != link and solve_ik(scene, group, target, flange).ok:
        return _tip_is_not_flange(scene, link, flange, "the target can be reached by")
    return ""


def closed_on_nothing(scene: PlanningScene, gripper: Gripper) -> str:
    """Return a hint that explains why a closed gripper holds no object. The hint is empty if the scene has no
    movable object.
    """
    T = scene.frame_pose(gripper.tcp_link)
    found = [
        (T.inverse().apply(o.T_world_object.translation), n) for n, o in scene.objects.items() if o.movable
    ]
    if not found:
        return ""
    at, name = min(found, key=lambda item: float(np.linalg.norm(item[0])))
    tcp, away = gripper.tcp_link, float(np.linalg.norm(at)) * 1000
    text = f"{gripper.name} closed on nothing: {name} is {away:.0f} mm from {tcp}"
    flange = _flange(scene.model, gripper.arm_group)
    if _points_up(T):
        return f"{text}, and your tool points up; {DOWN}"
    if flange and np.hypot(at[0], at[1]) < ASIDE and 0 < at[2] < AHEAD:
        length = float(np.linalg.norm(scene.transform(flange, tcp).translation))
        if abs(at[2] - length) < SAME:
            return f"{text}, straight ahead; {_tip_is_not_flange(scene, tcp, flange, 'the poses fit')}"
    return text


def _points_up(T: SE3) -> bool:
    return bool(T.rotation.matrix[2, 2] > UPWARD)


def _flange(model: RobotModel, group: str) -> str:
    """Return the name of the flange, the link on which a group's gripper is mounted, for hints about pose
    targets. Return an empty string if the group has no gripper.

    MoveIt packages usually end the group at this link.
    """
    return next((e.parent_link for e in model.end_effectors.values() if e.parent_group == group), "")


def _tip_is_not_flange(scene: PlanningScene, link: str, flange: str, fits: str) -> str:
    length = float(np.linalg.norm(scene.transform(flange, link).translation))
    package = (
        "panda_moveit_config's is" if flange == "panda_link8" else "many MoveIt packages end the group at"
    )
    return (
        f"your tip is the TCP {link}, {package} {flange}, {length * 1000:.0f} mm behind it; {fits} {flange}: "
        f"set_end_effector_link({flange!r})"
    )
