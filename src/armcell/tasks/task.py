"""Tasks of stages: checks of stage interfaces before planning, plans, and their ranking by cost.

Failures of task scripts are exceptions.

Stages declare in `requires`, `provides` and `consumes` which data of a solution they read, add and remove.
`holding("cube")` is the name for "a hand holds the cube". The fields `object`, `support`, `group` and `link`
of a stage must exist in the scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import islice
from typing import Protocol, TypeVar, cast

from armcell.core import ArmcellError, ErrorCode, InputError, Outcome
from armcell.planning import warm_up
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.costs import Cost, costs, duration
from armcell.tasks.search import PartialSolution, SearchState, Stage, solutions
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stage_statistics import stage_rows, stage_table
from armcell.tasks.steps import DONE

Some = TypeVar("Some", bound=Outcome)


def holding_condition(item: str) -> str:
    """Return the name under which the stages of a task list the condition "a hand holds the object".

    Stages list this name in `requires`, `provides` or `consumes`.
    """
    return f"{item} in a hand"


class TaskError(InputError):
    """Error for a task with stages whose interfaces do not fit together. `problems` lists all faults."""

    def __init__(self, problems: Sequence[str], task: str = ""):
        self.problems = tuple(problems)
        super().__init__("; ".join(problems), element=f"task {task!r}" if task else None)


class Container(Stage, Protocol):
    """Interface of a task's stages that contain other stages. They check whether their inner stages fit
    together.
    """

    stages: tuple[Stage, ...]

    def check_interface(self, have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck: ...


@dataclass(frozen=True)
class InterfaceCheck:
    """Result of an interface check: the names that are available
    after a stage of a task, and the problems found.
    """

    have: frozenset[str]
    problems: tuple[str, ...] = ()


def check_task(stages: Sequence[Stage], start: PartialSolution, name: str = "") -> None:
    """Check the interfaces of a task's stages: every stage must find the inputs that it requires.

    Raises:
        TaskError: lists all missing inputs and unknown names.
    """
    found = serial(stages, available(start), start.scene)
    if found.problems:
        raise TaskError(found.problems, name)


def available(start: PartialSolution) -> frozenset[str]:
    """Return the names of the data that are available at the interface of a task's first stage."""
    return frozenset(start.data) | {holding_condition(item) for item in start.scene.attached}


