"""Lines and arcs, and what is no arc (MoveIt's unittest_trajectory_generator_circ)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from armcell.core import SE3, SO3, ErrorCode, Outcome
from armcell.planning.pilz.paths import Arc, Line, arc_around, arc_through

START = SE3(SO3.from_rpy((0.1, -0.2, 0.3)), np.array([0.4, -0.1, 0.3]))


def circle(angle: float, radius: float = 0.2) -> np.ndarray:
    """Points of a tilted circle that passes through START."""
    tilt = Rotation.from_euler("xyz", [0.4, -0.3, 0.2]).as_matrix()
    at = lambda a: tilt @ np.array([radius * np.cos(a), radius * np.sin(a), 0.0])  # noqa: E731
    return START.translation + at(angle) - at(0.0)


def goal_at(angle: float) -> SE3:
    return SE3(SO3.from_rpy((0.5, 0.1, -0.4)), circle(angle))


def test_position_and_orientation_go_together_on_a_line():
    goal = SE3(SO3.from_rpy((1.0, -0.4, 2.0)), np.array([0.1, 0.5, 0.6]))
    line = Line(START, goal)
    slerp = Slerp([0, 1], Rotation.from_matrix([START.rotation.matrix, goal.rotation.matrix]))
    for s in np.linspace(0.0, 1.0, 11):
        pose = line.pose(s)
        np.testing.assert_allclose(
            pose.translation, START.translation + s * (goal.translation - START.translation), atol=1e-12
        )
        np.testing.assert_allclose(pose.rotation.matrix, slerp(s).as_matrix(), atol=1e-9)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("sweep", [0.3, 1.5, 3.0, 4.5, 6.0])
def test_an_arc_through_a_point_goes_through_it(sweep, share):
    interim, goal = circle(share * sweep), goal_at(sweep)
    arc = arc_through(START, goal, interim)
    assert isinstance(arc, Arc)
    assert arc.sweep == pytest.approx(sweep, abs=1e-7) and arc.radius == pytest.approx(0.2, abs=1e-8)
    points = np.array([arc.position(s) for s in np.linspace(0, 1, 201)])
    center = circle(0.0) - (circle(0.0) - circle(np.pi)) / 2
    np.testing.assert_allclose(np.linalg.norm(points - center, axis=1), 0.2, atol=1e-8)
    np.testing.assert_allclose(arc.position(share), interim, atol=1e-7)
    assert arc.pose(1.0).isclose(goal, 1e-7, 1e-9) and arc.pose(0.0).isclose(START)


@pytest.mark.parametrize("sweep", [0.3, 1.5, 3.0])
def test_an_arc_around_a_center_takes_the_shorter_way(sweep):
    center = (circle(0.0) + circle(np.pi)) / 2
    for goal in (goal_at(sweep), goal_at(-sweep)):
        arc = arc_around(START, goal, center)
        assert isinstance(arc, Arc) and arc.sweep == pytest.approx(sweep, abs=1e-7)
        assert arc.pose(1.0).isclose(goal, 1e-9, 1e-9)


def test_a_center_slightly_beside_still_ends_in_the_goal_with_one_radius():
    """MoveIt takes up to 10 mm as well, and ends beside the goal."""
    center, goal = (circle(0.0) + circle(np.pi)) / 2, goal_at(1.5)
    chord = goal.translation - START.translation
    arc = arc_around(START, goal, center + 0.003 * chord / np.linalg.norm(chord))
    assert isinstance(arc, Arc) and arc.pose(1.0).isclose(goal, 1e-9, 1e-9)
    assert arc.radius == pytest.approx(0.2, abs=1e-6)


def refused(answer) -> str:
    assert isinstance(answer, Outcome) and answer.code is ErrorCode.INVALID_MOTION_PLAN
    return answer.message


def test_what_is_no_arc():
    goal, center = goal_at(1.5), (circle(0.0) + circle(np.pi)) / 2
    middle = (START.translation + goal.translation) / 2
    assert "one line" in refused(arc_through(START, goal, middle))  # colinearInterim
    assert "one line" in refused(arc_through(START, START, circle(1.0)))
    assert "one line" in refused(arc_around(START, goal, middle))  # colinearCenter
    assert "one line" in refused(arc_around(START, START, center))
    far = refused(arc_around(START, goal, START.shifted(y=1.0).translation))  # invalidCenter
    assert "1000.0 mm from the start" in far
    tiny = SE3(START.rotation, START.translation - 1e-8)  # samePointsWithCenter, samePointsWithInterim
    assert "one line" in refused(arc_around(START, tiny, START.translation + 1e-8))
    assert "one line" in refused(arc_through(START, tiny, START.translation + 1e-8))
