"""Startup of a cell's layers in order, with checks and a report of their state.

Order: description (model, objects), controllers (which control which joints), drivers (connected and
publishing states), planner, task. A layer starts only if all earlier layers are ok, so a failure is reported
at its cause and before any motion. For later failures: the supervisor of real arms stops all arms
(`drivers.safety`), a gripper reconnects, and the next `resume()` restarts the process of a vendor's library.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from armcell.cell.cell import Cell
from armcell.cell.live import LiveCell
from armcell.cell.loader import load
from armcell.cell.task_run import load_script
from armcell.core import ArmcellError, InputError, JointGoal, PlanRequest
from armcell.drivers import drivers
from armcell.drivers.real import kind_of, real_settings
from armcell.planning import plan

LAYERS = ("description", "controllers", "drivers", "planner", "task")
OK, WAITING = "ok", "waiting"


class Health:
    """Health of a cell during startup. Each layer has the state "waiting", "ok" or "failed: reason".

    Args:
        tell: receives one line for every layer that has started or failed.
    """

    def __init__(self, tell: Callable[[str], None] = lambda line: None):
        self.tell = tell
        self.states: dict[str, str] = dict.fromkeys(LAYERS, WAITING)

    @contextmanager
    def layer(self, name: str) -> Iterator[list[str]]:
        """Report the health of one layer of a cell, such as the drivers or the planner. The code in the
        `with` block starts this layer.

        Texts that the block appends to the yielded list become part of the report.

        Raises:
            InputError: an earlier layer has not started.
            ArmcellError: the start failed; the state of the layer becomes "failed: reason".
        """
        missing = [n for n in LAYERS[: LAYERS.index(name)] if self.states[n] != OK]
        if missing:
            raise InputError(f"{name} cannot start before {', '.join(missing)}", hint="start them in order")
        said: list[str] = []
        try:
            yield said
        except ArmcellError as error:
            self.states[name] = f"failed: {error}"
            self.tell(f"{name}: failed")
            raise
        self.states[name] = OK
        self.tell(f"{name}: ok" + (f" ({', '.join(said)})" if said else ""))

    def now(self, live: LiveCell) -> dict[str, str]:
        """Return the health of a running cell: the current state of each of its layers.

        The state of "drivers" has the reason if the driver has stopped its arms.
        """
        stopped = live.driver.fault()
        return {**self.states, **({"drivers": f"stopped: {stopped}"} if stopped is not None else {})}


def first_layers(cell: str | Path, mode: str, tell: Callable[[str], None]) -> tuple[Cell, Health]:
    """Check the layers of a cell that need no connection: the description and the controllers. Return the
    cell and its health report.

    Raises:
        InputError: see `check_description` and `check_controllers`.
    """
    started: list[str] = []  # collected, so that an error prints only its own line
    health = Health(started.append)
    with health.layer("description") as said:
        loaded = load(cell)
        said.append(check_description(loaded))
    with health.layer("controllers") as said:
        said.append(check_controllers(loaded, mode))
    tell("\n".join(started))
    health.tell = tell
    return loaded, health


def check_description(cell: Cell) -> str:
    """Summarize the robot model for a cell's health report:
    its name and its numbers of joints and planning groups.

    Raises:
        InputError: the model has no planning group with a tip, so nothing can be planned.
    """
    arms = [g.name for g in cell.model.groups.values() if g.tip_link]
    if not arms:
        raise InputError(
            f"the description of {cell.model.name!r} has no planning group that is a chain",
            file=cell.file, element="robot",
            hint="add an SRDF with groups to the robot: `armcell setup` writes one",
        )  # fmt: skip
    return f"{cell.model.name}, {cell.model.dof} joints, {', '.join(arms)}"


def check_controllers(cell: Cell, mode: str) -> str:
    """Summarize for a cell's health report which controllers move the
    joints in the mode "sim", "fake" or "real".

    Raises:
        UnknownNameError: the mode does not exist, or the block `real` names an arm that the model lacks.
        InputError: the block `real` has another error.
    """
    drivers[mode]
    if mode != "real":
        how = {"sim": f"{cell.physics.arm_control} of {cell.model.dof} joints", "fake": "joints follow"}
        return how.get(mode, f"driver {mode!r}")
    try:
        settings = real_settings(cell.spec.real, cell.model)
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.reason, file=cell.file, element=error.element, hint=error.hint) from None
    return ", ".join(
        f"{name}: {kind_of(arm).controller_description(arm.backend)} at {arm.host}"
        for name, arm in settings.arms.items()
    )


def check_driver(live: LiveCell) -> str:
    """Check that the driver reports finite positions of all joints, and return a summary for the health
    report.

    Raises:
        InputError: a position is missing or not finite, or the driver has stopped its arms.
    """
    state = live.driver.joint_state()
    bad = [n for n, q in zip(state.joint_names, state.positions) if not np.isfinite(q)]
    missing = [n for n in live.model.joint_names if n not in state.joint_names]
    if bad or missing:
        raise InputError(f"the driver {live.driver.name!r} tells no position of {', '.join(bad + missing)}")
    fault = live.driver.fault()
    if fault is not None:
        raise InputError(
            f"the driver {live.driver.name!r} has stopped: {fault.text}", hint=fault.hint or None
        )
    return f"{live.driver.name}, {len(state.joint_names)} joints"


def check_planner(live: LiveCell) -> str:
    """Check that the planner accepts the current state of every arm as a start state.
    Return a summary for the health report.

    The check plans from the present state to the same state. Start states from which the planner cannot start
    are only reported, because a task may begin with steps that need no planner.
    """
    name, faults = live.ctx.settings.planner_id, []
    scene = live.scene()
    for group in live.arms:
        here = JointGoal(scene.state.reindexed(scene.model.group(group).joint_names))
        result = plan(scene, PlanRequest(group, (here,), planner_id=name))
        if not result.ok:
            faults.append(f"{group} cannot begin here: {result.message}")
    return "; ".join([name, *faults])


def check_task(cell: Cell) -> str:
    """Summarize the task or script of a cell for its health report.

    Raises:
        InputError: the cell has no task, or its script cannot be loaded.
    """
    if cell.spec.script is not None:
        load_script(cell.spec.script, cell.file)
        return cell.spec.script
    if not cell.spec.task:
        raise InputError(
            "the cell has no task", file=cell.file,
            hint="add 'task: [...]' or 'script: task.py', or use the Python API",
        )  # fmt: skip
    return f"{len(cell.spec.task)} steps"
