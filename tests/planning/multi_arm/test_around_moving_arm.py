"""One arm beside the other's running motion: judged by coal, waiting, searching in time, refusing."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planning.multi_arm.dual import FAST, LEFT, OTHER, RIGHT, SLOW, Judge, motion, scene, tip, with_tips
from tests.sizes import seeds

from armcell.collision import ExactChecker
from armcell.collision.inter_arm_checker import without_arms
from armcell.core import InputError, PlanRequest
from armcell.planning import RunningMotion, plan_around_moving_arms
from armcell.planning.multi_arm.space_time_search import SpaceTimeProblem, search, shortened
from armcell.timing import reverse_trajectory
from armcell.timing.moving_average import smooth_by_moving_average

pytestmark = pytest.mark.slow  # two arms: proofs, searches and physics by the second

# where the tips are and go: right's start and goal (slow), left's start and goal
SWAPS = {
    "swap over": ((-0.4, 0.0), (0.4, 0.0), (0.4, 0.0), (-0.4, 0.0)),
    "swap deep": ((-0.3, 0.1), (0.3, 0.1), (0.3, -0.1), (-0.3, -0.1)),
    "pushed back": ((-0.4, 0.1), (0.15, 0.25), (0.1, -0.1), (-0.45, -0.1)),
}


def beside(at, goal, running, seed=0, start=0.0):
    request = PlanRequest(LEFT, (goal,), seed=seed, **FAST)
    return plan_around_moving_arms(at, request, {RIGHT: running}, start)


def judged(at, result, running, start=0.0):
    """Limits kept, nothing of the world touched, and the other arm no nearer than 20 mm."""
    trajectory = result.trajectory
    t = np.arange(0, trajectory.duration, 2e-3)
    samples = [trajectory.sample(x) for x in t]
    model = at.model
    for k, kind, share in ((1, "velocity", 0.6), (2, "acceleration", 0.25)):
        most = np.abs([s[k] for s in samples]).max(axis=0)
        assert np.all(most <= share * model.limits(trajectory.joint_names, kind) * (1 + 1e-3)), kind
    alone = ExactChecker(without_arms(at, RIGHT), trajectory.joint_names)
    assert all(not alone.contacts(s[0], padded=False) for s in samples[::5])
    assert Judge(at).nearest(RunningMotion(trajectory, start), running, step=4e-3) >= 0.02 - 1e-5


@pytest.mark.cases("0-swap deep", "1-swap over")
@pytest.mark.parametrize("name", SWAPS)
@pytest.mark.parametrize("seed", seeds(2, range(4)))
def test_they_change_places_while_the_other_moves(name, seed):
    """Neither the plan without the other arm nor a wait will do: it has to be searched in time."""
    r0, r1, l0, l1 = SWAPS[name]
    at = with_tips(l0, r0)
    running = RunningMotion(motion(at, RIGHT, tip(*r1), **SLOW), 0.0)
    result = beside(at, tip(*l1), running, seed)
    assert result.ok, result.message
    assert result.evidence["beside"] == "searched"
    judged(at, result, running)


def test_free_motions_are_left_as_they_are():
    running = RunningMotion(motion(scene(), RIGHT, tip(-0.4, -0.2), **SLOW), 0.0)
    result = beside(scene(), tip(0.5, 0.2), running)
    assert result.ok and result.evidence["beside"] == "as planned"
    alone = motion(scene(), LEFT, tip(0.5, 0.2))
    np.testing.assert_array_equal(result.trajectory.positions, alone.positions)


def test_a_goal_that_becomes_free_is_waited_for():
    there = motion(scene(), RIGHT, tip(0.0, 0.1), **SLOW)
    at = scene().with_state(there.end)
    running = RunningMotion(reverse_trajectory(there), 3.0)  # leaves after 3 s
    result = beside(at, tip(0.0, 0.0), running)
    assert result.ok and result.evidence["beside"] in ("waits", "searched")
    assert result.trajectory.duration > 3.0
    judged(at, result, running)


def test_a_goal_where_the_other_comes_to_rest_is_refused_with_the_pair():
    running = RunningMotion(motion(scene(), RIGHT, tip(0.0, 0.05), **SLOW), 0.0)
    result = beside(scene(), tip(0.0, 0.05), running)
    assert not result.ok
    contact = result.evidence["contact"]
    assert contact.body_a.startswith("left_") != contact.body_b.startswith("left_")
    assert result.evidence["time"] > 0 and "right_arm" in result.message


def test_starting_later_sees_the_other_where_it_is_then():
    there = motion(scene(), RIGHT, tip(0.0, 0.1), **SLOW)
    at = scene().with_state(there.end)
    gone = RunningMotion(reverse_trajectory(there), 0.0)
    result = beside(at, tip(0.0, 0.0), gone, start=gone.end)
    assert result.ok and result.evidence["beside"] == "as planned"


def test_misuse():
    running = RunningMotion.at_rest(scene(), RIGHT)
    with pytest.raises(InputError, match="finite"):
        beside(scene(), tip(0, 0), running, start=np.inf)
    with pytest.raises(InputError, match="share"):
        plan_around_moving_arms(scene(), PlanRequest("both_arms", (tip(0, 0),)), {RIGHT: running})
    assert OTHER[LEFT] == RIGHT


# --- the search on a problem with a known answer ---
class Gate:
    """One joint; positions within 0.2 of 1.0 may be passed only between two times."""

    def __init__(self, opens: float, closes: float):
        self.opens, self.closes = opens, closes

    def free(self, p, s, q, t):
        for x in np.linspace(0, 1, 200):
            at, when = p[0] + x * (q[0] - p[0]), s + x * (t - s)
            if abs(at - 1.0) < 0.2 and not self.opens <= when <= self.closes:
                return False
        return True


def gate_problem(opens, closes, speed=1.0):
    one = np.ones(1)
    return SpaceTimeProblem(
        Gate(opens, closes), 0 * one, 0.0, np.array([[2.0]]), np.zeros(1), speed * one, -one, 3 * one
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_earliest_arrival_through_a_gate(seed):
    """It cannot enter before 3 s and is 1.2 from the goal there: no sooner than at 4.2 s."""
    problem, rng = gate_problem(3.0, 9.0), np.random.default_rng(seed)
    horizon, best = 9.0, None
    for _ in range(4):
        path = search(problem, horizon, rng, np.inf, 800)
        if path is not None:
            best = shortened(problem, path, rng, np.inf)
            assert best.times[-1] <= path.times[-1] + 1e-9
            horizon = best.times[-1] - 1e-3
    assert best is not None and 4.2 - 0.05 <= best.times[-1] < 5.0
    assert np.all(np.abs(np.diff(best.points[:, 0])) <= np.diff(best.times) + 1e-9)


def test_a_gate_that_is_too_short_is_not_passed():
    assert search(gate_problem(3.0, 3.3), 9.0, np.random.default_rng(0), np.inf, 1500) is None


# --- smoothing ---
def test_averaged_pieces_keep_limits_and_ends():
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.uniform(0.3, 1.0, 7))
    points = np.cumsum(rng.uniform(-0.4, 0.4, (7, 3)), axis=0)
    limit = np.array([1.0, 2.0, 3.0])
    smooth = smooth_by_moving_average(("a", "b", "c"), times, points, limit)
    np.testing.assert_array_equal(smooth.positions[[0, -1]], points[[0, -1]])
    t = np.linspace(0, smooth.duration, 5000)
    q, v, a = (np.array([smooth.sample(x)[k] for x in t]) for k in range(3))
    assert np.all(np.abs(a) <= limit * (1 + 1e-6))
    speeds = np.abs(np.diff(points, axis=0) / np.diff(times)[:, None]).max(axis=0)
    assert np.all(np.abs(v).max(axis=0) <= speeds + 1e-9)
    np.testing.assert_allclose(np.gradient(q, t, axis=0)[1:-1], v[1:-1], atol=2e-3)
    window = smooth.duration - (times[-1] - times[0])
    pieces = np.column_stack([np.interp(t - window / 2, times - times[0], c) for c in points.T])
    assert np.abs(q - pieces).max() <= window * 2 * speeds.max() / 8 + 1e-9


def test_pieces_that_are_too_fast_are_refused():
    with pytest.raises(InputError, match="acceleration"):
        smooth_by_moving_average(("a",), [0.0, 0.1], [[0.0], [10.0]], [1.0])
