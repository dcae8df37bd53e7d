"""Arms that work side by side at their own pace: each arm runs its own program, with its own task context."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from armcell.collision.inter_arm_checker import check_arms
from armcell.core import ErrorCode, Outcome
from armcell.execution import ArmDriver, run_cooperatively
from armcell.planning import RunningMotion
from armcell.tasks.arms.motion_coordinator import CLEARANCE, PATIENCE, ArmContext, MotionCoordinator
from armcell.tasks.context import TaskContext

Program = Callable[[ArmContext], Outcome | None]


@dataclass(frozen=True, repr=False)
class SideBySide(Outcome):
    """Result of arms that worked side by side, each with its own program: the error code and message of the
    first failure, and statistics for each arm.
    """

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
    """Run two or more arms side by side, with one program per arm.
    If one program fails, the others end after their current stage.

    An arm of the cell without a program rests, as an obstacle for the other arms.

    Raises:
        InputError: fewer than two groups, or groups with common joints.
        Any exception of a program, after all arms have stopped.
    """
    groups = tuple(programs)
    model = ctx.scene().model
    check_arms(model, groups, "program")
    coordinator = MotionCoordinator(groups, clearance, patience)
    outcomes: dict[str, Outcome] = {}
    began, scene = ctx.driver.now, ctx.scene()
    for group in groups:
        coordinator.running[group] = RunningMotion.at_rest(scene, group, began)

    def program(group: str) -> Callable[[ArmDriver], None]:
        def run(driver: ArmDriver) -> None:
            mine = contexts[group]
            mine.driver = driver
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
        run_cooperatively(
            ctx.driver, {g: model.group(g).joint_names for g in groups}, {g: program(g) for g in groups}
        )
    finally:
        if not cancelled and any(not o.ok for o in outcomes.values()):
            ctx.cancel.clear()  # set above to end the other programs
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
