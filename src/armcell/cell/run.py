"""Running a cell's task and telling how it went, as data."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from armcell.cell.cell import Cell
from armcell.cell.live import LiveCell
from armcell.cell.perceiving import PerceivingDriver
from armcell.cell.schema import StepSpec
from armcell.cell.script import load_script
from armcell.cell.versions import versions
from armcell.core import Contact, ErrorCode, InputError, Outcome
from armcell.grasping import Placement
from armcell.tasks import TaskFailed

PLACEMENT_TOLERANCE = 0.005  # [m]


def run_task(cell: Cell, live: LiveCell, seed: int | None, mode: str) -> dict[str, Any]:
    """Perform the cell's task on a live cell.

    Args:
        seed: the draw that the cell was connected with; None where things are as the cell file says.
    Returns:
        The run as JSON-ready data; the same seed gives the same but for `*planning_time_s` and `wall_time_s`.
    Raises:
        InputError: the cell has no task.
    """
    if cell.spec.script is not None:
        return _run_script(cell, live, seed, mode)
    if not cell.spec.task:
        raise InputError(
            "the cell has no task",
            file=cell.file,
            cure="add 'task: [...]' or 'script: task.py', or use the Python API",
        )
    began = time.monotonic()
    outcome, placements = Outcome(ErrorCode.SUCCESS), []
    for step in cell.spec.task:
        try:
            outcome = _perform(live, step)
        except InputError as error:  # the run so far is worth its report
            outcome = Outcome(ErrorCode.FAILURE, str(error))
        if step.goal and isinstance(target := outcome.evidence.get("placement"), Placement):
            placements.append((step.goal.object, target))
        if not outcome.ok:
            break
    return result_of(cell, live, seed, mode, outcome, time.monotonic() - began, placements)


def _run_script(cell: Cell, live: LiveCell, seed: int | None, mode: str) -> dict[str, Any]:
    task = load_script(cell.spec.script or "", cell.file)
    began = time.monotonic()
    try:
        found = task(live)
        outcome = found if isinstance(found, Outcome) else Outcome(ErrorCode.SUCCESS)
    except TaskFailed as failed:
        outcome = failed.outcome
    except InputError as error:  # the run so far is worth its report
        outcome = Outcome(ErrorCode.FAILURE, str(error))
    result = result_of(cell, live, seed, mode, outcome, time.monotonic() - began)
    result["measures"] = {k: v for k, v in outcome.evidence.items() if isinstance(v, int | float | str)}
    return result


def _perform(live: LiveCell, step: StepSpec) -> Outcome:
    if step.pick is not None:
        return live.arm.pick(step.pick)
    if step.place is not None:
        return live.arm.place(step.place.object, step.place.on, step.place.at, step.place.up)
    if step.transfer is not None:
        t = step.transfer
        look = partial(live.look, t.look) if t.look is not None else None
        return live.arm.transfer(t.object, t.on, t.at, t.up, look)
    if step.hold is not None:
        return (next(iter(live.arms.values()), None) or live.arm).hold(step.hold)
    if step.look is not None:
        return live.look(step.look)
    return _move(live, step.move or "home")


def _move(live: LiveCell, state: str) -> Outcome:
    """Move to a named state; of several arms, each that has the state, one after the other."""
    tables = live.model.named_states
    arms = [arm for group, arm in live.arms.items() if state in tables.get(group, {})]
    outcome = Outcome(ErrorCode.SUCCESS)
    for arm in arms if len(live.arms) > 1 and arms else [live.arm]:
        outcome = arm.move_to(state)
        if not outcome.ok:
            break
    return outcome


def result_of(
    cell: Cell, live: LiveCell, seed: int | None, mode: str, outcome: Outcome, wall: float,
    placements: Sequence[tuple[str, Placement]] = (),
) -> dict[str, Any]:  # fmt: skip
    """How a run ended, as `run_task` tells it, for one that another program has led.

    Args:
        live: still connected; to be called in the thread that steps it.
        outcome: success is taken back where physics saw unwanted contacts.
        wall: [s] that it took.
        placements: objects, and where they should lie now.
    """
    live.ctx.report_news()
    poses = live.driver.object_poses()
    if isinstance(live.driver, PerceivingDriver):  # judged by where it is, not by where the task believes it
        truth = live.driver.true_poses()
        poses |= {name: truth[name] for name in cell.moved_unseen(mode)}
    errors = [
        float(np.linalg.norm(poses[name].translation - target.T_world_object.translation))
        for name, target in placements
    ]
    unwanted = [
        {"body_a": c.body_a, "body_b": c.body_b, "time_s": c.time, "depth_m": c.depth, "steps": c.count}
        for c in live.driver.unwanted_contacts()
    ]
    reports = [r.as_dict() for r in live.ctx.reports]
    failed_at = _failed_at(outcome, reports, unwanted)
    lost = [{"object": name, "how": how} for name, how in live.ctx.lost.items()]
    outcome = _judged(outcome, errors, unwanted, lost)
    clearances = [r["clearance_m"] for r in reports if r["clearance_m"] is not None]
    slips = [r["slip_m"] for r in reports if r["slip_m"] is not None]
    held = [r["slip_m"] for r in reports if r["slip_m"] is not None and r["name"] == "hold"]
    return {
        "success": outcome.ok,
        "error_code": int(outcome.code),
        "error_name": outcome.code.name,
        "message": outcome.message,
        "failed_at": None if outcome.ok else failed_at,
        "cell": cell.name,
        "mode": mode,
        "seed": seed,
        "randomized": {} if seed is None else cell.draw(seed),
        "stages": reports,
        "slip_m": max(held) if held else None,  # during the hold
        "max_stage_slip_m": max(slips) if slips else None,
        "placement_error_m": max(errors) if errors else None,
        "unwanted_contacts": unwanted,
        "lost": lost,
        "min_clearance_m": min(clearances) if clearances else None,
        "welds": [
            {
                "object": w.object,
                "gripper": w.gripper,
                "time_s": w.time,
                "reason": w.reason,
                "released_s": w.released_at,
            }
            for w in live.driver.welds()
        ],
        "task_time_s": live.driver.now,  # the driver's clock
        "total_planning_time_s": sum(r["planning_time_s"] for r in reports),
        "wall_time_s": wall,
        "versions": versions(),
    }


def contact_in_words(contact: Mapping[str, Any]) -> str:
    """An unwanted contact of a run's result in one line."""
    pair, time = f"{contact['body_a']} touched {contact['body_b']}", contact["time_s"]
    return f"{pair} at {time:.2f} s, {contact['depth_m'] * 1000:.1f} mm deep"


