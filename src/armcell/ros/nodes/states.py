"""Publishing what a driver measures: joint states, the transform tree, object poses, the clock."""

from __future__ import annotations

import numpy as np

from armcell.control import Driver
from armcell.core import SE3
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.records.mcap_writer import ros_name, urdf_text
from armcell.ros.bus import Bus
from armcell.ros.convert import joint_state_message, pose_message, transform_message
from armcell.scene import WORLD, PlanningScene

RATE = 30.0  # [Hz]


class StatePublisher:
    """Publishes at a rate of the driver's own clock, which it makes the bus's clock.

    Topics: /joint_states, with several arms also /<arm's group>/joint_states, /tf (every link, every
    object; also those that never move, for Unity listens to no /tf_static), /object_pose/<name> and, when
    there is but one movable object, /object_pose, /clock, and /robot_description (latched) where the URDF's
    text is at hand.

    Args:
        rate: [Hz] of the driver's clock.
    """

    def __init__(self, bus: Bus, scene: PlanningScene, rate: float = RATE):
        self._bus, self._scene, self._period = bus, scene, 1.0 / rate
        self._tree = kinematic_tree(scene.model)
        self._ends = [(joint.parent, joint.child) for joint in scene.model.joints.values()]
        self._still = {n: o.T_world_object for n, o in scene.objects.items() if not o.movable}
        self._next = 0.0
        advertise = bus.advertise
        self._joints = advertise("/joint_states", "sensor_msgs/JointState")
        self._arms = {
            names: advertise(f"/{arm}/joint_states", "sensor_msgs/JointState")
            for arm, names in _arms(scene.model).items()
        }
        self.tf = advertise("/tf", "tf2_msgs/TFMessage")
        self._clock = advertise("/clock", "rosgraph_msgs/Clock")
        movable = [n for n, o in scene.objects.items() if o.movable]
        self._objects = {
            n: advertise(f"/object_pose/{ros_name(n)}", "geometry_msgs/PoseStamped") for n in movable
        }
        self._only = advertise("/object_pose", "geometry_msgs/PoseStamped") if len(movable) == 1 else None
        self._members = [self._joints, *self._arms.values(), self.tf, self._clock, *self._objects.values()]
        self._members += [self._only] if self._only is not None else []
        urdf = urdf_text(scene)
        if urdf is not None:
            description = advertise("/robot_description", "std_msgs/String", latch=True)
            description.publish(bus.schema.new("std_msgs/String", urdf))
            bus.parameters.set("/robot_description", urdf)
            self._members.append(description)

    def due(self, now: float) -> bool:
        """Whether it is time again, by the driver's clock [s]."""
        return now >= self._next - 1e-9

    def publish(self, driver: Driver) -> None:
        """Measure and publish. Called from the thread that steps the driver."""
        now = driver.now
        self._next = max(self._next + self._period, now)  # no burst after a pause
        self._bus.clock.set(now)
        schema, state = self._bus.schema, driver.joint_state()
        self._clock.publish(schema.new("rosgraph_msgs/Clock", self._bus.stamp()))
        self._joints.publish(joint_state_message(schema, self._bus.header(), state))
        for names, publisher in self._arms.items():
            if publisher.subscribers:
                mine = joint_state_message(schema, self._bus.header(), state.reindexed(names))
                publisher.publish(mine)
        poses = driver.object_poses()
        if self.tf.subscribers:
            self.tf.publish(schema.new("tf2_msgs/TFMessage", self._transforms(state.positions, poses)))
        for name, publisher in self._objects.items():
            if name in poses:
                stamped = schema.new(
                    "geometry_msgs/PoseStamped", self._bus.header(WORLD), pose_message(schema, poses[name])
                )
                publisher.publish(stamped)
                if self._only is not None:
                    self._only.publish(stamped)

    def close(self) -> None:
        """Leave the bus."""
        for member in self._members:
            member.close()

    def _transforms(self, q: np.ndarray, poses: dict[str, SE3]) -> list:
        schema, bus = self._bus.schema, self._bus
        Ts = self._tree.link_transforms(q)
        found = []
        for i, (parent, child) in enumerate(self._ends):
            T = SE3.from_matrix(Ts[self._tree.parent[i]]).inv() @ SE3.from_matrix(Ts[i + 1])
            found.append(transform_message(schema, bus.header(parent), child, T))
        root = self._scene.model.root_link
        roots = {} if root == WORLD else {root: SE3.identity()}
        for name, T in {**roots, **self._still, **poses}.items():
            found.append(transform_message(schema, bus.header(WORLD), name, T))
        return found


def _arms(model: RobotModel) -> dict[str, tuple[str, ...]]:
    """The joints of each arm with those of its grippers, by its group; empty where there is but one."""
    found: dict[str, tuple[str, ...]] = {}
    for gripper in model.grippers.values():
        own = found.get(gripper.arm_group, model.group(gripper.arm_group).joint_names)
        found[gripper.arm_group] = (*own, gripper.joint_name)
    return found if len(found) > 1 else {}
