"""Hints at two usual causes of a failed grasp: the tool's direction, and the link that a pose is for."""

from __future__ import annotations

import numpy as np

from armcell.core import SE3, SO3
from armcell.model import Gripper, RobotModel
from armcell.planning import solve_ik
from armcell.scene import PlanningScene

UPWARD = np.cos(np.deg2rad(60.0))  # of the tool's z axis against the world's
AHEAD = 0.25  # [m] along the tool within which an object is the one that the fingers were meant for
ASIDE = 0.03  # [m] of that object from the tool's axis
SAME = 0.04  # [m] between the object's distance and the flange's: the script has set poses of the flange
TURNED = SO3.from_rpy((np.pi, 0.0, 0.0))
DOWN = "quaternion_from_euler(math.pi, 0, yaw) points it down"


def unreached_pose(scene: PlanningScene, group: str, link: str, target: SE3) -> str:
    """Why planning to a pose (of a link, in the world) failed, where its direction or link is the cause.

    Each cause is checked: the pose turned over, or given to the flange, can be reached.
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
    """Why fingers that have closed hold no object."""
    T = scene.frame_pose(gripper.tcp_link)
    found = [(T.inv().apply(o.T_world_object.translation), n) for n, o in scene.objects.items() if o.movable]
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
    """The link that a MoveIt package ends the group at: the one that the gripper is mounted on."""
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
