"""Publisher of a driver's measurements: joint states, transforms, object poses, clock, arm status.

The status of an arm is the wrench on its hand, its robot mode and its safety mode. Its message types
and values are those of Universal Robots' ROS driver (ur_dashboard_msgs).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.core import SE3, InputError, JointState
from armcell.drivers import Capability, Driver
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, RobotModel
from armcell.records.mcap_writer import ros_name, urdf_text
from armcell.ros.bus import Bus
from armcell.ros.convert import joint_state_message, pose_message, transform_message
from armcell.scene import WORLD, PlanningScene

ROBOT, SAFETY = "ur_dashboard_msgs/RobotMode", "ur_dashboard_msgs/SafetyMode"
RUNNING, NORMAL = 7, 1  # simulated arms are always switched on, and no safety function stops them
RATE = 30.0  # [Hz]


class ArmStatusPublisher:
    """Publisher that reports the wrench, the robot mode and the safety mode of each arm on ROS topics.

    The topics are /<arm group>/wrench, /<arm group>/robot_mode and /<arm group>/safety_mode; a cell with one
    arm omits the group. The wrench (geometry_msgs/WrenchStamped) acts on the hand without the hand's own
    weight; reference point and frame are those of the tcp link. The modes are latched and published on
    change.
    """

    def __init__(self, bus: Bus, model: RobotModel):
        self._bus, self._tree = bus, kinematic_tree(model)
        self._hands: dict[str, Gripper] = {}
        for gripper in model.grippers.values():
            self._hands.setdefault(gripper.arm_group, gripper)
        arms = list(self._hands) or [g.name for g in model.groups.values() if g.tip_link]
        prefix = {arm: f"/{arm}" if len(arms) > 1 else "" for arm in arms}
        self._wrenches = {
            arm: bus.advertise(f"{prefix[arm]}/wrench", "geometry_msgs/WrenchStamped") for arm in self._hands
        }
        self._modes = {
            arm: (
                bus.advertise(f"{prefix[arm]}/robot_mode", ROBOT, latch=True),
                bus.advertise(f"{prefix[arm]}/safety_mode", SAFETY, latch=True),
            )
            for arm in arms
        }
        self._last: dict[str, tuple[int, int]] = {}

    def publish(self, driver: Driver) -> None:
        """Measure and publish the wrench and the modes of each arm. Only the thread that steps the driver may
        call this method.
        """
        new = self._bus.schema.new
        known = driver.arm_modes() if Capability.REPORT_MODES in driver.capabilities else {}
        for arm, publishers in self._modes.items():
            modes = known.get(arm, (RUNNING, NORMAL))
            if self._last.get(arm) != modes:
                self._last[arm] = modes
                for publisher, mode in zip(publishers, modes):
                    publisher.publish(new(publisher.type, mode=mode))
        for arm, publisher in self._wrenches.items():
            if publisher.subscribers:
                publisher.publish(self._wrench(driver, self._hands[arm]))

    def _wrench(self, driver: Driver, hand: Gripper) -> Any:
        new = self._bus.schema.new
        T = self._tree.link_pose(driver.joint_state().positions, hand.tcp_link)
        felt = driver.wrench(hand.name).reshape(2, 3) @ T.rotation.matrix
        force, torque = (new("geometry_msgs/Vector3", *map(float, v)) for v in felt)
        return new(
            "geometry_msgs/WrenchStamped", self._bus.header(hand.tcp_link),
            new("geometry_msgs/Wrench", force, torque),
        )  # fmt: skip

    def close(self) -> None:
        """Remove the publishers of the arm status (wrench, robot mode, safety mode) from the bus."""
        for member in (*self._wrenches.values(), *(p for pair in self._modes.values() for p in pair)):
            member.close()


def check_rate(driver: Driver, rate: float) -> None:
    """Check that the driver measures at least as often as the state publisher publishes joint states.

    Args:
        driver: the driver.
        rate: publishing rate of the states [Hz].
    Raises:
        InputError: the rate exceeds the driver's rate; the error states the highest valid rate.
    """
    highest = 1.0 / driver.period
    if rate > highest + 1e-6:
        raise InputError(
            f"the rate of the states is {rate:g} Hz, but this cell is measured every "
            f"{driver.period * 1e3:g} ms",
            hint=f"--rate {highest:g} or less",
        )


class StatePublisher:
    """Publisher of a cell's joint states, transforms and object poses,
    at a fixed rate in the time of the driver's clock.

    It sets the bus's clock to the driver's clock. Topics:

    - /joint_states: all joints, mimic joints last; with several arms also /<arm group>/joint_states
    - the topics of `ArmStatusPublisher`
    - /tf: every link and object, including static ones, because Unity does not read /tf_static
    - /object_pose/<name>, and /object_pose if the cell has exactly one movable object
    - /clock
    - /robot_description (latched), if the URDF text is available

    Args:
        bus: the message bus.
        scene: the initial scene.
        rate: publishing rate [Hz, driver's clock].
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
        self._mimics = _Mimics(scene.model)
        self._status = ArmStatusPublisher(bus, scene.model)
        self._members: list[Any] = [
            self._status,
            self._joints,
            *self._arms.values(),
            self.tf,
            self._clock,
            *self._objects.values(),
        ]
        self._members += [self._only] if self._only is not None else []
        urdf = urdf_text(scene)
        if urdf is not None:
            description = advertise("/robot_description", "std_msgs/String", latch=True)
            description.publish(bus.schema.new("std_msgs/String", urdf))
            bus.parameters.set("/robot_description", urdf)
            self._members.append(description)

    def due(self, now: float) -> bool:
        """Return whether the state publisher must publish joint states and transforms at the time `now` [s,
        driver's clock].
        """
        return now >= self._next - 1e-9

    def publish(self, driver: Driver) -> None:
        """Publish joint states, transforms and object poses. Only the thread that steps the driver may call
        this method.
        """
        now = driver.now
        self._next = max(self._next + self._period, now)  # avoids a burst of messages after a pause
        self._bus.clock.set(now)
        schema, state = self._bus.schema, driver.joint_state()
        self._clock.publish(schema.new("rosgraph_msgs/Clock", self._bus.stamp()))
        self._joints.publish(joint_state_message(schema, self._bus.header(), self._mimics.added(state)))
        self._status.publish(driver)
        for names, publisher in self._arms.items():
            if publisher.subscribers:
                mine = self._mimics.added(state.reindexed(names))
                publisher.publish(joint_state_message(schema, self._bus.header(), mine))
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
        """Remove the publishers of the cell's joint states, transforms and object poses from the bus."""
        for member in self._members:
            member.close()

    def _transforms(self, q: np.ndarray, poses: dict[str, SE3]) -> list:
        schema, bus = self._bus.schema, self._bus
        Ts = self._tree.link_transforms(q)
        found = []
        for i, (parent, child) in enumerate(self._ends):
            T = SE3.from_matrix(Ts[self._tree.parent[i]]).inverse() @ SE3.from_matrix(Ts[i + 1])
            found.append(transform_message(schema, bus.header(parent), child, T))
        root = self._scene.model.root_link
        roots = {} if root == WORLD else {root: SE3.identity()}
        for name, T in {**roots, **self._still, **poses}.items():
            found.append(transform_message(schema, bus.header(WORLD), name, T))
        return found


class _Mimics:
    """Mimic joints, such as the second finger of a gripper, which are added to published joint states."""

    def __init__(self, model: RobotModel):
        self._follows: dict[str, tuple[str, float, float]] = {}  # source joint, multiplier, offset
        for name, joint in model.joints.items():
            if joint.mimic is not None:
                self._follows[name] = model.coupling(name)

    def added(self, state: JointState) -> JointState:
        """Add the mimic joints to joint states before publication.
        The position of a mimic joint follows from another joint.

        The efforts of mimic joints are unknown and set to zero.
        """
        mine = {n: f for n, f in self._follows.items() if f[0] in state.joint_names}
        if not mine:
            return state
        columns = list(state.columns([source for source, _, _ in mine.values()]))
        factors, offsets = (np.array([f[i] for f in mine.values()]) for i in (1, 2))
        q, v, effort = state.positions, state.velocities, state.efforts
        return JointState(
            (*state.joint_names, *mine),
            np.append(q, q[columns] * factors + offsets),
            None if v is None else np.append(v, v[columns] * factors),
            None if effort is None else np.append(effort, np.zeros(len(mine))),
        )


def _arms(model: RobotModel) -> dict[str, tuple[str, ...]]:
    """Return the joints of each arm and its grippers, by arm, for publishing a joint state topic per arm. The
    result is empty for a single arm, which needs no separate topic.
    """
    found: dict[str, tuple[str, ...]] = {}
    for gripper in model.grippers.values():
        own = found.get(gripper.arm_group, model.group(gripper.arm_group).joint_names)
        found[gripper.arm_group] = (*own, *gripper.joint_names)
    return found if len(found) > 1 else {}
