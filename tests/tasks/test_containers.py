"""Containers: which of their stages are asked, in which order plans come, what a broken task says."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from tests.tasks.helpers import nominal, panda_pick

from armcell.core import InputError, JointTrajectory, NamedGoal
from armcell.planning import warm_up
from armcell.tasks import (
    Alternatives,
    Fallbacks,
    Lookahead,
    Motion,
    PartialSolution,
    SearchState,
    Serial,
    Task,
    TaskError,
    TaskSettings,
    check_task,
    clearance,
    costs,
    duration,
    path_length,
    pick_stages,
    place_stages,
    search,
    solutions,
    weighted,
)
from armcell.tasks.costs import motions
from armcell.tasks.stages import AppendPlannedMotion, Connect, MoveStraight


class Options:
    """A stage that offers options by name and logs what it is asked; `bad` ones are rejected."""

    def __init__(self, name, options, log=None, bad=(), requires=(), provides=(), consumes=()):
        self.name, self._options, self._log, self._bad = name, options, [] if log is None else log, bad
        self.requires, self.provides, self.consumes = requires, provides, consumes

    def propose(self, solution, planning):
        for option in self._options:
            self._log.append(option)
            if option in self._bad:
                planning.reject(self.name, option, "does not fit: here")
                continue
            yield solution.then(option)


@pytest.fixture
def planning():
    return SearchState(TaskSettings())


def start() -> PartialSolution:
    return PartialSolution(scene=nominal())


def steps(found):
    return ["".join(solution.steps) for solution in found]


def length_of_name(solution) -> float:
    return float(len("".join(solution.steps)))


def test_a_serial_container_is_its_stages_under_one_name(planning):
    flat = [Options("a", "ab"), Options("b", "xy"), Options("c", "12", bad="1")]
    nested = [flat[0], Serial("rest", tuple(flat[1:]))]
    assert steps(solutions(nested, start(), planning)) == steps(
        solutions(flat, start(), SearchState(TaskSettings()))
    )
    assert steps(solutions([Serial("all", ())], start(), planning)) == [""]


def test_solutions_are_worked_out_when_they_are_asked_for(planning):
    log = []
    found = solutions([Options("a", "ab", log), Options("b", "xyz", log)], start(), planning)
    assert next(found).steps == ("a", "x") and log == ["a", "x"]
    assert next(found).steps == ("a", "y") and log == ["a", "x", "y"]


def test_alternatives_come_cheapest_first(planning):
    ways = Alternatives("way", (Options("long", ["lll"]), Options("short", ["s"]), Options("mid", ["mm"])),
                        cost=length_of_name)  # fmt: skip
    assert steps(ways.propose(start().then("begun before, and no part of the cost"), planning)) == [
        "begun before, and no part of the costs",
        "begun before, and no part of the costmm",
        "begun before, and no part of the costlll",
    ]
    first, then = Options("a", ["a1", "a2", "a3"]), Options("z", ["z"])
    two = Alternatives("two each", (first, then), cost=length_of_name, most=2)
    assert steps(two.propose(start(), planning)) == ["z", "a1", "a2"]


def test_the_cheapest_alternative_that_leads_on_is_taken(planning):
    class OnlyAfter:
        name = "after"

        def propose(self, solution, planning):
            if solution.steps == ("mm",):
                yield solution

    ways = Alternatives("way", (Options("short", ["s"]), Options("mid", ["mm"])), cost=length_of_name)
    assert search([ways, OnlyAfter()], start(), planning).steps == ("mm",)


def test_fallbacks_ask_the_next_only_where_there_was_nothing(planning):
    log = []
    none, one, other = (
        Options("x", "x", log, bad="x"),
        Options("y", ["y1", "y2"], log),
        Options("z", "z", log),
    )
    assert steps(Fallbacks("way", (none, one, other)).propose(start(), planning)) == ["y1", "y2"]
    assert log == ["x", "y1", "y2"]


@pytest.mark.parametrize("kind", [Alternatives, Fallbacks])
def test_a_container_of_ways_needs_one(kind):
    with pytest.raises(InputError, match="'?way'?: a container needs at least one stage"):
        kind("way", ())


# --- ranking ---
def moving(to, seconds, near=None) -> Motion:
    """One joint from 0 to `to` and back to half of it."""
    times = np.array([0.0, seconds / 2, seconds])
    return Motion(
        "m",
        JointTrajectory(("j",), times, np.array([[0.0], [to], [to / 2]])),
        planning_time=0.01,
        clearance=near,
    )


def test_cost_terms_of_known_motions():
    solution = start().then(moving(1.0, 2.0, near=0.1), moving(-2.0, 3.0, near=0.05))
    assert duration(solution) == pytest.approx(5.0)
    assert path_length(solution) == pytest.approx(1.5 + 3.0)
    assert clearance(solution) == pytest.approx(20.0)
    assert costs["planning_time"](solution) == pytest.approx(0.02)
    assert clearance(start()) == 0.0
    assert weighted((2.0, duration), (0.5, lambda d: len(d.steps)))(solution) == pytest.approx(11.0)
    with pytest.raises(InputError, match="unknown cost term 'lenght'.*path_length"):
        costs["lenght"]


def test_solutions_are_ranked_and_no_more_are_looked_at_than_asked_for(planning):
    log = []
    task = Task("t", (Options("a", ["aaa", "a", "aa", "b"], log),), cost=length_of_name)
    plan = task.plan(start(), planning, count=3)
    assert plan.ok and steps(plan.solutions) == ["a", "aa", "aaa"] and plan.costs == (1.0, 2.0, 3.0)
    assert log == ["aaa", "a", "aa"]
    assert task.plan(start(), SearchState(TaskSettings()), count=9).costs == (1.0, 1.0, 2.0, 3.0)


# --- validation ---
def test_every_stage_that_requires_something_is_named_before_any_is_asked(planning):
    log = []
    stages = (
        Options("a", "a", log, provides=("here",)),
        Options("b", "b", log, requires=("here", "nowhere")),
        Options("c", "c", log, requires=("late",)),
        Options("d", "d", log, provides=("late",)),
        Connect("go", "arn", TaskSettings().free, target="spot"),
    )
    with pytest.raises(TaskError, match="task 'mine'") as raised:
        Task("mine", stages).plan(start(), planning)
    assert log == []
    assert raised.value.problems == (
        "stage 'b' (Options) requires 'nowhere'",
        "stage 'c' (Options) requires 'late', which 'd' provides only later",
        "stage 'go' (Connect) requires 'spot'",
        "stage 'go' (Connect): no planning group 'arn' (did you mean 'arm'?)",
    )


def test_what_containers_give():
    gives_x, gives_both = Options("x", "x", provides=("x",)), Options("xy", "y", provides=("x", "y"))
    needs_x, needs_y = Options("use x", "u", requires=("x",)), Options("use y", "v", requires=("y",))
    for kind in (Alternatives, Fallbacks):  # only what each of the ways gives
        ways = kind("ways", (gives_x, gives_both))
        check_task([ways, needs_x], start())
        with pytest.raises(TaskError, match="'use y'.*requires 'y'"):
            check_task([ways, needs_y], start())
    check_task([Serial("s", (gives_both, needs_y)), needs_x], start())
    with pytest.raises(TaskError, match="in 's': stage 'use y'.*requires 'y'"):
        check_task([Serial("s", (gives_x, needs_y))], start())
    with pytest.raises(TaskError, match="requires 'x'"):
        check_task([gives_x, Options("end of it", "e", consumes=("x",)), needs_x], start())


def test_the_recipes_stages_fit_together_and_not_in_another_order():
    """By their own interfaces: a place needs a pick, and the object is in no hand after it."""
    scene, s, hand = nominal(), panda_pick().settings, nominal().model.gripper()
    pick, place = pick_stages(scene, "cube", hand, s), place_stages("cube", "tray", hand, s)
    check_task([*pick, *place, *pick], PartialSolution(scene))
    with pytest.raises(TaskError, match="'placement'.*requires 'cube in a hand'"):
        check_task(place, PartialSolution(scene))
    with pytest.raises(TaskError, match="'placement'.*requires 'cube in a hand'"):
        check_task([*pick, *place, *place], PartialSolution(scene))
    for gone in (0, 3):  # the grasp, the closing
        with pytest.raises(TaskError):
            check_task([*pick[:gone], *pick[gone + 1 :], *place], PartialSolution(scene))
    check_task(place, PartialSolution(scene.with_attached("cube", hand.tcp_link, hand.hand_links)))


def test_a_wrong_link_and_a_wrong_object_are_found():
    s, hand = TaskSettings(), nominal().model.gripper()
    lift = MoveStraight("lift", hand.arm_group, "panda_hend_tcp", s.near, (0, 0, 0.1))
    with pytest.raises(TaskError) as raised:
        check_task([*pick_stages(nominal(), "cube", hand, s), *place_stages("cube", "try", hand, s), lift],
                   PartialSolution(nominal()))  # fmt: skip
    text = str(raised.value)
    assert (
        "no object 'try' (did you mean 'tray'?)" in text and "no link 'panda_hend_tcp' (did you mean" in text
    )


# --- the report ---
def test_the_table_counts_every_stage_and_keeps_the_best_near_miss(planning):
    """Independent of the search: counts worked out by hand. a1 -> b1, b2 fail; a2 -> the same; a3 is bad."""
    stages = (
        Options("a", ["a1", "a2", "a3"], bad=("a3",)),
        Fallbacks("either", (Options("b", ["b1", "b2"], bad=("b1", "b2")), Options("c", "c", bad="c"))),
    )
    plan = Task("t", stages).plan(start(), planning)
    rows = {row["stage"]: row for row in plan.evidence["stages"]}
    assert list(rows) == ["a", "either", "either/b", "either/c"]
    counts = {name: (row["asked"], row["passed"], row["failed"]) for name, row in rows.items()}
    assert counts == {"a": (1, 2, 1), "either": (2, 0, 0), "either/b": (2, 0, 4), "either/c": (2, 0, 2)}
    assert rows["either/b"]["near_miss"] == "b1" and rows["either/b"]["why"] == "does not fit: here"
    assert rows["either/b"]["reasons"] == {"does not fit": 4}
    lines = plan.table().splitlines()
    assert lines[0].split() == ["stage", "tried", "gave", "failed", "time", "best", "near", "miss"]
    assert lines[3].startswith("  b ") and lines[3].endswith("b1: does not fit: here")
    assert lines[2].rstrip().endswith("ms")


def test_what_foresight_asked_is_in_the_table_and_not_among_the_rejections(planning):
    ahead = Lookahead("what comes next", (Options("later", ["l1", "l2"], bad=("l1", "l2")),))
    plan = Task("t", (Options("a", ["a1", "a2"]), ahead)).plan(start(), planning)
    rows = {row["stage"]: row for row in plan.evidence["stages"]}
    assert rows["what comes next/later"]["failed"] == 4 and rows["what comes next"]["failed"] == 2
    assert [stage for stage, _, _ in plan.evidence["rejections"]] == ["what comes next"] * 2


def test_a_planner_as_a_reserve():
    """A straight way that cannot be done whole falls back to a free motion; both real."""
    warm_up()  # or compiling would use up the search's time
    planning = SearchState(TaskSettings())
    s, hand = TaskSettings(), nominal().model.gripper()
    down = MoveStraight("straight down", hand.arm_group, hand.tcp_link, s.near, (0, 0, -1.0))
    home = Connect("go round", hand.arm_group, s.free, goal=NamedGoal("home"))
    plan = Task("down or home", (Fallbacks("way", (down, home)),)).plan(start(), planning)
    assert [step.name for step in plan.best.steps] == ["go round"]
    rows = {row["stage"]: row for row in plan.evidence["stages"]}
    assert rows["way/straight down"]["failed"] == 1 and rows["way/go round"]["passed"] == 1


def test_planned_says_which_motion_it_appends():
    with pytest.raises(TaskError, match=r"stage 'planned' \(AppendPlannedMotion\) requires 'approach'"):
        check_task([AppendPlannedMotion("approach", "after_approach")], start())


# --- candidates gone into at once ---
def threads(count, **more):
    return SearchState(TaskSettings(planning_threads=count, **more))


class Slow:
    """A stage that takes its time [s] for each candidate, until it is cancelled; notes who asks."""

    def __init__(self, name, seen, bad="", seconds=(0.15, 0.1, 0.05, 0.0)):
        self.name, self._seen, self._bad = name, seen, bad
        self._seconds = dict(zip("abcd", seconds, strict=True))

    def propose(self, solution, planning):
        option = solution.steps[0]
        self._seen.add(threading.current_thread())
        planning.cancel.wait(self._seconds[option])
        if option in self._bad:
            planning.reject(self.name, option, "does not fit: here")
            return
        yield solution.then(option.upper())


@pytest.mark.parametrize("count", [2, 3, 8])
def test_candidates_gone_into_at_once_come_in_their_order(count):
    seen, stages = set(), lambda log: [Options("first", "abcd"), Slow("slow", log, "bd"), Options("x", "12")]
    one_by_one, at_once = threads(1), threads(count)
    expected = steps(solutions(stages(set()), start(), one_by_one))
    assert steps(solutions(stages(seen), start(), at_once)) == expected == ["aA1", "aA2", "cC1", "cC2"]
    assert len(seen) > 1 and threading.current_thread() not in seen
    assert at_once.rejections.details == one_by_one.rejections.details
    rows = {p: (t.asked, t.passed, t.reasons) for p, t in at_once.tallies.items()}
    assert rows == {p: (t.asked, t.passed, t.reasons) for p, t in one_by_one.tallies.items()}
    assert not [t for t in threading.enumerate() if t.name.startswith("plan candidates")]


def test_what_was_gone_into_in_vain_is_cancelled_and_not_told():
    planning, begun = threads(4), time.monotonic()
    slow = Slow("slow", set(), "cba", seconds=(300, 300, 300, 0))
    found = search([Options("first", "dcba"), slow], start(), planning)
    assert steps([found]) == ["dD"] and planning.rejections.details == []
    assert time.monotonic() - begun < 100


def test_all_is_cancelled_with_the_task():
    planning = threads(2)
    threading.Timer(0.05, planning.cancel.set).start()
    begun, slow = time.monotonic(), Slow("slow", set(), "a", seconds=(300,) * 4)
    assert search([Options("first", "aaaaaaaa"), slow], start(), planning) is None
    assert time.monotonic() - begun < 100


def test_an_error_in_a_thread_is_the_tasks():
    class Broken:
        name = "broken"

        def propose(self, solution, planning):
            raise ZeroDivisionError("broken")
            yield

    with pytest.raises(ZeroDivisionError, match="broken"):
        search([Options("first", "ab"), Broken()], start(), threads(2))


def test_the_cpu_time_of_threads_counts():
    class Busy:
        name = "busy"

        def propose(self, solution, planning):
            until = time.thread_time() + 0.06
            while time.thread_time() < until and planning.time_left > 0:
                pass
            planning.reject(self.name, solution.steps[0], "no")
            return
            yield

    planning = threads(2, planning_budget=0.2)
    assert search([Options("first", "a" * 50), Busy()], start(), planning) is None
    assert planning.time_left <= 0 and 3 <= len(planning.rejections.details) <= 7


@pytest.mark.slow
def test_real_candidates_at_once_give_the_same_plans():
    cell, scene = panda_pick(), nominal()
    hand = next(iter(cell.model.grippers.values()))
    found = []
    for count in (1, 2, 4):
        settings = replace(cell.settings, planning_threads=count)
        stages = (*pick_stages(scene, "cube", hand, settings), *place_stages("cube", "tray", hand, settings))
        plan = Task("t", stages).plan(PartialSolution(scene), SearchState(settings), count=6)
        found.append([[m.trajectory.positions.tolist() for m in motions(d)] for d in plan.solutions])
    assert len(found[0]) == 6 and found[0] == found[1] == found[2]


def test_alternatives_are_worked_out_at_once():
    seen = set()

    def way(option):
        return Serial(option, (Options("o", option), Slow("slow", seen, "b")))

    both = Alternatives("either", (way("a"), way("b"), way("c")), cost=length_of_name)
    planning = threads(3)
    assert steps(planning.propose(both, start())) == ["aA", "cC"]
    assert len(seen) == 3 and planning.tallies[("either", "b", "slow")].reasons == {"does not fit": 1}
