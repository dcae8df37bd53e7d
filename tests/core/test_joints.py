"""JointState, JointPath and JointTrajectory refuse what is not right and reindex by name."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.core import InputError, JointPath, JointState, JointTrajectory, UnknownNameError

ABC = ("a", "b", "c")


@pytest.mark.parametrize("label", ["positions", "velocities", "efforts"])
def test_state_checks_every_array(label):
    good = {"positions": [0.0, 0.0, 0.0]}
    with pytest.raises(InputError, match=label):
        JointState(ABC, **{**good, label: [1.0, 2.0]})
    with pytest.raises(InputError, match=f"{label} of b is not finite"):
        JointState(ABC, **{**good, label: [1.0, np.nan, 2.0]})


def test_state_owns_its_numbers():
    numbers = np.array([1.0, 2.0, 3.0])
    state = JointState(ABC, numbers)
    numbers[:] = 0.0
    assert state.as_dict() == {"a": 1.0, "b": 2.0, "c": 3.0}


def test_reindexing_follows_names():
    state = JointState(ABC, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0], time=3.0)
    part = state.reindexed(("c", "a"))
    assert (part.joint_names, part.time) == (("c", "a"), 3.0)
    for values, expected in ((part.positions, [3, 1]), (part.velocities, [6, 4]), (part.efforts, [9, 7])):
        np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(part.reindexed(("a", "c")).reindexed(("c", "a")).positions, part.positions)
    assert state["b"] == 2.0


def test_updating_overwrites_by_name_and_leaves_the_old_value():
    state = JointState(ABC, [1.0, 2.0, 3.0])
    after = state.updated(JointState(("c", "a"), [30.0, 10.0]))
    assert after.as_dict() == {"a": 10.0, "b": 2.0, "c": 30.0}
    assert state.as_dict() == {"a": 1.0, "b": 2.0, "c": 3.0}


@pytest.mark.parametrize(
    "use",
    [lambda s: s.reindexed(("a", "x")), lambda s: s["x"], lambda s: s.updated(JointState(("x",), [0.0]))],
)
def test_an_unknown_joint_lists_the_known_ones(use):
    with pytest.raises(UnknownNameError, match="unknown joint 'x'; known: a, b, c"):
        use(JointState(ABC, [1.0, 2.0, 3.0]))


def test_mapping_round_trip():
    values = {"b": 0.5, "a": -1.0}
    assert JointState.from_mapping(values).as_dict() == values


def test_a_joint_named_twice_is_refused():
    with pytest.raises(InputError):
        JointState(("a", "a"), [1.0, 2.0])


@pytest.mark.parametrize("waypoints", [[], [[]], [1.0, 2.0, 3.0], [[1.0, 2.0]], np.zeros((2, 3, 1))])
def test_a_path_checks_its_shape(waypoints):
    with pytest.raises(InputError, match="waypoints"):
        JointPath(ABC, waypoints)


def test_a_path_refuses_nan():
    with pytest.raises(InputError, match="not finite"):
        JointPath(ABC, [[0.0, 0.0, np.nan]])


def test_path_length_and_reversal():
    path = JointPath(("x", "y"), [[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])
    assert path.length == pytest.approx(6.0)
    assert path.reversed().length == pytest.approx(6.0)
    np.testing.assert_array_equal(path.reversed().waypoints[0], [3.0, 5.0])
    np.testing.assert_array_equal(path.reversed().reversed().waypoints, path.waypoints)
    assert JointPath(("x", "y"), [[1.0, 1.0]]).length == 0.0


@pytest.mark.parametrize("times", [[0.0, 0.0], [0.0, 1.0, 0.5], [1.0, 0.0]])
def test_time_must_increase(times):
    with pytest.raises(InputError, match="must increase"):
        JointTrajectory(("a",), times, np.zeros((len(times), 1)))


@pytest.mark.parametrize("label", ["positions", "velocities", "accelerations"])
def test_trajectory_checks_every_array(label):
    good = {"positions": np.zeros((2, 3))}
    for bad, words in ((np.zeros((3, 3)), "shape"), (np.full((2, 3), np.inf), "not finite")):
        with pytest.raises(InputError, match=f"{label} have .*{words}"):
            JointTrajectory(ABC, [0.0, 1.0], **{**good, label: bad})


def test_trajectory_refuses_times_that_are_not_finite():
    with pytest.raises(InputError, match="times"):
        JointTrajectory(("a",), [0.0, np.nan], np.zeros((2, 1)))


def test_a_trajectory_in_another_order_or_of_fewer_joints_moves_them_as_before():
    whole = JointTrajectory(
        ("a", "b", "c"), np.array([0.0, 1.0]), np.array([[0.0, 1.0, 2.0], [3.0, 5.0, 8.0]]), np.ones((2, 3))
    )
    part = whole.reindexed(("c", "a"))
    for mine, all_of_them in zip(part.sample(0.4), whole.sample(0.4), strict=True):
        np.testing.assert_allclose(mine, all_of_them[[2, 0]])
    assert part.accelerations is None and whole.reindexed(whole.joint_names) is whole
    with pytest.raises(UnknownNameError):
        whole.reindexed(("a", "x"))
