"""Two processes in a ROS 1 graph, with no ROS installed: a robot, and an operator who moves it.

The robot's process starts a master of its own; with ROS_MASTER_URI set it joins the one that is there. Either
process could be replaced by a real one: a driver, a rospy node, rostopic, RViz. With --keep the robot stays.

    python examples/27_ros1.py
"""

import os
import subprocess
import sys

import armcell
from armcell.ros import ActionClient, Bus, CellNode, Ros1Graph, Ros1Settings

ACTION = "control_msgs/FollowJointTrajectory"


def robot() -> None:
    """A cell on a bus, and the bus in a graph: all that the cell publishes and serves is offered there."""
    bus = Bus()
    node = CellNode(armcell.load("panda_pick").connect("fake", seed=0, time_scale=2.0), bus)
    thread = node.start()
    node.ready.wait()

    # Port 0 is any free one; with an address of your own, or 11311, others know where to look.
    given = os.environ.get("ROS_MASTER_URI")
    own = Ros1Settings(name="robot", master=given or "http://127.0.0.1:0", own_master=None if given else True)
    with Ros1Graph(bus, own) as graph:
        print(f"robot: node {graph.node.name} offers {len(graph.node.publications())} topics", flush=True)
        subprocess.run([sys.executable, __file__, graph.node.master], check=True)
        if "--keep" in sys.argv:
            input(f"the graph stays at {graph.node.master}; press Enter to end")
    node.close()
    thread.join(5)


def operator(master: str) -> None:
    """Another process, on a bus of its own: topics, parameters and actions are the graph's."""
    bus = Bus()
    with Ros1Graph(bus, Ros1Settings(name="operator", master=master, own_master=False)):
        states = bus.subscribe("/joint_states", "sensor_msgs/JointState", queue_size=1)
        message = states.get(timeout=10)
        print(f"operator: sensed {len(message.name)} joints")
        print(f"operator: time is the cell's: {bus.parameters.get('/use_sim_time')}")

        # The first joint by half a radian, in a second; the others stay where they are.
        new = bus.schema.new
        arm = [n for n in message.name if "finger" not in n]
        here = [float(q) for n, q in zip(message.name, message.position) if n in arm]
        points = [
            new("trajectory_msgs/JointTrajectoryPoint", positions=q, time_from_start=at)
            for q, at in (
                (here, new("builtin_interfaces/Duration")),
                ([here[0] + 0.5, *here[1:]], new("builtin_interfaces/Duration", 1)),
            )
        ]
        trajectory = new("trajectory_msgs/JointTrajectory", joint_names=arm, points=points)

        # As actionlib does it; a SimpleActionClient of rospy's would be served alike.
        with ActionClient(bus, "/arm_controller/follow_joint_trajectory", ACTION) as client:
            client.wait_for_server(10)
            feedback = []
            sent = client.send_goal(new(f"{ACTION}Goal", trajectory=trajectory), feedback.append)
            sent.wait(30)
            print(f"operator: {sent.state.name} after {len(feedback)} feedback messages")

        states.get(timeout=1)  # the one that waited may be from before the end
        moved = states.get(timeout=10).position[0] - here[0]
        print(f"operator: {arm[0]} moved by {moved:.3f} rad")


if __name__ == "__main__":
    masters = [argument for argument in sys.argv[1:] if argument.startswith("http")]
    operator(masters[0]) if masters else robot()
