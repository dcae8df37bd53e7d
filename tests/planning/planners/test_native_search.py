"""The native searches: neighbors, slices, streamed goals, threads, cancelling, evidence, AORRTC, PRM."""

from __future__ import annotations

import itertools
import os
import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from numba import njit
from tests.planning.helpers import STEP, down, ends_at, judge, panda_wall, request, ur10_wall, walled_in
from tests.planning.test_plan import beyond_panda
from tests.scene.helpers import box

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.simd import pointer
from armcell.core import ErrorCode, JointGoal, JointState, PoseGoal
from armcell.planning import plan
from armcell.planning.planners.aorrtc import AORRTCPlanner, AORRTCSettings, length
from armcell.planning.planners.native.nearest_neighbors import (
    LEAF_THRESHOLD,
    nearest_node,
)
from armcell.planning.planners.native.rrt_connect import ITERATIONS
from armcell.planning.planners.native.tree import new_trees, put, remove_nodes, tree_pointers
from armcell.planning.planners.prm import Roadmap
from armcell.planning.planners.prm import plan_with_roadmap as plan_on
from armcell.planning.planners.registry import find_planner, first_use_hooks
from armcell.planning.planners.rrt_connect import NativePlanner, RRTConnectSettings
from armcell.planning.request import validate_request


def question(scene, goal):
    """Checker, start, goals (1, n) and limits of the arm for a joint goal."""
    names = scene.model.group("arm").joint_names
    checker = KernelChecker(scene, names)
    start = scene.positions[checker.columns]
    end = scene.state.updated(goal.state).reindexed(names).positions
    low, high = scene.model.lower[checker.columns], scene.model.upper[checker.columns]
    return checker, start, end[None], np.maximum(low, -np.pi), np.minimum(high, np.pi)


def ur10_over():
    return ur10_wall(), JointGoal(JointState(("shoulder_pan_joint",), [0.8]))


PROBLEMS = {"panda": lambda: (panda_wall(), beyond_panda()), "ur10": ur10_over}


def judged(checker, waypoints, start, goals):
    """From the start to a goal, and free every 2 mrad by the exact checker, without padding."""
    np.testing.assert_array_equal(waypoints[0], start)
    assert any(np.array_equal(waypoints[-1], goal) for goal in goals)
    exact = ExactChecker(checker.scene.with_padding(0.0), checker.joint_names)
    for a, b in itertools.pairwise(waypoints):
        for t in np.linspace(0, 1, max(int(np.abs(b - a).max() / STEP), 2)):
            assert exact.is_free(a + t * (b - a))


# ---- other planners' paths ---------------------------------------------------------------------------


def test_a_path_longer_than_the_buffer_is_shortened_piece_by_piece():
    checker, start, goals, lower, upper = question(*PROBLEMS["panda"]())
    planner, stop = NativePlanner(checker), np.zeros(1, np.int64)
    found = planner.plan(start, goals, lower, upper)
    along = np.linspace(0, len(found.raw) - 1, 1300)
    fine = np.stack([np.interp(along, np.arange(len(found.raw)), column) for column in found.raw.T], axis=1)
    short = planner.shortened(fine, stop)
    assert 2 < len(short) < 1300 and length(short) < length(found.raw)
    judged(checker, short, start, goals)
    assert planner.shortened(np.vstack([start, goals[0]]), stop) is None  # straight through the wall


# ---- nearest neighbors ----------------------------------------------------------------------------


@njit
def _put_rows(nodes, dims, first, points, begin, end):
    for i in range(begin, end):
        put(pointer(nodes), dims, first + i, pointer(points), i * dims)


@njit
def _ask(trees, tree, count, q):
    return nearest_node(tree_pointers(trees), tree, count, pointer(q), 0)


@njit
def _forget(trees):
    remove_nodes(tree_pointers(trees))


