"""The contract of every registered planner, and how planners are named."""

from __future__ import annotations

import re
import threading
import time

import numpy as np
import pytest
from tests.planning.helpers import judge, panda_wall, request, walled_in
from tests.planning.test_plan import beyond_panda

from armcell.core import ErrorCode, UnknownNameError
from armcell.planning import normalized_planner_id, pipelines, plan, warm_up
from armcell.planning.planners.native.aorrtc import aorrtc
from armcell.planning.planners.native.roadmap import grow, insert, query, recheck
from armcell.planning.planners.registry import PILZ, SIMILAR_PLANNERS, first_use_hooks, named_planner

SEARCHING = {pipeline: table for pipeline, table in pipelines.items() if pipeline != PILZ}  # a way
ALL = [(pipeline, name) for pipeline, table in SEARCHING.items() for name in table]
each_planner = pytest.mark.parametrize(("pipeline", "name"), ALL)
SECONDS = 1.5


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """Compiling, at a planner's first use on a machine, is not on the time of a plan."""
    warm_up()
    for use in first_use_hooks.values():
        use()


def late(name: str) -> float:
    """[s] after its time by which a planner must have ended: FMT and BFMT draw and join all their samples
    before they look at the clock; for the others, some for finishing the path on a busy machine."""
    return 40.0 if "FMT" in name else 10.0


def test_the_first_use_compiles_what_the_searches_call():
    """One signature: an argument of another type would be compiled on the time of the first plan."""
    for name in ("AORRTC", "PRM"):
        request_ = request(beyond_panda(), pipeline_id="native", planner_id=name, planning_time=0.2)
        plan(panda_wall(), request_)
    for function in (aorrtc, grow, insert, query, recheck):
        assert len(function.signatures) == 1, function


def test_moveit_s_default_is_there():
    assert all("RRTConnect" in pipelines[name] for name in ("native", "ompl"))


@pytest.mark.slow
@pytest.mark.cases("native-*", "chomp-*", "stomp-*", "ompl-RRTConnect", "ompl-PRM", "ompl-BFMT")
@each_planner
def test_it_solves_an_easy_problem_or_says_that_it_cannot(pipeline, name):
    scene = panda_wall()
    began = time.monotonic()
    result = plan(
        scene, request(beyond_panda(), pipeline_id=pipeline, planner_id=name, planning_time=SECONDS)
    )
    assert time.monotonic() - began < SECONDS + late(name)
    assert result.planner_id == name  # never another one in its stead
    if result.ok:
        judge(scene, result.trajectory)
    else:
        assert result.code in (ErrorCode.TIMED_OUT, ErrorCode.PLANNING_FAILED)
        assert name in result.message and result.trajectory is None


@pytest.mark.slow
@pytest.mark.cases(
    "native-RRTConnect", "native-AORRTC", "chomp-*", "stomp-*", "ompl-RRTConnect", "ompl-RRTstar"
)
@each_planner
def test_it_keeps_to_its_time(pipeline, name):
    scene, goal = walled_in()
    began = time.monotonic()
    result = plan(scene, request(goal, pipeline_id=pipeline, planner_id=name, planning_time=0.3))
    assert time.monotonic() - began < 0.3 + late(name)
    assert result.code in (ErrorCode.TIMED_OUT, ErrorCode.PLANNING_FAILED) and name in result.message


@pytest.mark.slow
@pytest.mark.cases(
    "native-*", "chomp-*", "stomp-*", "ompl-RRTConnect", "ompl-PRM", "ompl-RRTstar", "ompl-BFMT"
)
@each_planner
def test_it_says_which_parameters_it_has(pipeline, name):
    words = f"unknown parameter of planner {name!r} 'no_such'; it has: "
    with pytest.raises(UnknownNameError, match=re.escape(words)):
        plan(
            panda_wall(),
            request(beyond_panda(), pipeline_id=pipeline, planner_id=name, parameters={"no_such": 1}),
        )