def serial(stages: Sequence[Stage], have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
    """Check the interfaces (inputs and outputs) of a task's stages that run in sequence."""
    problems: list[str] = []
    for i, stage in enumerate(stages):
        later = {name: s.name for s in stages[:i:-1] for name in getattr(s, "provides", ())}
        found = single(stage, have, scene, later)
        problems += found.problems
        have = found.have
    return InterfaceCheck(have, tuple(problems))


def single(
    stage: Stage, have: frozenset[str], scene: PlanningScene | None, later: Mapping[str, str] = {}
) -> InterfaceCheck:
    """Check the interface (inputs and outputs) of one stage of a task. If the stage is a container, its inner
    stages are checked too.

    Args:
        later: names of later stages, by the names that they provide.
    """
    label = f"stage {stage.name!r} ({type(stage).__name__})"
    requires = frozenset(getattr(stage, "requires", ()))
    problems = [
        f"{label} requires {need!r}"
        + (f", which {later[need]!r} provides only later" if need in later else "")
        for need in sorted(requires - have)
    ]
    problems += [f"{label}: {unknown}" for unknown in _unknown(stage, scene)]
    provides = frozenset(getattr(stage, "provides", ()))
    have = have | requires  # report a missing name once, not for every later stage
    if hasattr(stage, "check_interface"):
        inner = cast(Container, stage).check_interface(have, scene)
        problems += [f"in {stage.name!r}: {problem}" for problem in inner.problems]
        have = inner.have
    return InterfaceCheck((have - frozenset(getattr(stage, "consumes", ()))) | provides, tuple(problems))


def _unknown(stage: Stage, scene: PlanningScene | None) -> Iterator[str]:
    """Check the interface of a stage: yield a message for each name
    in its fields that does not exist in the scene.
    """
    if scene is None:
        return
    model, objects = scene.model, {*scene.objects, *scene.attached}
    places = {
        "object": ("object", objects),
        "support": ("object", objects),
        "group": ("planning group", model.groups),
        "link": ("link", model.links),
    }
    for field, (kind, known) in places.items():
        name = getattr(stage, field, "")
        if isinstance(name, str) and name and name not in known:
            near = get_close_matches(name, list(known), n=1)
            mean = f" (did you mean {near[0]!r}?)" if near else f" (known: {', '.join(sorted(known)[:8])})"
            yield f"no {kind} {name!r}{mean}"


@dataclass(frozen=True, repr=False)
class TaskPlan(Outcome):
    """Outcome of planning a task: the complete solutions of its stages, cheapest first.

    Evidence: `stages`, the statistics of each stage; `rejections`, every rejected candidate (stage,
    candidate, reason).
    """

    solutions: tuple[PartialSolution, ...] = ()
    costs: tuple[float, ...] = ()  # costs of the solutions

    @property
    def best(self) -> PartialSolution | None:
        """Return the cheapest solution in the plan of a task, or None if there is none."""
        return self.solutions[0] if self.solutions else None

    def table(self) -> str:
        """Return the stage table of a task's plan as text."""
        return stage_table(self.evidence.get("stages", ()))


@dataclass(frozen=True, eq=False)
class Task:
    """Task that consists of named stages, with a cost that ranks the solutions."""

    name: str
    stages: tuple[Stage, ...]
    cost: Cost = duration

    def plan(self, start: PartialSolution, planning: SearchState, count: int = 1) -> TaskPlan:
        """Search for up to `count` complete plans of the task.

        Stages evaluate only as many candidates as the plans need.

        Returns:
            SUCCESS with at least one plan, possibly fewer than `count`; PREEMPTED; the error code of the only
            motion, or of the motion that makes all candidates infeasible; TIMED_OUT if the planning budget is
            used up; PLANNING_FAILED with the rejections.
        Raises:
            TaskError: a stage lacks an input; raised before planning.
        """
        check_task(self.stages, start, self.name)
        found = list(islice(solutions(self.stages, start, planning), count))
        details = planning.rejections.details
        evidence = {"rejections": details, "stages": stage_rows(planning.tallies)}
        if found:
            ranked = sorted(((self.cost(solution.since(start)), i) for i, solution in enumerate(found)))
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
        if failure is not None and (len(self.stages) == 1 or planning.should_stop):
            return TaskPlan(failure.code, f"{name}: {failure.message}", {**failure.evidence, **evidence})
        return TaskPlan(code, f"{name}: {planning.rejections.summary()}", evidence)


def emit_rejections(ctx: TaskContext, plan: TaskPlan, what: str) -> None:
    """Emit an event with the candidates that the stages of a successful task plan rejected.
    Emit no event if there are none.
    """
    rejected = plan.evidence.get("rejections", ())
    if rejected:
        ctx.emit("plan", f"{what}: planned, {len(rejected)} rejected", evidence=plan.evidence)


def plan_stages(
    ctx: TaskContext, stages: Sequence[Stage], what: str, scene: PlanningScene | None = None,
    settings: TaskSettings | None = None,
) -> tuple[PartialSolution | None, Outcome]:  # fmt: skip
    """Plan a task that consists of the given stages, from the measured state or from a given scene.

    An event reports rejections or the failure.

    Args:
        what: names the task in messages.
        scene: the scene in which the stages start; default: the measured one.
        settings: default: those of the context.
    Returns:
        The cheapest solution and a success, or None and the reason.
    Raises:
        TaskError: the stages do not fit together.
    """
    warm_up()  # compile before the planning time starts
    s = settings or ctx.settings
    task = Task(what, tuple(stages), costs[s.cost])
    start = PartialSolution(ctx.scene() if scene is None else scene)
    plan = task.plan(start, SearchState(s, ctx.seed, ctx.cancel), s.solutions)
    if plan.best is not None:
        emit_rejections(ctx, plan, what)
        return plan.best, DONE
    if plan.code is not ErrorCode.PREEMPTED:
        ctx.emit("error", plan.message, code=plan.code.name, **plan.evidence)
    return None, Outcome(plan.code, plan.message, plan.evidence)


class TaskFailed(ArmcellError):
    """Exception for a failed task. Scripts raise it if the outcome of a task is not a success.

    `outcome` has the code, the message and the evidence.
    """

    def __init__(self, outcome: Outcome):
        super().__init__(outcome.message or outcome.code.name)
        self.outcome = outcome


def checked(outcome: Some) -> Some:
    """Return the outcome of a task if it is a success, else raise `TaskFailed`.

    Raises:
        TaskFailed: the outcome is a failure.
    """
    if not outcome.ok:
        raise TaskFailed(outcome)
    return outcome
