"""Status of each arm on the bus: the wrench on its hand, its robot mode and its safety mode.

Message types and values are those of Universal Robots' ROS driver (ur_dashboard_msgs).
"""

from __future__ import annotations

from typing import Any

from armcell.drivers import Capability, Driver
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, RobotModel
from armcell.ros.bus import Bus

ROBOT, SAFETY = "ur_dashboard_msgs/RobotMode", "ur_dashboard_msgs/SafetyMode"
RUNNING, NORMAL = 7, 1  # simulated arms are always switched on, and no safety function stops them


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
