"""What the planner makes of a simulator's words about its motions."""

import threading
import time

import numpy as np

from armcell.cell import load
from armcell.core import ErrorCode
from armcell.ros import Bus, schema
from armcell.ros.convert import joint_state_message
from armcell.ros.nodes import RemoteCell

S = schema()


def test_what_is_said_late_of_the_motion_before_is_not_taken_for_this_one():
    """A simulator in another process says "stopped", "done: empty trajectory" after the next one was sent."""
    bus, scene = Bus(), load("panda_table").scene()
    states = bus.advertise("/joint_states", "sensor_msgs/JointState")
    status = bus.advertise("/trajectory_status", "std_msgs/String")
    cell, over = RemoteCell(bus, scene), threading.Event()

    def publish():
        while not over.wait(0.02):
            states.publish(joint_state_message(S, bus.header(), scene.state))

    threading.Thread(target=publish, daemon=True).start()

    def say(*texts):
        for text in texts:
            status.publish(S.new("std_msgs/String", text))

    def moving(by):
        names = scene.model.group("panda_arm").joint_names
        end = scene.state.reindexed(names).positions + by
        at = S.message("builtin_interfaces/Duration").from_sec(5.0)
        point = S.new("trajectory_msgs/JointTrajectoryPoint", positions=np.array(end), time_from_start=at)
        message = S.new("trajectory_msgs/JointTrajectory", joint_names=list(names), points=[point])
        return cell.play(message)

    try:
        first = moving(0.1)
        say("executing 2 points, 5.00 s")
        time.sleep(0.2)
        second = moving(0.2)
        assert first.wait(1) and first.outcome().code is ErrorCode.PREEMPTED
        time.sleep(0.1)
        say("stopped: cancelled at 0.20 of 5.00 s", "stop", "done: empty trajectory: stopped")
        assert not second.wait(0.2)
        say("executing 2 points, 5.00 s")
        assert not second.wait(0.2)
        say("done: final error 0.0010")
        assert second.wait(1) and second.outcome().ok
        third = moving(0.3)
        time.sleep(0.1)
        say("refused: joint 'panda_joint1' is named twice")
        assert third.wait(1) and third.outcome().code is ErrorCode.CONTROL_FAILED
    finally:
        over.set()
        cell.close()
