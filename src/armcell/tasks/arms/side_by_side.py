"""Programs of two arms that work side by side, each at its own pace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from armcell.collision.arms import check_two
from armcell.core import ErrorCode, InputError, Outcome
from armcell.execution.turns import ArmView, run_by_turns
from armcell.planning import RunningMotion
from armcell.tasks.arms.context import ArmContext
from armcell.tasks.arms.coordinator import MotionCoordinator
from armcell.tasks.context import TaskContext

CLEARANCE = 0.02  # [m] between the arms
PATIENCE = 30.0  # [s] of the driver's clock that an arm waits until its motion may start

Program = Callable[[ArmContext], Outcome | None]


@dataclass(frozen=True)
class SideBySide(Outcome):
    """Result of two programs: the first failure's code and message, and statistics per arm."""

    makespan: float = 0.0  # [s] of the driver's clock
    outcomes: Mapping[str, Outcome] = field(default_factory=dict)
    waited: Mapping[str, float] = field(default_factory=dict)  # [s] by arm
    yielded: Mapping[str, int] = field(default_factory=dict)
    searched: Mapping[str, int] = field(default_factory=dict)  # motions found by the search in space and time


def side_by_side(
    ctx: TaskContext,
    programs: Mapping[str, Program],
    clearance: float = CLEARANCE,
    patience: float = PATIENCE,
) -> SideBySide:
    """Run one program per arm. If one fails, the other ends after its running stage.

    Raises:
        InputError: not exactly two groups without common joints.
        Any exception of a program, after both arms have stopped.
    """
    if len(programs) != 2:
        raise InputError(f"{len(programs)} programs given, two arms need two")
    groups = tuple(programs)
    model = ctx.scene().model
    check_two(model, (groups[0], groups[1]))
    coordinator = MotionCoordinator((groups[0], groups[1]), clearance, patience)
    outcomes: dict[str, Outcome] = {}
    began, scene = ctx.driver.now, ctx.scene()
    for group in groups:
        coordinator.running[group] = RunningMotion.standing(scene, group, began)

    def program(group: str) -> Callable[[ArmView], None]:
        def run(view: ArmView) -> None:
            mine = contexts[group]
            mine.driver = view
            found = programs[group](mine)
            outcomes[group] = found if isinstance(found, Outcome) else Outcome(ErrorCode.SUCCESS)
            if not outcomes[group].ok:
                mine.cancel.set()
            coordinator.park(mine)

        return run

    contexts = {group: ArmContext(ctx, group, ctx.driver, coordinator) for group in groups}
    ctx.at_work = tuple(contexts.values())
    cancelled = ctx.cancel.is_set()
    try:
        run_by_turns(
            ctx.driver, {g: model.group(g).joint_names for g in groups}, {g: program(g) for g in groups}
        )
    finally:
        if not cancelled and any(not o.ok for o in outcomes.values()):
            ctx.cancel.clear()  # set above to end the other program
        for group, mine in contexts.items():
            for report in mine.reports:
                report.name = f"{group}: {report.name}"
            ctx.reports += mine.reports
        ctx.reports.sort(key=lambda r: r.started_s)
        ctx.holding = {name: held for mine in contexts.values() for name, held in mine.holding.items()}
        ctx.at_work = ()
    first = min(
        (o for o in outcomes.values() if not o.ok),
        key=lambda o: o.code is ErrorCode.PREEMPTED,
        default=Outcome(ErrorCode.SUCCESS),
    )
    return SideBySide(
        first.code, first.message, first.evidence, makespan=ctx.driver.now - began, outcomes=outcomes,
        waited=coordinator.waited, yielded=coordinator.yielded, searched=coordinator.searched,
    )  # fmt: skip
