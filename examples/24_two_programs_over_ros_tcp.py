"""A simulator and a planner that share nothing but a wire: sense, plan, execute, feedback.

The planner listens as Unity's endpoint does; the simulator connects in Unity's place. Each could be replaced
by the real thing: Unity on one side, a ROS-TCP endpoint with MoveIt on the other. Here both run in this
script, one bus each; nothing of ROS is installed.

    python examples/24_two_programs_over_ros_tcp.py
"""

import numpy as np

import armcell
from armcell.core import JointGoal, JointState, PlanRequest
from armcell.planning import plan
from armcell.ros import Bus, CellNode, ForwardedNames, RosTcpClient, RosTcpServer, ServerSettings

STATES = {"/joint_states": "sensor_msgs/JointState", "/trajectory_status": "std_msgs/String"}
TRAJECTORY = {"/planned_trajectory": "trajectory_msgs/JointTrajectory"}

# The simulator: a cell on a bus of its own, ten times as fast as the clock.
cell = armcell.load("panda_pick")
simulator = CellNode(cell.connect("fake", seed=0, time_scale=10.0), Bus())
thread = simulator.start()

# The planner: another bus, and the server that Unity would connect to.
bus = Bus()
states = bus.subscribe("/joint_states", STATES["/joint_states"], queue_size=1)
status = bus.subscribe("/trajectory_status", STATES["/trajectory_status"])
with (
    RosTcpServer(bus, ServerSettings(port=0)) as server,
    RosTcpClient(
        simulator.bus, *server.address, ForwardedNames(publish=STATES, subscribe=TRAJECTORY)
    ) as client,
):
    client.wait_connected(10)

    # Sense: where the arm is, as it came over the wire.
    message = states.get(timeout=10)
    now = JointState(tuple(message.name), message.position)
    scene = cell.scene(0).with_state(now)
    print(f"sensed {len(message.name)} joints of {scene.model.name}")

    # Plan: half a radian to the left of there, among the cell's obstacles.
    arm = scene.model.group("arm").joint_names
    here = now.reindexed(arm).positions
    goal = JointState(arm, here + np.array([0.5, 0, 0, 0, 0, 0, 0]))
    result = plan(scene, PlanRequest("arm", (JointGoal(goal),)))
    print(f"planned {len(result.trajectory.times)} points, {result.trajectory.duration:.2f} s")

    # Execute: a message as any ROS program would send it.
    points = [
        bus.schema.new(
            "trajectory_msgs/JointTrajectoryPoint",
            positions=q,
            velocities=v,
            time_from_start=bus.schema.message("builtin_interfaces/Duration").from_sec(t),
        )
        for t, q, v in zip(result.trajectory.times, result.trajectory.positions, result.trajectory.velocities)
    ]
    trajectory = bus.schema.new("trajectory_msgs/JointTrajectory", joint_names=list(arm), points=points)
    bus.advertise("/planned_trajectory", TRAJECTORY["/planned_trajectory"]).publish(trajectory)

    # Feedback: the simulator says how it went, and the states show it.
    while not (said := status.get(timeout=20).data).startswith(("done", "failed", "refused")):
        print(f"simulator: {said}")
    print(f"simulator: {said.split(':')[0]}")
    states.get(timeout=1)  # the one that waited may be from before the end
    message = states.get(timeout=10)
    reached = JointState(tuple(message.name), message.position).reindexed(arm).positions
    print(f"error at the goal: {np.abs(reached - goal.positions).max():.4f} rad")

simulator.close()
thread.join(5)
