"""Two arms' programs side by side, each at its own pace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from armcell.collision.arms import check_two
from armcell.control.turns import ArmView, run_by_turns
from armcell.core import ErrorCode, InputError, Outcome
from armcell.planning import RunningMotion
from armcell.tasks.arms.context import ArmContext
from armcell.tasks.arms.traffic import Traffic
from armcell.tasks.context import TaskContext

CLEARANCE = 0.02  # [m] between the arms
PATIENCE = 30.0  # [s] of the driver's clock that an arm waits for its way

Program = Callable[[ArmContext], Outcome | None]


@dataclass(frozen=True)
class SideBySide(Outcome):
    """How two programs ended; the first failure's code and message."""

    makespan: float = 0.0  # [s] of the driver's clock
    outcomes: Mapping[str, Outcome] = field(default_factory=dict)
    waited: Mapping[str, float] = field(default_factory=dict)  # [s] by arm
    made_way: Mapping[str, int] = field(default_factory=dict)
    searched: Mapping[str, int] = field(default_factory=dict)  # motions that went another way in space-time


def side_by_side(
    ctx: TaskContext,
    programs: Mapping[str, Program],
    clearance: float = CLEARANCE,
    patience: float = PATIENCE,
) -> SideBySide:
    """Run a program per arm, by group. When one fails the other ends after its running stage.

    Raises:
        InputError: not two groups that share no joint.
        Whatever a program raises; both arms have been stopped then.
    """
    if len(programs) != 2:
        raise InputError(f"{len(programs)} programs given, two arms have two")
    groups = tuple(programs)
    model = ctx.scene().model
    check_two(model, (groups[0], groups[1]))
    traffic = Traffic((groups[0], groups[1]), clearance, patience)
    outcomes: dict[str, Outcome] = {}
    began, scene = ctx.driver.now, ctx.scene()
    for group in groups:
        traffic.running[group] = RunningMotion.standing(scene, group, began)

    def program(group: str) -> Callable[[ArmView], None]:
        def run(view: ArmView) -> None:
            mine = contexts[group]
            mine.driver = view
            found = programs[group](mine)
            outcomes[group] = found if isinstance(found, Outcome) else Outcome(ErrorCode.SUCCESS)
            if not outcomes[group].ok:
                mine.cancel.set()
            traffic.park(mine)

        return run

    contexts = {group: ArmContext(ctx, group, ctx.driver, traffic) for group in groups}
    ctx.at_work = tuple(contexts.values())
    cancelled = ctx.cancel.is_set()
    try:
        run_by_turns(
            ctx.driver, {g: model.group(g).joint_names for g in groups}, {g: program(g) for g in groups}
        )
    finally:
        if not cancelled and any(not o.ok for o in outcomes.values()):
            ctx.cancel.clear()  # it was set here, to end the other program
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
        waited=traffic.waited, made_way=traffic.made_way, searched=traffic.searched,
    )  # fmt: skip
