"""A cell's layers in the order they start, each with a check; and how they are while it runs.

description (model, objects) -> controllers (what moves which joints) -> drivers (connected, states come) ->
planner -> task. A layer starts only when all before it are well, so what fails is named where it is, and
before anything moves. What dies later: the supervisor of real arms stops them all (`control.safety`), a
gripper's connection is made anew, a process of `ur_rtde` at the next `resume()`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from armcell.cell.cell import Cell, load
from armcell.cell.live import LiveCell
from armcell.cell.script import load_script
from armcell.control import drivers
from armcell.control.drivers.ur.settings import real_settings
from armcell.control.following import Follower
from armcell.core import ArmcellError, InputError, JointGoal, PlanRequest
from armcell.core.protocols import offers
from armcell.planning import plan

LAYERS = ("description", "controllers", "drivers", "planner", "task")
OK, WAITING = "ok", "waiting"


class Health:
    """How each layer is: "waiting", "ok", or "failed: why".

    Args:
        tell: gets a line for every layer that has started or failed.
    """

    def __init__(self, tell: Callable[[str], None] = lambda line: None):
        self.tell = tell
        self.states: dict[str, str] = dict.fromkeys(LAYERS, WAITING)

    @contextmanager
    def layer(self, name: str) -> Iterator[list[str]]:
        """Start a layer; what is put into the list is told with it.

        Raises:
            InputError: a layer before it has not started.
            Whatever the start raised; it is noted.
        """
        missing = [n for n in LAYERS[: LAYERS.index(name)] if self.states[n] != OK]
        if missing:
            raise InputError(f"{name} cannot start before {', '.join(missing)}", cure="start them in order")
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
        """The states while it runs: a driver that has stopped its arms says why."""
        stopped = live.driver.fault() if offers(live.driver, Follower) else None
        return {**self.states, **({"drivers": f"stopped: {stopped}"} if stopped is not None else {})}


def first_layers(cell: str | Path, mode: str, tell: Callable[[str], None]) -> tuple[Cell, Health]:
    """What starts before anything runs: the description and the controllers, told once both have.

    Raises:
        InputError: see `check_description` and `check_controllers`.
    """
    started: list[str] = []  # a mistake is one line
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
    """What there is to move.

    Raises:
        InputError: no planning group with a tip: nothing could be planned for.
    """
    arms = [g.name for g in cell.model.groups.values() if g.tip_link]
    if not arms:
        raise InputError(
            f"the description of {cell.model.name!r} has no planning group that is a chain",
            file=cell.file, element="robot",
            cure="add an SRDF with groups to the robot: `armcell setup` writes one",
        )  # fmt: skip
    return f"{cell.model.name}, {cell.model.dof} joints, {', '.join(arms)}"


def check_controllers(cell: Cell, mode: str) -> str:
    """What moves the joints in this mode.

    Raises:
        UnknownNameError: no such mode, or an arm of the block `real` that the model does not have.
        InputError: what else is wrong with the block `real`.
    """
    drivers[mode]
    if mode != "real":
        return f"{cell.physics.arm_control} of {cell.model.dof} joints" if mode == "sim" else "joints follow"
    try:
        settings = real_settings(cell.spec.real, cell.model)
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.reason, file=cell.file, element=error.element, cure=error.cure) from None
    how = "our program" if settings.backend == "own" else settings.backend
    return ", ".join(f"{name}: {how} at {arm.host}" for name, arm in settings.arms.items())


def check_driver(live: LiveCell) -> str:
    """That states come, of all joints.

    Raises:
        InputError: a state is missing or no number, or the driver has stopped its arms.
    """
    state = live.driver.joint_state()
    bad = [n for n, q in zip(state.joint_names, state.positions) if not np.isfinite(q)]
    missing = [n for n in live.model.joint_names if n not in state.joint_names]
    if bad or missing:
        raise InputError(f"the driver {live.driver.name!r} tells no position of {', '.join(bad + missing)}")
    fault = live.driver.fault() if offers(live.driver, Follower) else None
    if fault is not None:
        raise InputError(
            f"the driver {live.driver.name!r} has stopped: {fault.text}", cure=fault.cure or None
        )
    return f"{live.driver.name}, {len(state.joint_names)} joints"


def check_planner(live: LiveCell) -> str:
    """Plans for every arm from where it is to where it is, which finds a planner that cannot begin there.

    It only tells: a task may begin by what needs no planner.
    """
    name, told = live.ctx.settings.planner_id, []
    scene = live.scene()
    for group in live.arms:
        here = JointGoal(scene.state.reindexed(scene.model.group(group).joint_names))
        result = plan(scene, PlanRequest(group, (here,), planner_id=name))
        if not result.ok:
            told.append(f"{group} cannot begin here: {result.message}")
    return "; ".join([name, *told])


def check_task(cell: Cell) -> str:
    """
    Raises:
        InputError: the cell has no task, or its script cannot be loaded.
    """
    if cell.spec.script is not None:
        load_script(cell.spec.script, cell.file)
        return cell.spec.script
    if not cell.spec.task:
        raise InputError(
            "the cell has no task", file=cell.file,
            cure="add 'task: [...]' or 'script: task.py', or use the Python API",
        )  # fmt: skip
    return f"{len(cell.spec.task)} steps"
