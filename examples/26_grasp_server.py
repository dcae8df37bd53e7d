"""Unity's side of a grasp: a service call over the wire, and the cube is in the air.

One bus has a simulated cell with planner and grasp server behind a ROS-TCP server, as `armcell serve` starts
them. The other has what a Unity scene would have: the cube's pose as it comes, and a button that calls
/grasp. All four arrangements of these roles work (docs/with_unity.md).

    python examples/26_grasp_server.py
"""

import armcell
from armcell.ros import Bus, ForwardedNames, RosTcpClient, RosTcpServer, ServedCell, ServerSettings

POSE, TRIGGER, TEXT = "geometry_msgs/PoseStamped", "std_srvs/Trigger", "std_msgs/String"

# The server: physics four times as fast as the clock, move_group, the grasp server.
cell = armcell.load("panda_table")
served = ServedCell(cell.connect("sim", seed=2, time_scale=4.0), Bus())

# The client: what it wants of the server, by name and type.
bus = Bus()
bridge = ForwardedNames(subscribe={"/object_pose": POSE, "/grasp_status": TEXT}, use={"/grasp": TRIGGER})
poses = bus.subscribe("/object_pose", POSE, queue_size=1)
status = bus.subscribe("/grasp_status", TEXT, queue_size=50)

with (
    served,
    RosTcpServer(served.bus, ServerSettings(port=0)) as server,
    RosTcpClient(bus, *server.address, bridge, service_timeout=60.0) as client,
):
    client.wait_connected(10)
    before = poses.get(timeout=10).pose.position
    print(f"cube at ({before.x:.3f}, {before.y:.3f}, {before.z:.3f})")

    answer = bus.call("/grasp", bus.schema.new("std_srvs/TriggerRequest"))

    after = poses.get(timeout=10).pose.position
    print(f"grasped: {answer.success}, {answer.message}")
    print(f"lifted by {(after.z - before.z) * 1000:.0f} mm")
    while (message := status.get(timeout=0.2)) is not None:
        print(f"status: {message.data}")
    print(f"in the hand, by the planning scene: {', '.join(served.cell.scene().attached)}")
print(f"unwanted contacts: {len(served.live.driver.unwanted_contacts())}")
