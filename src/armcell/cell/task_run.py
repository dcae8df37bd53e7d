"""Runs of a cell's task or Python script, with the result as JSON-ready data.

A script is the only code that armcell runs from a cell, and only `load_script` runs it. `load_script` logs
the file name first. Commands that start other processes or connect arms before they load the script call
`announce_code` themselves, so that the log line comes first.
"""

from __future__ import annotations

import logging
import os
import runpy
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from armcell.cell.cell import Cell
from armcell.cell.cell_hashes import versions
from armcell.cell.live import LiveCell
from armcell.cell.schema import StepSpec
from armcell.core import Contact, ErrorCode, InputError, Outcome
from armcell.grasping import Placement
from armcell.tasks import TaskFailed, make_stage, perform_stages

log = logging.getLogger(__name__)

Script = Callable[[LiveCell], Outcome | None]

_announced: set[Path] = set()


def announce_code(cell: Cell, origin: str = "") -> None:
    """Log once per process which Python script runs as the task of a cell. Built-in cells log nothing.

    Args:
        origin: the source of the cell, if another user created it.
    """
    if cell.spec.script is not None:
        with suppress(InputError):  # `load_script` reports the error
            _announce(_file_of(cell.spec.script, cell.file), origin)


def load_script(name: str, cell_file: Path) -> Script:
    """Load the Python script that runs as the task of a cell, and return its function `task`.

    Loading runs the top-level code of the file, like an import.

    Raises:
        InputError: the file does not exist in the cell's folder, or it has no function `task`.
    """
    file = _file_of(name, cell_file)
    _announce(file)
    found: Any = runpy.run_path(str(file)).get("task")
    if not callable(found):
        raise InputError("has no function task(cell)", file=file)
    script: Script = found  # pyright: ignore[reportAssignmentType]
    return script


def _file_of(name: str, cell_file: Path) -> Path:
    file = (cell_file.parent / name).resolve()
    where = {"file": cell_file, "element": "script"}
    if cell_file.parent.resolve() not in file.parents or file.suffix != ".py":
        raise InputError(f"{name!r} is not a Python file in the cell's folder", **where)
    if not os.path.isfile(file):
        raise InputError(f"{name!r} does not exist", hint="put it beside the cell file", **where)
    return file


def _announce(file: Path, origin: str = "") -> None:
    own = Path(__file__).resolve().parent
    if file in _announced or own in file.parents:
        return
    _announced.add(file)
    log.warning("armcell runs Python code of this cell%s: %s", f" ({origin})" if origin else "", file)


def run_task(cell: Cell, live: LiveCell, seed: int | None, mode: str) -> dict[str, Any]:
    """Run the task of a connected cell and return the result.

    Args:
        seed: the seed that the cell was connected with; None for the nominal cell.
    Returns:
        The result as JSON-ready data. The same seed gives the same data except for `*planning_time_s` and
        `wall_time_s`.
    Raises:
        InputError: the cell has no task.
    """
    if cell.spec.script is not None:
        return _run_script(cell, live, seed, mode)
    if not cell.spec.task:
        raise InputError(
            "the cell has no task",
            file=cell.file,
            hint="add 'task: [...]' or 'script: task.py', or use the Python API",
        )
    began = time.monotonic()
    outcome, placements = Outcome(ErrorCode.SUCCESS), []
    for step in cell.spec.task:
        try:
            outcome = _perform(live, step)
        except InputError as error:  # keep the report of the steps performed so far
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
    except InputError as error:  # keep the report of the stages performed so far
        outcome = Outcome(ErrorCode.FAILURE, str(error))
    result = result_of(cell, live, seed, mode, outcome, time.monotonic() - began)
    result["measures"] = {k: v for k, v in outcome.evidence.items() if isinstance(v, int | float | str)}
    return result


def _perform(live: LiveCell, step: StepSpec) -> Outcome:
    arm = None if step.arm is None else live[step.arm]
    if step.pick is not None:
        return (arm or live.arm).pick(step.pick)
    if step.place is not None:
        return (arm or live.arm).place(step.place.object, step.place.on, step.place.at, step.place.up)
    if step.transfer is not None:
        t = step.transfer
        look = partial(live.look, t.look) if t.look is not None else None
        return (arm or live.arm).transfer(t.object, t.on, t.at, t.up, look)
    if step.hold is not None:
        return (arm or next(iter(live.arms.values()), None) or live.arm).hold(step.hold)
    if step.look is not None:
        return live.look(step.look)
    if step.stage is not None:
        ((name, values),) = step.stage.items()
        return perform_stages(live.ctx, [make_stage(name, values)], name)
    return arm.move_to(step.move or "home") if arm else _move(live, step.move or "home")


def _move(live: LiveCell, state: str) -> Outcome:
    """Move each arm to its named state before or after the task of a run, one arm after the other. Skip arms
    without a named state.
    """
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
    """Return the result of a task run that another program controlled, in the same format as `run_task`.

    Args:
        live: the connected cell; call this function in the thread that steps it.
        outcome: the outcome of the run; unwanted contacts in physics turn a success into a failure.
        wall: duration of the run [s], wall clock.
        placements: objects and their goal placements.
    """
    live.ctx.report_news()
    poses = live.driver.object_poses()
    if moved := cell.displaced_objects(mode):  # evaluate the true poses, not the task's estimates
        truth = live.driver.true_poses()
        poses |= {name: truth[name] for name in moved}
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
    outcome = _judged(outcome, errors, unwanted, lost, live.ctx.settings.placement_tolerance)
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
        "slip_m": max(held) if held else None,  # while the arm holds still
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
    """Return a one-line description of an unwanted contact in the result of a task run."""
    pair, time = f"{contact['body_a']} touched {contact['body_b']}", contact["time_s"]
    return f"{pair} at {time:.2f} s, {contact['depth_m'] * 1000:.1f} mm deep"


def run_failures(result: Mapping[str, Any]) -> list[str]:
    """Return the failures of a task run that override the outcome of the task: unwanted contacts and lost
    objects.
    """
    contacts = [f"unwanted contact: {contact_in_words(c)}" for c in result.get("unwanted_contacts", ())]
    return contacts + [f"lost object: {row['how']}" for row in result.get("lost", ())]


def _failed_at(
    outcome: Outcome, reports: list[dict[str, Any]], unwanted: list[dict[str, Any]]
) -> dict[str, str]:
    """Return the stage and the pair of bodies at which a task run failed. Both are empty if it did not fail.

    After a planning failure: the stage without a solution and the contact at the start or goal. Otherwise:
    the last failed stage and the first unwanted contact.
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
    outcome: Outcome, errors: list[float], unwanted: list[dict[str, Any]], lost: list[dict[str, Any]],
    tolerance: float,
) -> Outcome:  # fmt: skip
    """Return the outcome of a task run: a failure if there were unwanted contacts or lost or misplaced
    objects.

    Args:
        errors: distances of placed objects from their goals [m], which must not exceed the tolerance [m].
    """
    if not outcome.ok:
        return outcome
    if unwanted:
        return Outcome(ErrorCode.CONTROL_FAILED, contact_in_words(unwanted[0]))
    if lost:
        return Outcome(ErrorCode.CONTROL_FAILED, lost[0]["how"])
    if errors and max(errors) > tolerance:
        return Outcome(
            ErrorCode.CONTROL_FAILED, f"the object is {max(errors) * 1000:.1f} mm from its target pose"
        )
    return outcome