@pytest.mark.slow
@pytest.mark.cases(
    "native-RRTConnect", "native-AORRTC", "chomp-*", "stomp-*", "ompl-RRTConnect", "ompl-RRTstar"
)
@each_planner
def test_it_is_cancelled(pipeline, name):
    scene, goal = walled_in()
    cancel = threading.Event()
    threading.Timer(0.2, cancel.set).start()
    began = time.monotonic()
    result = plan(
        scene, request(goal, pipeline_id=pipeline, planner_id=name, planning_time=120.0), cancel=cancel
    )
    assert time.monotonic() - began < 0.2 + late(name)
    if "FMT" not in name:  # they may have used up their samples before
        assert result.code is ErrorCode.PREEMPTED and name in result.message
    assert not result.ok


FAST = [p for p in ALL if p[1] in ("RRTConnect", "BKPIECE1", "KPIECE1", "LBKPIECE1")]


@pytest.mark.slow
@pytest.mark.cases("native-RRTConnect", "ompl-RRTConnect", "ompl-KPIECE1")
@pytest.mark.parametrize(("pipeline", "name"), FAST)
def test_the_same_seed_gives_the_same_motion(pipeline, name):
    scene, goal = panda_wall(), beyond_panda()
    asked = request(goal, pipeline_id=pipeline, planner_id=name, seed=3, planning_time=20.0)
    a, b = (plan(scene, asked) for _ in range(2))
    assert a.ok and b.ok
    np.testing.assert_array_equal(a.trajectory.positions, b.trajectory.positions)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({name for _, name in ALL}))
@pytest.mark.parametrize(
    "form", ["{}", " {} ", "geometric::{}", "{}kConfigDefault", "geometric::{}kConfigDefault", "arm[{}]",
             "arm[{}kConfigDefault]", "arm[geometric::{}]"],
)  # fmt: skip
def test_every_spelling_means_the_planner(name, form):
    assert normalized_planner_id(form.format(name)) == name


def test_none_given_is_the_default():
    assert normalized_planner_id("") == "RRTConnect"


@pytest.mark.slow
@pytest.mark.cases("EST-EST", "panda_arm*", "geometric*", "LIN-LIN", "CHOMP-CHOMP", "-RRTConnect")
@pytest.mark.parametrize(
    ("asked", "name"),
    [
        ("RRTstar", "RRTstar"), ("PRMstarkConfigDefault", "PRMstar"), ("EST", "EST"),
        ("panda_arm[KPIECE]", "KPIECE1"), ("geometric::EST", "EST"),
        ("LIN", "LIN"), ("CHOMP", "CHOMP"), ("", "RRTConnect"),
    ],
)  # fmt: skip
def test_without_a_pipeline_a_name_is_looked_up_in_all(asked, name):
    assert named_planner("", asked)[0] == name
    result = plan(panda_wall(), request(beyond_panda(), pipeline_id="", planner_id=asked, planning_time=4.0))
    assert result.planner_id == name


@pytest.mark.parametrize(
    ("pipeline", "name", "remedy"),
    [
        ("native", "RRTstar", "pipeline 'ompl' has it"),
        ("ompl", "EST", "pipeline 'native' has it"),
        ("ompl", "LIN", "pipeline 'pilz' has it"),
        ("", "SBL", "nearest in kind: EST"),
        ("", "rrtstar", "did you mean 'RRTstar'"),
    ],
)
def test_the_message_names_the_pipeline_or_the_nearest_planners(pipeline, name, remedy):
    with pytest.raises(UnknownNameError, match=re.escape(remedy)):
        named_planner(pipeline, name)


def test_relatives_of_missing_planners_exist_and_missing_ones_do_not():
    every = {name for table in pipelines.values() for name in table}
    assert (
        not every & set(SIMILAR_PLANNERS) and {n for near in SIMILAR_PLANNERS.values() for n in near} <= every
    )


def test_est_takes_the_parameters_of_moveits_files():
    given = request(beyond_panda(), planner_id="EST", parameters={"range": 0.0, "goal_bias": 0.1})
    first, again = plan(panda_wall(), given), plan(panda_wall(), given)
    assert first.ok and np.array_equal(first.trajectory.positions, again.trajectory.positions)
