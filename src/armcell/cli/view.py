"""`armcell view`: plan in the browser."""

from __future__ import annotations

import typer

from armcell.cli import goals
from armcell.cli.console import console
from armcell.cli.page import serve_page

EXAMPLES = """
Examples:

  armcell view panda_pick                     drag the goal, plan, preview, execute at http://127.0.0.1:8080

  armcell view my_cell --mode sim --open      executed in physics; opens the browser

Ctrl-C ends it. What is dragged, added and allowed there changes no file; "Save" writes the objects to one in
the folder where the command was started.
"""


def view(
    cell: str = goals.CELL,
    mode: str = typer.Option("fake", help="What 'Execute' moves: fake (follows exactly) or sim (physics)."),
    seed: int | None = goals.SEED,
    port: int = typer.Option(8080, min=1, max=65535, help="Port of the page; the next free one if taken."),
    open_browser: bool = typer.Option(False, "--open", help="Open the page in the browser."),
) -> int:
    """Plan in the browser: drag the goal, choose planner and speed, plan, preview, execute; edit the scene.

    Example: armcell view panda_pick --open
    """
    from armcell.cell import load
    from armcell.control import drivers
    from armcell.planning import prepare
    from armcell.viewer import PlanningPanel, PlanningSession

    drivers[mode]  # an unknown mode is said before anything is made
    loaded = load(cell)
    scene = loaded.scene(seed)

    session = PlanningSession(
        scene,
        lambda now, observers: loaded.connect(mode, seed, observers, time_scale=1.0, scene=now),
        seed or 0,
    )
    console.print("loading (the first run on a machine compiles for about a minute)")
    prepare(scene, session.group)  # not on the time of the first plan
    with PlanningPanel(session, port=port, title=loaded.name) as panel:
        serve_page(panel.url, open_browser)
