"""Values to messages and back; trajectories that must not be played."""

import numpy as np
import pytest

from armcell.core import SE3, InputError, JointState
from armcell.model import load_robot
from armcell.ros import schema
from armcell.ros.convert import joint_state_message, pose_message, trajectory_from_message

MODEL = load_robot("panda")
HOME = JointState(MODEL.joint_names, MODEL.default_positions())
ARM = MODEL.joint_names[:7]
Q = HOME.reindexed(ARM).positions


def message(times, positions=None, names=ARM, **fields):
    points = []
    for i, t in enumerate(times):
        at = schema().message("builtin_interfaces/Duration").from_sec(t)
        point = schema().new("trajectory_msgs/JointTrajectoryPoint", time_from_start=at)
        point.positions = Q if positions is None else positions[i]
        for name, rows in fields.items():
            setattr(point, name, rows[i])
        points.append(point)
    return schema().new("trajectory_msgs/JointTrajectory", joint_names=list(names), points=points)


def test_quaternions_are_xyzw():
    T = SE3.from_xyz_rpy((1.0, 2.0, 3.0), (0.0, 0.0, np.pi / 2))
    pose = pose_message(schema(), T)
    o = pose.orientation
    assert np.allclose([o.x, o.y, o.z, o.w], [0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.0, 2.0, 3.0)


def test_a_state_without_velocities_has_none():
    found = joint_state_message(schema(), schema().new("std_msgs/Header"), HOME)
    assert tuple(found.name) == MODEL.joint_names and found.velocity.size == 0


def test_fields_are_kept_and_decide_the_interpolation():
    v, a = np.zeros((2, 7)), np.ones((2, 7))
    t = trajectory_from_message(message([0, 1], velocities=v, accelerations=a), MODEL, HOME)
    assert t.velocities is not None and t.accelerations is not None
    assert np.allclose(t.positions, [Q, Q]) and t.duration == 1.0
    assert trajectory_from_message(message([0, 1]), MODEL, HOME).velocities is None
    assert trajectory_from_message(message([0, 1], accelerations=a), MODEL, HOME).accelerations is None


def test_one_that_begins_later_begins_here():
    here = HOME.updated(JointState(ARM, Q + 0.05))
    t = trajectory_from_message(message([0.5, 1.0], velocities=np.zeros((2, 7))), MODEL, here)
    assert t.times.tolist() == [0.0, 0.5, 1.0]
    assert np.allclose(t.positions[0], Q + 0.05) and t.velocities.shape == (3, 7)


def test_no_points_is_stop():
    assert trajectory_from_message(message([]), MODEL, HOME).duration == 0.0


NAN, FAR = Q.copy(), Q.copy()
NAN[2], FAR[3] = np.nan, 9.0


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (message([0, 1], [Q, NAN]), "point 1: positions has a value that is not finite"),
        (message([0], velocities=[np.full(7, np.inf)]), "point 0: velocities has a value that is not finite"),
        (message([0], [FAR]), "point 0: joint 'panda_joint4' at 9 is outside its limits"),
        (message([0], names=[*ARM[:6], "panda_jiont7"]), "did you mean 'panda_joint7'"),
        (message([0], names=[*ARM[:6], ARM[0]]), "'panda_joint1' is named twice"),
        (message([0, 0]), "point 1 is at 0 s: time must begin at 0 or later, and increase"),
        (message([0, 2, 1]), "point 2 is at 1 s"),
        (message([-1, 0]), "point 0 is at -1 s"),
        (message([0], [Q[:6]]), "point 0 has 6 positions for 7 joints"),
        (message([0, 1], [Q, []]), "point 1 has 0 positions for 7 joints"),
        (message([0, 1], velocities=[Q, []]), "point 1 has 0 velocities for 7 joints"),
        (message([0], [[]]), "the points have no positions"),
    ],
)
def test_trajectories_nobody_should_play(wrong, reason):
    with pytest.raises(InputError, match=reason):
        trajectory_from_message(wrong, MODEL, HOME)
