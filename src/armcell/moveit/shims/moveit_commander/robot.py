"""Shim of moveit_commander.RobotCommander."""

from __future__ import annotations

from typing import Any

from armcell.core import UnknownNameError
from armcell.moveit.commander_calls import measured_scene
from armcell.moveit.session import current_session
from armcell.moveit.shims.moveit_commander.conversions import list_to_pose_stamped
from armcell.moveit.shims.moveit_commander.exception import MoveItCommanderException
from armcell.moveit.shims.moveit_commander.markers import markers
from armcell.moveit.shims.moveit_commander.move_group import MoveGroupCommander
from armcell.ros.moveit_convert import Components
from armcell.scene import WORLD


class RobotCommander:
    """Model and current state of the robot, like moveit_commander.RobotCommander.

    Groups are available by name or as attributes (`robot.arm`).
    """

    class Joint:
        """One joint of the robot."""

        def __init__(self, robot: RobotCommander, name: str):
            self._robot, self._name = robot, name

        def name(self) -> str:
            return self._name

        def variable_count(self) -> int:
            return 1 if current_session().model.joint(self._name).movable else 0

        def bounds(self) -> list[Any]:
            limits = current_session().model.joint(self._name).limits
            return [limits.lower, limits.upper] if self.variable_count() else []

        def min_bound(self) -> Any:
            return self.bounds()[0] if self.variable_count() else []

        def max_bound(self) -> Any:
            return self.bounds()[1] if self.variable_count() else []

        def value(self) -> Any:
            state = self._robot.get_current_state().joint_state
            values = dict(zip(state.name, state.position))
            return values[self._name] if self.variable_count() else []

        def move(self, position: Any, wait: bool = True) -> bool:
            """Move only this joint to a position, as the class `Joint` of MoveIt's RobotCommander does. The
            planning group that owns the joint plans the motion.
            """
            group = self._robot.get_default_owner_group(self._name)
            if group is None:
                raise MoveItCommanderException(
                    f"There is no known group containing joint {self._name}. Cannot move."
                )
            commander = self._robot.get_group(group)
            if commander is None:
                return False
            commander.set_joint_value_target(commander.get_current_joint_values())
            commander.set_joint_value_target(self._name, position)
            return bool(commander.go(wait))

        def __repr__(self) -> str:
            return f"Joint {self._name!r} at {self.value()}"

    class Link:
        """One link of the robot."""

        def __init__(self, robot: RobotCommander, name: str):
            self._robot, self._name = robot, name

        def name(self) -> str:
            return self._name

        def pose(self) -> Any:
            T = measured_scene().frame_pose(self._name)
            return list_to_pose_stamped([*T.translation, *T.quat_xyzw], self._robot.get_planning_frame())

    def __init__(self, robot_description: str = "robot_description", ns: str = ""):
        self._robot_description, self._ns = robot_description, ns
        self._groups: dict[str, MoveGroupCommander] = {}
        self._joint_owner_groups: dict[str, str | None] = {}
        current_session()

    def get_planning_frame(self) -> str:
        return WORLD

    def get_robot_markers(self, *args: Any) -> Any:
        """Return a MarkerArray of the robot's collision geometry at the current joint positions, like
        MoveIt's RobotCommander.
        """
        session, scene = current_session(), measured_scene()
        wanted = args[0] if args and isinstance(args[0], list | tuple) else list(scene.model.links)
        return markers(session, scene, wanted)

    def get_root_link(self) -> str:
        return current_session().model.root_link

    def get_active_joint_names(self, group: str | None = None) -> list[str]:
        model = current_session().model
        if group is None:
            return list(model.joint_names)
        return list(self._group(group).joint_names)

    def get_joint_names(self, group: str | None = None) -> list[str]:
        """Return the names of all joints of the robot or of a group, including fixed and mimic joints, as
        MoveIt's RobotCommander does.
        """
        model = current_session().model
        if group is None:
            return list(model.joints)
        links = set(self._group(group).link_names)
        return [j.name for j in model.joints.values() if j.child in links]

    def get_link_names(self, group: str | None = None) -> list[str]:
        return list(current_session().model.links if group is None else self._group(group).link_names)

    def _group(self, name: str) -> Any:
        if not self.has_group(name):
            raise MoveItCommanderException(f"There is no group named {name}")
        return current_session().model.group(name)

    def get_group_names(self) -> list[str]:
        return list(current_session().model.groups)

    def has_group(self, name: str) -> bool:
        return name in current_session().model.groups

    def get_current_state(self) -> Any:
        request = current_session().new("moveit_msgs/GetPlanningSceneRequest")
        request.components.components = int(Components.ROBOT_STATE | Components.ROBOT_STATE_ATTACHED_OBJECTS)
        return current_session().call("/get_planning_scene", request).scene.robot_state

    def get_current_variable_values(self) -> dict[str, float]:
        state = self.get_current_state().joint_state
        return dict(zip(state.name, state.position))

    def get_joint(self, name: str) -> RobotCommander.Joint:
        if name not in current_session().model.joints:
            raise MoveItCommanderException(f"There is no joint named {name}")
        return self.Joint(self, name)

    def get_link(self, name: str) -> RobotCommander.Link:
        if name not in current_session().model.links:
            raise MoveItCommanderException(f"There is no link named {name}")
        return self.Link(self, name)

    def get_group(self, name: str) -> MoveGroupCommander:
        if name not in self._groups:
            if not self.has_group(name):
                known = current_session().model.groups
                raise MoveItCommanderException(str(UnknownNameError("planning group", name, known)))
            self._groups[name] = MoveGroupCommander(name, self._robot_description, self._ns)
        return self._groups[name]

    def get_default_owner_group(self, joint_name: str) -> str | None:
        """Return the name of the smallest planning group that moves a given joint, as MoveIt's RobotCommander
        does. Return None if no group moves the joint.
        """
        groups = [g for g in current_session().model.groups.values() if joint_name in g.joint_names]
        return min(groups, key=lambda g: len(g.joint_names)).name if groups else None

    def __getattr__(self, name: str) -> Any:
        """Return the group, joint or link with a given name, e.g. `robot.arm`."""
        if name.startswith("_"):
            raise AttributeError(name)
        model = current_session().model
        if name in model.groups:
            return self.get_group(name)
        if name in model.joints:
            return self.Joint(self, name)
        if name in model.links:
            return self.Link(self, name)
        raise AttributeError(f"RobotCommander has no group, joint or link {name!r}")
