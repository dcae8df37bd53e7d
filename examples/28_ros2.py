"""A robot and a program that moves it, in two processes that meet as ROS 2 nodes; no ROS is installed.

The robot's process offers what any ROS 2 driver does: joint states, a transform tree, an action for each
arm. `ros2 topic list`, RViz or a node of yours would see the same, on the same machine and with
RMW_IMPLEMENTATION=rmw_cyclonedds_cpp.

    pip install 'armcell[ros2]'
    python examples/28_ros2.py
"""

import subprocess
import sys

import numpy as np

import armcell
from armcell.core import MissingExtraError
from armcell.ros import ActionClient, Bus, CellNode, DomainScope, Ros2Bridge, Ros2Settings

DOMAIN = DomainScope(domain=28)  # this machine only
ACTION = "control_msgs/FollowJointTrajectory"


def robot() -> None:
    """A simulated Panda that follows exactly; runs until its input ends."""
    bus = Bus()
    node = CellNode(armcell.load("panda_pick").connect("fake", seed=0, time_scale=5.0), bus)
    with Ros2Bridge(bus, Ros2Settings(DOMAIN, node="/robot")):
        thread = node.start()
        sys.stdin.read()
        node.close()
        thread.join(5)


def program() -> None:
    """Sense, move by half a radian, sense again."""
    bus = Bus()
    states = bus.subscribe("/joint_states", "sensor_msgs/JointState", queue_size=1)
    with (
        Ros2Bridge(bus, Ros2Settings(DOMAIN, node="/program")) as ros2,
        ActionClient(bus, "/arm_controller/follow_joint_trajectory", ACTION) as arm,
    ):
        found = ros2.wait_for_node("/robot", timeout=60) and arm.wait_for_server(timeout=30)
        print(f"nodes: {', '.join(ros2.nodes())}; its arm takes goals: {found}")

        before = states.get(timeout=60)
        joints = [name for name in before.name if "finger" not in name]
        start = positions(before, joints)
        print(f"sensed {len(before.name)} joints")

        goal = bus.schema.new(f"{ACTION}Goal")
        goal.trajectory.joint_names = joints
        for seconds, turn in ((0.0, 0.0), (2.0, 0.5)):
            point = bus.schema.new(
                "trajectory_msgs/JointTrajectoryPoint", positions=start + turn * np.eye(7)[0]
            )
            point.time_from_start = bus.schema.message("builtin_interfaces/Duration").from_sec(seconds)
            goal.trajectory.points.append(point)
        feedback = []
        sent = arm.send_goal(goal, feedback.append)
        sent.wait(timeout=30)
        print(f"{sent.state.name}: error code {sent.result.error_code}, {len(feedback)} feedback messages")

        states.get(timeout=1)  # the one that waited may be from before the end
        turned = positions(states.get(timeout=10), joints) - start
        print(f"{joints[0]} turned by {turned[0]:.3f} rad, the others by {np.abs(turned[1:]).max():.3f}")


def positions(message, joints):
    """Of some joints, in their order."""
    return np.array([message.position[message.name.index(name)] for name in joints])


if __name__ == "__main__":
    try:
        if sys.argv[1:] == ["robot"]:
            robot()
        else:
            with subprocess.Popen([sys.executable, __file__, "robot"], stdin=subprocess.PIPE):
                program()
    except MissingExtraError as error:
        print(f"skipped: {error}")
