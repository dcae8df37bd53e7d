"""The search over stages: depth first, lazy, with backtracking; its reasons; its end on cancel."""

from __future__ import annotations

import time

import pytest

from armcell.core import ErrorCode, Outcome
from armcell.tasks import PartialSolution, SearchState, TaskSettings, search


class Options:
    """A stage that offers options by name and logs what it is asked. `bad` ones are rejected."""

    def __init__(self, name, options, log, bad=lambda option, solution: None):
        self.name, self._options, self._log, self._bad = name, options, log, bad

    def propose(self, solution, planning):
        for option in self._options:
            self._log.append(option)
            reason = self._bad(option, solution)
            if reason:
                planning.reject(self.name, option, reason)
                continue
            yield solution.then(f"do {option}", **{self.name: option})


@pytest.fixture
def planning():
    return SearchState(TaskSettings())


@pytest.fixture
def log():
    return []


def start() -> PartialSolution:
    return PartialSolution(scene=object())


def test_no_stages_are_done_at_once(planning):
    begin = start()
    assert search([], begin, planning) is begin


def test_takes_the_first_options_and_looks_at_no_other(planning, log):
    stages = [Options("a", ["a1", "a2"], log), Options("b", ["b1", "b2"], log)]
    found = search(stages, start(), planning)
    assert found.steps == ("do a1", "do b1")
    assert found.data == {"a": "a1", "b": "b1"}
    assert log == ["a1", "b1"]
    assert not planning.rejections.details


def test_backtracks_to_the_latest_choice_first(planning, log):
    """b2 is the only one that c takes, and only after a2."""

    def right(c, solution):
        return None if solution.data["b"] == "b2" and solution.data["a"] == "a2" else "does not fit"

    stages = [
        Options("a", ["a1", "a2", "a3"], log),
        Options("b", ["b1", "b2", "b3"], log),
        Options("c", ["c1"], log, right),
    ]
    found = search(stages, start(), planning)
    assert found.steps == ("do a2", "do b2", "do c1")
    assert log == ["a1", "b1", "c1", "b2", "c1", "b3", "c1", "a2", "b1", "c1", "b2", "c1"]


def test_what_a_branch_added_is_gone_in_the_next(planning, log):
    seen = []
    stages = [
        Options("a", ["a1", "a2"], log),
        Options(
            "b",
            ["b1"],
            log,
            lambda b, solution: seen.append(solution) or (solution.data["a"] == "a1" and "no"),
        ),
    ]
    found = search(stages, start(), planning)
    assert [d.steps for d in seen] == [("do a1",), ("do a2",)]
    assert found.data == {"a": "a2", "b": "b1"}


def test_nothing_fits_collects_every_reason(planning, log):
    stages = [
        Options("a", ["a1", "a2"], log),
        Options("b", ["b1", "b2"], log, lambda b, d: f"too hot: {d.data['a']}" if b == "b1" else "too cold"),
    ]
    assert search(stages, start(), planning) is None
    rejections = planning.rejections
    assert rejections.details == [
        ("b", "b1", "too hot: a1"),
        ("b", "b2", "too cold"),
        ("b", "b1", "too hot: a2"),
        ("b", "b2", "too cold"),
    ]
    assert rejections.counts == {("b", "too hot"): 2, ("b", "too cold"): 2}
    text = rejections.summary()
    assert "4 rejected (" in text
    assert "2 x b: too hot" in text and "2 x b: too cold" in text and "too hot: a1" in text


def test_a_stage_without_options_is_no_plan(planning, log):
    assert search([Options("a", ["a1"], log), Options("b", [], log)], start(), planning) is None
    assert planning.rejections.summary() == "no candidates"


def test_cancelled_before_looks_at_nothing(planning, log):
    planning.cancel.set()
    assert search([Options("a", ["a1"], log)], start(), planning) is None
    assert log == []


def test_cancel_during_the_search_ends_it(planning, log):
    def cancel_at_the_second(option, solution):
        if solution.data["a"] == "a2":
            planning.cancel.set()
        return "no"

    stages = [Options("a", ["a1", "a2", "a3"], log), Options("b", ["b1"], log, cancel_at_the_second)]
    assert search(stages, start(), planning) is None
    assert log == ["a1", "b1", "a2", "b1"]


def test_an_error_in_a_stage_is_not_taken_for_a_rejection(planning, log):
    def broken(option, solution):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        search([Options("a", ["a1"], log, broken)], start(), planning)
    assert not planning.rejections.details


@pytest.mark.parametrize(
    ("code", "looked_at"),
    [(ErrorCode.START_STATE_IN_COLLISION, ["a1"]), (ErrorCode.PLANNING_FAILED, ["a1", "a2"])],
)
def test_a_start_in_collision_ends_the_search(planning, log, code, looked_at):
    """No other candidate changes where the robot stands."""

    class Move:
        name = "move"

        def propose(self, solution, planning):
            planning.reject(self.name, "", "it failed", Outcome(code))
            yield from ()

    assert search([Options("a", ["a1", "a2"], log), Move()], start(), planning) is None
    assert log == looked_at
    assert planning.failure.code is code


@pytest.mark.parametrize(("wait", "found"), [(time.sleep, True), (lambda s: spin(s), False)])
def test_the_budget_is_of_work_not_of_waiting(log, wait, found):
    """A machine that other programs fill lets this one wait; that costs nothing of the budget."""

    class Slow(Options):
        def propose(self, solution, planning):
            wait(0.2)
            yield from super().propose(solution, planning)

    planning = SearchState(TaskSettings(planning_budget=0.1))
    result = search([Slow("a", ["a1"], log)], start(), planning)
    assert (result is not None) == found
    assert (planning.time_left > 0) == found


def spin(seconds: float) -> None:
    began = time.thread_time()
    while time.thread_time() - began < seconds:
        pass