@pytest.mark.parametrize("dims", [1, 6, 7, 14])
@pytest.mark.parametrize("kind", ["spread", "chains", "equal"])
def test_the_nearest_node_is_the_nearest(dims, kind):
    """Against NumPy, in both trees, while they grow through the number where leaves take over."""
    rng = np.random.default_rng(dims)
    capacity, n = 4096, 3000
    trees = new_trees(dims, capacity)
    nodes, parents = trees.nodes, trees.parents
    _forget(trees)
    for tree in (0, 1):
        points = np.round(rng.uniform(-3, 3, (n, dims)), 3)
        if kind == "chains":  # as trees grow: each a step from an earlier one
            for i in range(1, n):
                points[i] = points[rng.integers(max(i - 40, 0), i)] + 0.1 * points[i]
        if kind == "equal":
            points = points[rng.integers(0, 20, n)]
        parents[tree * capacity : tree * capacity + n] = np.maximum(np.arange(n) - 1, 0)
        parents[tree * capacity] = -1
        kept = points.astype(np.float32).astype(float)
        for before, count in itertools.pairwise(
            (0, 1, 17, LEAF_THRESHOLD - 1, LEAF_THRESHOLD, LEAF_THRESHOLD + 1, 1777, n)
        ):
            _put_rows(nodes, dims, tree * capacity, points, before, count)
            for _ in range(30):
                q = rng.uniform(-3.5, 3.5, dims)
                i = _ask(trees, tree, count, q)
                apart = np.linalg.norm(kept[:count] - q, axis=1)
                assert 0 <= i < count and apart[i] <= apart.min() * (1 + 1e-5) + 1e-6


# ---- RRT-Connect -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_search_in_slices_is_the_same_search(name):
    checker, *ask = question(*(PROBLEMS[name]()))
    whole = NativePlanner(checker).plan(*ask, seed=4)
    sliced = NativePlanner(checker, RRTConnectSettings(slice=3)).plan(*ask, seed=4, more_goals=iter(()))
    assert whole.iterations == sliced.iterations > 3
    np.testing.assert_array_equal(whole.waypoints, sliced.waypoints)


