"""Motion targets of a group: joint values, poses and named states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from armcell.core import ArmcellError, InputError
from armcell.moveit.commander_calls import measured_scene
from armcell.moveit.shims.moveit_commander.conversions import list_to_pose, pose_to_list
from armcell.moveit.shims.moveit_commander.exception import MoveItCommanderException
from armcell.moveit.shims.moveit_commander.group_info import (
    JOINT,
    ORIENTATION,
    POSE,
    POSITION,
    GroupInfo,
    kind_of,
)
from armcell.moveit.shims.transformations import euler_from_quaternion, quaternion_from_euler
from armcell.planning import solve_ik
from armcell.ros.convert import pose_from_message
from armcell.ros.moveit_convert.objects import frame_of
from armcell.scene import WORLD


class GroupTargets(GroupInfo):
    """Methods of a moveit_commander group that set its target: joint values, poses or named states."""

    # --- targets ---
    def get_joint_value_target(self) -> list[float]:
        """Return the joint positions of the target in moveit_commander, including mimic joints.

        Joints without a target keep their current positions.
        """
        return self._every_value(self._joint_target)

    def set_joint_value_target(self, arg1: Any, arg2: Any = None, arg3: Any = None) -> bool:
        """Set the joint target in moveit_commander and return True. An invalid target raises an exception.

        MoveIt returns None, but tutorials test the result.
        """
        kind = kind_of(arg1)
        if kind == "RobotState":
            self._set_joints(
                dict(zip(arg1.joint_state.name, arg1.joint_state.position)), "state", others=True
            )
        elif kind == "JointState":
            self._no_more(arg2, arg3)
            self._set_joints(dict(zip(arg1.name, arg1.position)))
        elif isinstance(arg1, str):
            if arg2 is None:
                raise MoveItCommanderException("Joint value expected when joint name specified")
            if arg3 is not None:
                raise MoveItCommanderException("Too many arguments specified")
            self._set_joints({arg1: arg2})
        elif kind in ("Pose", "PoseStamped"):
            self._set_joints_by_ik(arg1, arg2, arg3)
        elif isinstance(arg1, Mapping):
            self._no_more(arg2, arg3)
            self._set_joints(dict(arg1))
        elif isinstance(arg1, Iterable):
            self._no_more(arg2, arg3)
            self._set_joints(self._by_name(list(arg1)))
        else:
            raise MoveItCommanderException(f"Unsupported argument of type {type(arg1)}")
        return True

    @staticmethod
    def _no_more(*arguments: Any) -> None:
        if any(a is not None for a in arguments):
            raise MoveItCommanderException("Too many arguments specified")

    def _by_name(self, values: list[Any]) -> dict[str, float]:
        for names in (list(self._group.joint_names), self._variables()):
            if len(names) == len(values):
                return dict(zip(names, values))
        raise MoveItCommanderException(
            f"Error setting joint target. {len(values)} values given, group {self._name!r} has "
            f"{len(self._group.joint_names)} joints: {', '.join(self._group.joint_names)}"
        )

    def _set_joints(self, values: dict[str, Any], what: str = "joint", others: bool = False) -> None:
        model = self._session.model
        target: dict[str, float] = {}
        for name, value in values.items():
            if name not in model.joints:
                raise MoveItCommanderException(f"Error setting joint target. There is no joint {name!r}")
            if name not in self._group.joint_names:
                if others or model.joints[name].mimic is not None:
                    continue
                raise MoveItCommanderException(
                    f"Error setting joint target. Group {self._name!r} does not move joint {name!r}"
                )
            limits, number = model.joints[name].limits, float(value)
            out = not limits.lower - self._joint_tolerance <= number <= limits.upper + self._joint_tolerance
            if out or not np.isfinite(number):
                degrees = "; are these degrees?" if abs(number) > 2 * np.pi + 0.01 else ""
                raise MoveItCommanderException(
                    f"Error setting {what} target. Is the target within bounds? {name} = {number:g} is "
                    f"outside [{limits.lower:g}, {limits.upper:g}]{degrees}"
                )
            target[name] = number
        self._joint_target.update(target)
        self._active = JOINT

    def _set_joints_by_ik(self, pose: Any, arg2: Any, arg3: Any) -> None:
        link, approximate = "", False
        for argument in (arg2, arg3):
            if isinstance(argument, bool):
                approximate = argument
            elif isinstance(argument, str):
                link = argument
            elif argument is not None:
                raise MoveItCommanderException("Unexpected type")
        link = self._link(link, "set the pose for")
        scene = measured_scene()
        try:
            result = solve_ik(scene, self._name, self._in_world(scene, self._stamped(pose)), link)
        except ArmcellError as error:
            raise MoveItCommanderException(f"Error setting joint target. {error}") from None
        if result.positions is None or not (result.ok or approximate):
            raise MoveItCommanderException(
                f"Error setting joint target. Is the IK solver functional? {result.message}"
            )
        self._set_joints(dict(zip(self._group.joint_names, result.positions.tolist())))

    def _in_world(self, scene: Any, stamped: Any) -> Any:
        return scene.frame_pose(frame_of(stamped.header)) @ pose_from_message(stamped.pose)

    def _stamped(self, pose: Any) -> Any:
        """Convert a moveit_commander target (Pose, PoseStamped or list) to a new PoseStamped.

        The copy is independent of the caller's object, which the script may change later.
        """
        local = self._session.messages.local
        if kind_of(pose) == "PoseStamped":
            own = local(pose)
            own.header.frame_id = own.header.frame_id or self._frame
            return own
        if kind_of(pose) == "Pose":
            own = self._session.new("geometry_msgs/PoseStamped", pose=local(pose))
        else:
            own = self._session.new("geometry_msgs/PoseStamped", pose=list_to_pose(pose))
        own.header.frame_id = self._frame
        return own

    def _target(self, end_effector_link: str, active: str, poses: list[Any]) -> None:
        link = self._link(end_effector_link, "set the pose for")
        self._poses[link] = poses
        self._active = active

    def set_rpy_target(self, rpy: Any, end_effector_link: str = "") -> None:
        if len(rpy) != 3:
            raise MoveItCommanderException("Expected [roll, pitch, yaw]")
        self.set_orientation_target(quaternion_from_euler(*map(float, rpy)).tolist(), end_effector_link)

    def set_orientation_target(self, q: Any, end_effector_link: str = "") -> None:
        link = self._link(end_effector_link, "set the pose for")
        if len(q) != 4:
            raise MoveItCommanderException("Expected [qx, qy, qz, qw]")
        before = self._last(link)
        self._target(link, ORIENTATION, [self._stamped([*before[:3], *q])])

    def set_position_target(self, xyz: Any, end_effector_link: str = "") -> None:
        link = self._link(end_effector_link, "set the pose for")
        if len(xyz) != 3:
            raise MoveItCommanderException("Unable to set position target")
        self._target(link, POSITION, [self._stamped([*map(float, xyz), *self._last(link)[3:]])])

    def _last(self, link: str) -> list[float]:
        """Return the last pose target of a link in moveit_commander.
        If there is no target, return the current pose of the link.
        """
        if self._poses.get(link):
            return pose_to_list(self._poses[link][0].pose)
        return pose_to_list(self.get_current_pose(link).pose)

    def set_pose_target(self, pose: Any, end_effector_link: str = "") -> None:
        self._link(end_effector_link, "set the pose for")
        try:
            self._target(end_effector_link, POSE, [self._stamped(pose)])
        except (TypeError, ValueError, InputError):
            raise MoveItCommanderException("Unable to set target pose") from None

    def set_pose_targets(self, poses: Any, end_effector_link: str = "") -> None:
        """Set several alternative pose targets in moveit_commander. The planner chooses one of them."""
        self._link(end_effector_link, "set the pose for")
        try:
            self._target(end_effector_link, POSE, [self._stamped(p) for p in poses])
        except (TypeError, ValueError, InputError):
            raise MoveItCommanderException("Unable to set target poses") from None

    def shift_pose_target(self, axis: int, value: float, end_effector_link: str = "") -> None:
        """Set the pose target in moveit_commander to the current pose,
        moved along an axis or rotated about an axis.

        Args:
            axis: 0 to 2 shift along x, y, z; 3 to 5 change roll, pitch, yaw.
            value: shift [m] or change of the angle [rad].
        """
        link = self._link(end_effector_link, "set the pose for")
        if axis not in range(6):
            raise MoveItCommanderException(
                "An integer value between 0 and 5 expected as the axis of the shift"
            )
        pose = pose_to_list(self.get_current_pose(link).pose)
        if axis > 2:
            pose = [*pose[:3], *euler_from_quaternion(pose[3:])]
        pose[axis] += value
        self._frame_then(WORLD, lambda: self.set_pose_target(pose, link))

    def _frame_then(self, frame: str, act: Any) -> None:
        before, self._frame = self._frame, frame
        try:
            act()
        finally:
            self._frame = before

    def clear_pose_target(self, end_effector_link: str) -> None:
        self._poses.pop(end_effector_link or self._eef, None)

    def clear_pose_targets(self) -> None:
        self._poses.clear()

    def set_random_target(self) -> None:
        self._set_joints(self._random_positions())

    # --- named ---
    def get_named_targets(self) -> list[str]:
        return [*self._session.model.named_states.get(self._name, {}), *self._remembered]

    def set_named_target(self, name: str) -> None:
        text = f"Unable to set target {name}. Is the target within bounds?"
        if name not in self.get_named_targets():
            known = ", ".join(self.get_named_targets())
            raise MoveItCommanderException(f"{text} It is not known; known: {known}")
        try:
            self._set_joints(self.get_named_target_values(name))
        except MoveItCommanderException as error:
            raise MoveItCommanderException(f"{text} {error}") from None

    def get_named_target_values(self, target: str) -> dict[str, float]:
        """Return the joint positions of a named target in moveit_commander, as a dict from joint name to
        position.

        If the target does not exist, the method logs an error and returns an empty dict.
        """
        if target in self._remembered:
            return self._by_name(self._remembered[target])
        if target not in self.get_named_targets():
            self._session.say(
                "ERROR", f"The requested named target '{target}' does not exist, returning empty positions."
            )
            return {}
        return dict(self._session.model.named_states[self._name][target])

    def remember_joint_values(self, name: str, values: Any = None) -> None:
        self._remembered[name] = (
            self.get_current_joint_values() if values is None else [float(v) for v in values]
        )

    def get_remembered_joint_values(self) -> dict[str, list[float]]:
        return {name: list(values) for name, values in self._remembered.items()}

    def forget_joint_values(self, name: str) -> None:
        self._remembered.pop(name, None)
