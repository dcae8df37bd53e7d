"""`armcell view`: plan interactively in the browser."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import typer

from armcell.cli import goal_options
from armcell.cli.console import console, errors
from armcell.cli.gate import WITHOUT_GATE, require_gate_override
from armcell.cli.page import ALLOW_HOST, HOST, OPEN, PORT, serve_page
from armcell.cli.run_record import RECORD, RUNS, ExternallyControlledRun, RecordingOptions, records_folder
from armcell.core import Observer

EXAMPLES = """
Examples:

  armcell view panda_pick                     drag the goal, plan, preview, execute; open the URL it prints

  armcell view my_cell --mode sim --open      executed in physics; opens the browser

  armcell view my_cell --mode real --without-gate "first motions, speed slider at 10 %"    moves real arms

Ctrl-C ends it. What is dragged, added and allowed there changes no file; "Save" writes the objects to one in
the folder where the command was started.
"""


def view(
    cell: str = goal_options.CELL,
    mode: str = typer.Option(
        "fake", help="What 'Execute' moves: fake (follows exactly), sim (physics) or real (the cell's arms)."
    ),
    seed: int | None = goal_options.SEED,
    host: str = HOST,
    port: int = PORT,
    allow_host: list[str] = ALLOW_HOST,
    open_browser: bool = OPEN,
    record: bool | None = RECORD,
    runs: Path | None = RUNS,
    without_gate: str | None = WITHOUT_GATE,
) -> int:
    """View a cell in the browser and plan there: drag the goal,
    choose planner and speed, preview and execute.

    The scene can be edited in the browser, too.

    The page opens only with the token in the printed URL.

    Example: armcell view panda_pick --open
    """
    from armcell.cell.health import first_layers
    from armcell.drivers import drivers
    from armcell.planning import prepare_group
    from armcell.viewer import PlanningPanel, PlanningSession

    drivers[mode]  # report an unknown mode first
    gate = require_gate_override(mode, "what is planned in the browser", without_gate)
    loaded, _ = first_layers(cell, mode, partial(errors.print, markup=False, highlight=False))
    scene = loaded.scene(seed)
    command = ["armcell", "view", cell, "--mode", mode, *([] if seed is None else ["--seed", str(seed)])]
    command += ["--without-gate", str(without_gate)] if gate else []
    kept = RecordingOptions(records_folder(record, mode, runs))
    with ExitStack() as stack:
        recording = stack.enter_context(ExitStack())

        def connect(now: Any, observers: Sequence[Observer]) -> Any:
            """Return a new live cell, with its own record, for `armcell view`.
            Every time the user edits the scene, a new cell is needed.
            """
            recording.close()
            run = ExternallyControlledRun(
                loaded, now, seed, mode, kept, {}, "the user of the page", command, gate=gate
            )
            recording.enter_context(run)
            live = loaded.connect(mode, seed, [*run.observers, *observers], time_scale=1.0, scene=now)
            run.begin(live)
            return live

        session = PlanningSession(scene, connect, seed or 0)
        console.print("loading (the first run on a machine compiles for about a minute)")
        prepare_group(scene, session.group)  # so that the first plan is fast
        panel = stack.enter_context(PlanningPanel(session, host, port, loaded.name, names=allow_host))
        serve_page(panel.viewer.page, open_browser)