def complaints(result: Mapping[str, Any]) -> list[str]:
    """What makes a run fail whatever its task or script returned: unwanted contacts and lost objects."""
    contacts = [f"unwanted contact: {contact_in_words(c)}" for c in result.get("unwanted_contacts", ())]
    return contacts + [f"lost object: {row['how']}" for row in result.get("lost", ())]


def _failed_at(
    outcome: Outcome, reports: list[dict[str, Any]], unwanted: list[dict[str, Any]]
) -> dict[str, str]:
    """The stage and the pair of bodies that a failure is of, as far as there are such.

    Where planning failed, the stage that found nothing, and what touches at the start or goal; else the stage
    that was carried out last of those that failed, and what touched first of what should not.
    """
    empty = [row["stage"] for row in outcome.evidence.get("stages", ()) if not row["passed"]]
    broken = empty or [report["name"] for report in reversed(reports) if not report["ok"]]
    touching = [(c["body_a"], c["body_b"]) for c in unwanted]
    found = outcome.evidence.get("contacts", ())
    touching += [(c.body_a, c.body_b) for c in found if isinstance(c, Contact)]
    return {
        "stage": broken[0] if broken else "",
        "pair": " and ".join(sorted(touching[0])) if touching else "",
    }


def _judged(
    outcome: Outcome, errors: list[float], unwanted: list[dict[str, Any]], lost: list[dict[str, Any]]
) -> Outcome:
    """A run with an unwanted contact, a lost object or a misplaced one did not succeed."""
    if not outcome.ok:
        return outcome
    if unwanted:
        return Outcome(ErrorCode.CONTROL_FAILED, contact_in_words(unwanted[0]))
    if lost:
        return Outcome(ErrorCode.CONTROL_FAILED, lost[0]["how"])
    if errors and max(errors) > PLACEMENT_TOLERANCE:
        return Outcome(
            ErrorCode.CONTROL_FAILED, f"the object lies {max(errors) * 1000:.1f} mm from where it should"
        )
    return outcome
