"""A simulator in Unity's place, as tutorials' scripts make one: over the wire, with the connector's framing.

It moves joints along trajectories it is sent, closes fingers on a cube and carries it; no physics, no status.
"""

from __future__ import annotations

import threading
import time

import numpy as np
from tests.ros.unity_like import UnityLike

from armcell.core import SE3
from armcell.kinematics import kinematic_tree
from armcell.ros import schema
from armcell.ros.convert import joint_state_message, pose_message

RATE = 60.0  # [Hz]
SPEED = 4.0  # times as fast as the trajectories say
FINGER_SPEED = 0.3  # [m/s] of the opening


class UnitySim:
    """Runs in a thread of its own until closed."""

    def __init__(self, address, model, codec, q, cube, size=0.05, ros2=False):
        self.model, self.codec, self.tree = model, codec, kinematic_tree(model)
        self.q, self.cube, self.size = np.array(q, dtype=float), cube, size
        self.gripper = next(iter(model.grippers.values()))
        self.finger = model.columns((self.gripper.joint_name,))[0]
        self.target = self.gripper.width(self.q[self.finger])
        self.held = None
        self.trajectory, self.began = None, 0.0
        self.received = []
        self.wire = UnityLike(address, ros2, poll=0.0)
        for topic, name in (
            ("/joint_states", "sensor_msgs/JointState"),
            ("/object_pose", "geometry_msgs/PoseStamped"),
        ):
            self.wire.register("__publish", topic, name, queue_size=10, latch=False)
        self.wire.register("__subscribe", "/planned_trajectory", "trajectory_msgs/JointTrajectory")
        self.wire.register("__subscribe", "/gripper_command", "std_msgs/Float64")
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def close(self):
        self.stop.set()
        self.thread.join(5)
        self.wire.close()

    def run(self):
        last = time.monotonic()
        while not self.stop.is_set():
            end = last + 1 / RATE
            while (left := end - time.monotonic()) > 0:
                self.take(left)
            now = time.monotonic()
            self.step(now - last)
            last = now
            self.publish()

    def take(self, seconds):
        try:
            frame = self.wire.read(min(seconds, 0.005))
        except TimeoutError:
            return
        if frame is None:
            self.stop.set()
            return
        name, body = frame
        if name == "/planned_trajectory":
            message = self.codec.decode("trajectory_msgs/JointTrajectory", body)
            self.received.append(message)
            self.trajectory, self.began = message if message.points else None, time.monotonic()
        elif name == "/gripper_command":
            value = self.codec.decode("std_msgs/Float64", body).data
            self.target = max(value, 0.0)

    def tcp(self):
        return self.tree.link_pose(self.q, self.gripper.tcp_link)

    def step(self, dt):
        if self.trajectory is not None:
            points = self.trajectory.points
            times = [p.time_from_start.to_sec() for p in points]
            t = (time.monotonic() - self.began) * SPEED
            columns = self.model.columns(self.trajectory.joint_names)
            rows = np.array([p.positions for p in points])
            self.q[columns] = [np.interp(t, times, column) for column in rows.T]
            if t > times[-1]:
                self.trajectory = None
        width = self.gripper.width(self.q[self.finger])
        near = np.linalg.norm(self.tcp().translation - self.cube.translation) < 0.02
        if self.target < width and near and width <= self.size + 1e-9:
            if self.held is None:
                self.held = self.tcp().inverse() @ self.cube
        else:
            least = self.size if near and self.target < self.size else self.target
            width += float(np.clip(max(self.target, least) - width, -FINGER_SPEED * dt, FINGER_SPEED * dt))
            self.q[self.finger] = self.gripper.joint_position(width)
            if width > self.size + 1e-3:
                self.held = None
        if self.held is not None:
            self.cube = self.tcp() @ self.held

    def publish(self):
        from armcell.core import JointState

        S = schema()
        state = JointState(self.model.joint_names, self.q, np.zeros(len(self.q)))
        header = S.new("std_msgs/Header", frame_id="world")
        message = joint_state_message(S, header, state)
        if self.trajectory is not None:
            message.velocity = np.full(len(self.q), 0.5)
        self.wire.message("/joint_states", self.codec.encode(message))
        pose = S.new(
            "geometry_msgs/PoseStamped",
            header,
            pose_message(S, SE3(self.cube.rotation, self.cube.translation)),
        )
        self.wire.message("/object_pose", self.codec.encode(pose))
