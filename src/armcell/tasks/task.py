"""A task: stages that are checked as a whole, planned, and ranked by what their plans cost."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

from armcell.core import ErrorCode, Outcome
from armcell.tasks.context import TaskContext
from armcell.tasks.costs import Cost, duration
from armcell.tasks.failures import stage_rows, stage_table
from armcell.tasks.interfaces import check_task
from armcell.tasks.search import Draft, Planning, Stage, solutions


@dataclass(frozen=True)
class TaskPlan(Outcome):
    """Complete plans of a task, the cheapest first.

    Evidence: `stages`, what became of each stage; `rejections`, every candidate that was not used (stage,
    candidate, reason).
    """

    solutions: tuple[Draft, ...] = ()
    costs: tuple[float, ...] = ()  # of the solutions

    @property
    def best(self) -> Draft | None:
        """The cheapest; None where none was found."""
        return self.solutions[0] if self.solutions else None

    def table(self) -> str:
        """What became of each stage, a line each."""
        return stage_table(self.evidence.get("stages", ()))


@dataclass(frozen=True, eq=False)
class Task:
    """Stages with a name, and what ranks their plans."""

    name: str
    stages: tuple[Stage, ...]
    cost: Cost = duration

    def plan(self, start: Draft, planning: Planning, count: int = 1) -> TaskPlan:
        """Look for so many complete plans; no stage looks at more candidates than they take.

        Returns:
            SUCCESS with one plan or more, also where there are fewer than `count`; PREEMPTED; the code of the
            only motion or of the one that makes all hopeless; TIMED_OUT when the planning budget was used up
            before; PLANNING_FAILED with what was rejected.
        Raises:
            TaskError: stages lack something; before anything is planned.
        """
        check_task(self.stages, start, self.name)
        found = list(islice(solutions(self.stages, start, planning), count))
        details = planning.rejections.details
        evidence = {"rejections": details, "stages": stage_rows(planning.tallies)}
        if found:
            ranked = sorted(((self.cost(draft.since(start)), i) for i, draft in enumerate(found)))
            return TaskPlan(
                ErrorCode.SUCCESS, "", evidence,
                solutions=tuple(found[i] for _, i in ranked), costs=tuple(cost for cost, _ in ranked),
            )  # fmt: skip
        if planning.cancel.is_set():
            return TaskPlan(ErrorCode.PREEMPTED, f"{self.name}: cancelled", evidence)
        failure, name, code = planning.failure, self.name, ErrorCode.PLANNING_FAILED
        if planning.time_left <= 0:
            code = ErrorCode.TIMED_OUT
            name += f": out of time after {planning.settings.planning_budget:g} s (planning_budget)"
        if failure is not None and (len(self.stages) == 1 or planning.hopeless):
            return TaskPlan(failure.code, f"{name}: {failure.message}", {**failure.evidence, **evidence})
        return TaskPlan(code, f"{name}: {planning.rejections.summary()}", evidence)


def tell_rejected(ctx: TaskContext, plan: TaskPlan, what: str) -> None:
    """An event with the candidates that were not used before a plan was found, and why, if there were any."""
    rejected = plan.evidence.get("rejections", ())
    if rejected:
        ctx.emit("plan", f"{what}: planned, {len(rejected)} rejected", evidence=plan.evidence)