@pytest.mark.slow
def test_two_threads_find_what_one_finds_after_the_other():
    questions = [question(*PROBLEMS[name]()) for name in PROBLEMS for _ in range(2)]
    seeds = range(8)

    def answers(k):
        checker, *ask = questions[k]
        planner = NativePlanner(checker)
        return [planner.plan(*ask, seed=seed).waypoints for seed in seeds]

    alone = [answers(k) for k in range(len(questions))]
    together: dict[int, list] = {}
    threads = [
        threading.Thread(target=lambda k=k: together.update({k: answers(k)})) for k in range(len(questions))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k, paths in enumerate(alone):
        for a, b in zip(paths, together[k], strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.slow
@pytest.mark.cases("RRTConnect", "PRM")
@pytest.mark.parametrize("planner_id", ["RRTConnect", "AORRTC", "PRM"])
def test_cancelling_takes_milliseconds(planner_id):
    """5 ms is the aim; another program may hold the processor, so the best of several counts."""
    scene, goal = walled_in()
    late = []
    plan(scene, request(goal, planner_id=planner_id, planning_time=0.1))  # compiled before it is timed
    for _ in range(6):
        cancel, at = threading.Event(), []

        def stop(cancel=cancel, at=at):
            at.append(time.monotonic())
            cancel.set()

        threading.Timer(0.25, stop).start()
        result = plan(scene, request(goal, planner_id=planner_id, planning_time=30.0), cancel)
        late.append(time.monotonic() - at[0])
        assert result.code is ErrorCode.PREEMPTED and "cancelled" in result.message
    assert min(late) < 0.005 and np.median(late) < 0.05, late


def test_the_time_limit_leaves_evidence():
    scene, goal = walled_in()
    result = plan(scene, request(goal, planning_time=0.3))
    evidence = result.evidence
    assert result.code is ErrorCode.TIMED_OUT
    assert evidence["iterations"] > 100 and evidence["nodes"] > 2
    # The wall is 2 mm thick: the trees come near each other, but there is always a wall in between.
    assert 0.0 < evidence["closest_approach_rad"] < np.pi
    bodies = {name for contact in evidence["blocked_by"] for name in (contact.body_a, contact.body_b)}
    assert bodies & {"front", "back", "top"}
    assert "came within" in result.message and "touches" in result.message
    assert re.search(r"no path found in 0\.\d\d s \(\d+ configurations reached\)", result.message)


# ---- streamed goals --------------------------------------------------------------------------------


def test_goals_that_come_later_are_reached():
    """The first goal is free but walled off; the one that is streamed is not."""
    scene, goal = walled_in()
    checker, start, goals, lower, upper = question(scene, goal)
    reachable = start.copy()
    reachable[[0, 1]] += [0.4, -0.5]
    assert checker.is_free(reachable)
    planner = NativePlanner(checker, RRTConnectSettings(slice=200, max_iterations=50_000))
    assert planner.plan(start, goals, lower, upper).waypoints is None
    answer = planner.plan(start, goals, lower, upper, more_goals=iter([reachable]))
    assert answer.streamed == 1
    judged(checker, answer.waypoints, start, [reachable])


def test_none_is_asked_for_where_the_first_goals_do():
    checker, *ask = question(panda_wall(), beyond_panda())

    def never():
        raise AssertionError("asked for another goal")
        yield

    assert NativePlanner(checker).plan(*ask, more_goals=never()).waypoints is not None


def test_a_pose_whose_first_solutions_cannot_be_reached_is_solved(monkeypatch):
    """Only a walled-off posture is known when planning begins; the pose's solutions come while it runs."""
    from armcell.planning import pipeline

    scene, far = walled_in()
    checker, start, goals, *_ = question(scene, far)
    reachable = start.copy()
    reachable[[0, 1]] += [0.4, -0.5]
    there = scene.with_state(JointState(checker.joint_names, reachable))
    pose = PoseGoal(there.frame_pose(scene.model.group("arm").tip_link))
    honest = pipeline.find_joint_goals
    monkeypatch.setattr(pipeline, "find_joint_goals", lambda *args: ((goals[0],), honest(*args)[1]))
    result = plan(scene, request(pose, planning_time=10.0))
    assert result.ok, result.message
    assert result.evidence["streamed_goals"] >= 1
    judge(scene, result.trajectory)
    meters, radians = (
        ends_at(scene, result).frame_pose(scene.model.group("arm").tip_link).distance_to(pose.T_world_link)
    )
    assert meters <= pose.position_tolerance and radians <= pose.orientation_tolerance


def test_a_region_is_used_where_its_middle_cannot_be_reached():
    """The middle of the region is inside the table; with 15 cm of tolerance there is room above it."""
    scene = panda_wall()
    inside = down(0.5, 0.25, -0.02)
    assert plan(scene, request(PoseGoal(inside))).code is ErrorCode.GOAL_IN_COLLISION
    wide = PoseGoal(inside, position_tolerance=0.15, orientation_tolerance=0.3)
    result = plan(scene, request(wide, planning_time=10.0))
    assert result.ok, result.message
    judge(scene, result.trajectory)
    tip = ends_at(scene, result).frame_pose(scene.model.group("arm").tip_link)
    meters, radians = tip.distance_to(inside)
    assert meters <= 0.15 and radians <= 0.3


# ---- AORRTC ----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.cases("panda")
@pytest.mark.parametrize("name", PROBLEMS)
def test_more_iterations_never_cost_more(name):
    checker, *ask = question(*(PROBLEMS[name]()))
    first = NativePlanner(checker).plan(*ask, seed=1)
    costs = [length(first.waypoints)]
    for iterations in (1_000, 10_000, 100_000):
        planner = AORRTCPlanner(NativePlanner(checker), AORRTCSettings(max_iterations=iterations))
        answer = planner.plan(*ask, seed=1)
        judged(checker, answer.waypoints, ask[0], ask[1])
        told = [cost for _, _, cost in answer.history]
        assert told[0] == pytest.approx(costs[0]) and told[-1] == length(answer.waypoints)
        assert all(b < a for a, b in itertools.pairwise(told))
        assert answer.iterations <= iterations
        costs.append(told[-1])
    assert costs == sorted(costs, reverse=True)
    assert np.linalg.norm(ask[1][0] - ask[0]) <= costs[-1]


@pytest.mark.slow
def test_it_improves_on_first_paths_that_are_not_the_shortest():
    checker, *ask = question(*PROBLEMS["panda"]())
    firsts = {s: length(NativePlanner(checker).plan(*ask, seed=s).waypoints) for s in range(20)}
    seed = max(firsts, key=firsts.__getitem__)  # a detour
    planner = AORRTCPlanner(NativePlanner(checker), AORRTCSettings(max_iterations=100_000))
    answer = planner.plan(*ask, seed=seed)
    assert length(answer.waypoints) < 0.99 * firsts[seed]


@pytest.mark.slow
def test_the_same_seed_and_iterations_give_the_same_path():
    checker, *ask = question(*ur10_over())
    settings = AORRTCSettings(max_iterations=20_000)
    a, b, c = (AORRTCPlanner(NativePlanner(checker), settings).plan(*ask, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(a.waypoints, b.waypoints)
    assert [h[1:] for h in a.history] == [h[1:] for h in b.history]
    assert a.waypoints.shape != c.waypoints.shape or np.any(a.waypoints != c.waypoints)


@pytest.mark.slow
def test_the_pipeline_tells_the_cost_over_time():
    scene, goal = PROBLEMS["panda"]()
    began = time.monotonic()
    result = plan(scene, request(goal, planner_id="AORRTC", planning_time=0.7))
    assert time.monotonic() - began >= 0.7
    assert result.ok and result.planner_id == "AORRTC"
    judge(scene, result.trajectory)
    times, costs = np.array(result.evidence["cost_over_time"]).T
    assert np.all(np.diff(times) > 0) and np.all(np.diff(costs) < 0)
    assert costs[-1] == pytest.approx(length(result.path.waypoints))


# ---- PRM -------------------------------------------------------------------------------------------


def test_a_roadmap_learns_and_repairs():
    scene, goal = PROBLEMS["panda"]()
    checker, *ask = question(scene, goal)
    roadmap = Roadmap(7)
    first = plan_on(roadmap, NativePlanner(checker), *ask)
    again = plan_on(roadmap, NativePlanner(checker), *ask)
    for answer in (first, again):
        judged(checker, answer.waypoints, ask[0], ask[1])
    assert again.vertex_checks == again.edge_checks == 0 and not again.bridged
    assert again.vertices == first.vertices
    # A new object in the way: everything that is used is checked again, and the path avoids it.
    tip = scene.with_state(JointState(checker.joint_names, again.waypoints[len(again.waypoints) // 2]))
    at = tip.frame_pose("panda_hand_tcp").translation
    changed = scene.with_object(box("new", (0.06, 0.06, 0.06), at)).with_padding(0.005)
    other, *same = question(changed, goal)
    exact = ExactChecker(changed, other.joint_names)
    assert exact.is_free(ask[0]) and exact.is_free(ask[1][0])
    assert not exact.is_free(again.waypoints[len(again.waypoints) // 2])
    repaired = plan_on(roadmap, NativePlanner(other), *same)
    judged(other, repaired.waypoints, ask[0], ask[1])
    assert repaired.vertex_checks >= again.vertices and repaired.edge_checks > 0
    # And back: the first scene's knowledge was overwritten, its answer is still right.
    judged(checker, plan_on(roadmap, NativePlanner(checker), *ask).waypoints, ask[0], ask[1])


def test_a_roadmap_answers_the_same_questions_the_same_way():
    checker, *ask = question(*ur10_over())
    a, b = (plan_on(Roadmap(6), NativePlanner(checker), *ask) for _ in range(2))
    np.testing.assert_array_equal(a.waypoints, b.waypoints)


def test_a_roadmap_gives_up_when_told():
    checker, *ask = question(*walled_in())
    planner, stop = NativePlanner(checker), np.zeros(1, np.int64)

    def give_up():
        while planner.found[ITERATIONS] < 100:
            time.sleep(0.001)
        stop[0] = 1

    threading.Thread(target=give_up, daemon=True).start()
    answer = plan_on(Roadmap(7), planner, *ask, stop=stop)
    assert answer.waypoints is None and answer.iterations >= 100 and answer.closest is not None


class Stopping(NativePlanner):
    """Sets `stop` when one of its searches begins: the first is number 0."""

    def __init__(self, checker, stop, at):
        super().__init__(checker)
        self.stop, self.at = stop, at

    def search(self, *args, **options):
        self.stop[0], self.at = self.at <= 0, self.at - 1
        return super().search(*args, **options)


@pytest.mark.parametrize("at", [0, 2])
def test_a_stopped_roadmap_has_the_closest_approach_of_its_searches(at):
    """Also if the stop comes before a search has tried to connect its trees, or before the first search."""
    checker, start, goals, *bounds = question(*walled_in())
    stop = np.zeros(1, np.int64)
    answer = plan_on(Roadmap(7), Stopping(checker, stop, at), start, goals, *bounds, stop=stop)
    assert answer.waypoints is None
    gap, apart = np.linalg.norm(answer.closest[1] - answer.closest[0]), np.linalg.norm(goals[0] - start)
    assert 0.0 < gap < apart if at else gap == pytest.approx(apart)
    stop[0] = 1  # before it has searched
    answer = plan_on(Roadmap(7), NativePlanner(checker), start, goals, *bounds, stop=stop)
    np.testing.assert_array_equal(answer.closest, [start, goals[0]])


# ---- MotionBenchMaker ------------------------------------------------------------------------------

DATA = Path(os.environ.get("MBM") or Path(__file__).parents[4] / "data" / "mbm")


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_public_problems(robot):
    """The first two of each family: both planners find free paths, AORRTC's not longer than RRT-Connect's."""
    file = DATA / f"mbm_{robot}.json.gz"
    if not file.exists():
        pytest.skip(f"no {file}: set MBM to the folder with MotionBenchMaker's problems")
    from armcell.cli.bench_mbm import _tasks, find_robot, read_problems
    from armcell.model import load_robot

    model, roadmap = load_robot(find_robot(robot, file)), None
    gained = []
    for task in _tasks(read_problems(file), file, model, 2):
        checker = KernelChecker(task.scene, task.joint_names)
        roadmap = roadmap or Roadmap(len(task.start))
        ask = (task.start, task.goals, task.lower, task.upper)
        first = NativePlanner(checker).plan(*ask, seed=1)
        better = AORRTCPlanner(NativePlanner(checker), AORRTCSettings(max_iterations=20_000)).plan(
            *ask, seed=1
        )
        known = plan_on(roadmap, NativePlanner(checker), *ask)
        for waypoints in (better.waypoints, known.waypoints):
            judged(checker, waypoints, task.start, task.goals)
        gained.append(length(better.waypoints) / length(first.waypoints))
    assert max(gained) <= 1.0 and np.mean(gained) < 0.99


def test_compiling_a_planner_is_not_on_the_time_of_its_first_request(monkeypatch):
    began = []
    monkeypatch.setitem(
        first_use_hooks, find_planner("native", "PRM"), lambda: began.append(time.monotonic())
    )
    asked = validate_request(panda_wall(), request(beyond_panda(), planner_id="PRM"))
    assert len(began) == 1 and asked.began >= began[0]
